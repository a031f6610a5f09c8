"""needle-rig reproduce: the paper's results beside ours."""

from __future__ import annotations

import json
from pathlib import Path

import click

from needle_rig.cli._output import console
from needle_rig.cli._pictures import picture_option


@click.command("reproduce")
@click.option("--json", "as_json", is_flag=True, help="Print the rows as JSON.")
@picture_option("--html", "page", type=click.Path(path_type=Path, dir_okay=False), help="Write a page.")
@picture_option(
    "--pictures",
    "folder",
    metavar="DIR",
    type=click.Path(path_type=Path, file_okay=False),
    help="Draw figures 3, 4, 6 and 7 as PNG to this folder.",
)
def command(as_json: bool, page: Path | None, folder: Path | None) -> None:
    """Run the model through every result of Reed, BioRob 2008, and print both side by side.

    A row is within (✓) when it differs by no more than the paper's standard error of 2.2°, or the torque
    whose lag that is. Rows that no parameter set meets say why.
    """
    from needle_rig.workbench.paper.reproduce import Reproduction, as_document

    runs = Reproduction()
    rows = runs.rows()
    if folder is not None or page is not None:
        from needle_rig.figures.page import write_pngs
        from needle_rig.figures.paper import drawn, write_paper_page

        if folder is not None:
            for path in write_pngs(drawn(runs), folder):
                click.echo(str(path), err=True)
        if page is not None:
            page.parent.mkdir(parents=True, exist_ok=True)
            write_paper_page(runs, rows, page)
            click.echo(str(page), err=True)
    if as_json:
        click.echo(json.dumps(as_document(rows), ensure_ascii=False, indent=2))
        return
    from rich.table import Table

    table = Table(box=None, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    table.add_column("result", min_width=24)
    for name in ("paper", "ours", "difference"):
        table.add_column(name, justify="right", no_wrap=True)
    for name in ("unit", "parameters"):
        table.add_column(name, no_wrap=True)
    for row in rows:
        numbers = [f"{round(v, 4) + 0.0:.4g}" for v in (row.paper, row.ours, row.difference)]
        mark = "[green]✓[/]" if row.within else "[red]✗[/]"
        table.add_row(mark, row.name, *numbers, row.unit, row.parameters)
    out = console(markup=True)
    out.print(table)
    off = [row for row in rows if not row.within]
    out.print(f"\n{len(rows) - len(off)} of {len(rows)} rows within the paper's standard error. The others:")
    for row in off:
        out.print(f"- {row.name} ({row.parameters}): {row.reason}.", soft_wrap=True)
