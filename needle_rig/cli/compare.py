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
    read_observations,
    read_saved,
)
from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.workbench.learning.observations import Comparison


@click.command("compare")
@data_argument
@model_option
@effects_option
@click.option("--refit", is_flag=True, help="Only with the values of a refit, none as it stands.")
@click.option(
    "--fixed", multiple=True, metavar="NAME=VALUE", help="This value instead of the model's; no fit moves it."
)
@click.option(
    "--free", multiple=True, metavar="NAME", help="Fit this value also where the model's others stand."
)
@picture_option("--html", "html_path", type=click.Path(path_type=Path), help="Write a report in one file.")
@picture_option(
    "--pictures",
    "png_folder",
    metavar="DIR",
    type=click.Path(path_type=Path),
    help="Draw PNGs to this folder.",
)
@picture_option(
    "--figure",
    "figures",
    multiple=True,
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Write the figure that the file is named after, as loop.svg, qq.pdf or strips.png.",
)
@json_option
def command(
    data: tuple[Path, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
    refit: bool,
    fixed: tuple[str, ...],
    free: tuple[str, ...],
    html_path: Path | None,
    png_folder: Path | None,
    figures: tuple[Path, ...],
    as_json: bool,
) -> None:
    """Drive the model with the measured base angle and show where it fails, worst first.

    The model's values stand as they are; beside them, in a second column, are those of a refit, with how far
    the two are apart. What is a trial's own, as its friction about the common one, is estimated in both.

    \b
    needle-rig compare data/mine
    needle-rig compare data/mine --model fitted.yaml --html report.html
    needle-rig compare data/mine --model rig_elastic --free friction_nmm_per_100mm
    needle-rig compare data/mine --figure loop.svg --figure pictures/qq.pdf

    DATA is a dataset folder or a run file, or several; or a folder of settled values as published
    (settled.yaml; reed2008 is shipped), which have no pictures. Without --model: rigid tissue with uniform
    friction (the null model), whose two constants are fitted.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.workbench.learning.compare import Held

    if figures:
        from needle_rig.figures.residuals import asked, write_figure

        for path in figures:
            asked(path)
    values = Held(refit, dict(map(_value, fixed)), free)
    saved = read_saved(model_path, directories)
    found = read_observations(data).compare(library(directories), saved, values)
    for path in figures:
        write_figure(found.traces(), path)
        click.echo(f"wrote {path}", err=True)
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


def _value(text: str) -> tuple[str, float]:
    """NAME=VALUE. Raises BadInput."""
    name, _, value = text.partition("=")
    try:
        return name.strip(), float(value)
    except ValueError:
        raise BadInput(
            f"--fixed {text}: give NAME=VALUE with a number, as torsional_rigidity_nmm2=62.56"
        ) from None


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
