"""needle-rig compare: where the model fails on measurements."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._output import console
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    json_option,
    library,
    model_option,
    read_model,
    read_observations,
)

if TYPE_CHECKING:
    from needle_rig.workbench.learning.observations import Comparison


@click.command("compare")
@data_argument
@model_option
@effects_option
@picture_option("--html", "html_path", type=click.Path(path_type=Path), help="Write a report in one file.")
@picture_option(
    "--png", "png_folder", type=click.Path(path_type=Path), help="Write the pictures to this folder."
)
@json_option
def command(
    data: tuple[Path, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
    html_path: Path | None,
    png_folder: Path | None,
    as_json: bool,
) -> None:
    """Drive the model with the measured base angle and show where it fails, worst first.

    \b
    needle-rig compare data/mine
    needle-rig compare data/mine --model fitted.yaml --html report.html

    DATA is a dataset folder or a run file, or several; or a folder of settled values as published
    (settled.yaml; reed2008 is shipped), which have no pictures. Without --model: rigid tissue with uniform
    friction.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    found = read_observations(data).compare(library(directories), read_model(model_path, directories))
    if png_folder is not None or html_path is not None:
        from needle_rig.figures.comparison import pictures, write_html
        from needle_rig.figures.page import write_pngs

        traces = found.traces()
        drawn = pictures(traces)
        for path in write_pngs(drawn, png_folder) if png_folder is not None else ():
            click.echo(f"wrote {path}", err=True)
        if html_path is not None:
            write_html(traces, drawn, html_path)
            click.echo(f"wrote {html_path}", err=True)
    if as_json:
        click.echo(json.dumps(found.as_json(), ensure_ascii=False))
    else:
        _show(found)


def _show(found: Comparison) -> None:
    from rich.table import Table
    from rich.text import Text

    # names and notes come from files: brackets in them are no markup
    out = console()
    name, said = found.headline()
    out.print(Text.assemble((name, "bold"), f" {said}"))
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    headings, rows = found.rows()
    for heading in headings:
        table.add_column(heading)
    for row in rows:
        table.add_row(*row)
    out.print(table)
    for sentence in found.sentences():
        out.print(sentence)
