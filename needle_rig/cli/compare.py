"""needle-rig compare: where the model fails on measurements."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._output import console
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    json_option,
    model_option,
    of_field,
    terminal,
)
from needle_rig.errors import BadInput
from needle_rig.questions.compare import Compare

if TYPE_CHECKING:
    from needle_rig.workbench.learning.observations import Comparison


def _values(_context: click.Context, _option: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    """NAME=VALUE. Raises BadInput."""
    values = {}
    for text in texts:
        name, _, value = text.partition("=")
        try:
            values[name.strip()] = float(value)
        except ValueError:
            raise BadInput(
                f"--fixed {text}: give NAME=VALUE with a number, as torsional_rigidity_nmm2=62.56"
            ) from None
    return values


@click.command("compare")
@data_argument
@model_option
@effects_option
@of_field(Compare, "refit", help="Only with the values of a refit, none as it stands.")
@click.option(
    "--fixed",
    multiple=True,
    callback=_values,
    metavar="NAME=VALUE",
    help="This value instead of the model's; no fit moves it.",
)
@of_field(Compare, "free", metavar="NAME", help="Fit this value also where the model's others stand.")
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
    html_path: Path | None,
    png_folder: Path | None,
    figures: tuple[Path, ...],
    as_json: bool,
    **asked: Any,
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
    doing, question = terminal(), Compare(**asked)
    if figures:
        from needle_rig.figures.residuals import asked as known_figure
        from needle_rig.figures.residuals import write_figure

        for path in figures:
            known_figure(path)
    found = question.answer(doing)
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
