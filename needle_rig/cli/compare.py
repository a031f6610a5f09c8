"""needle-rig compare: where the model fails on measurements."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    json_option,
    left_out_error,
    library,
    model_option,
    number,
    read_data,
    read_model,
    read_settled_values,
)
from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.workbench.learning.compare import Comparison
    from needle_rig.workbench.published.compare import SettledComparison


@click.command("compare")
@data_argument
@model_option
@effects_option
@click.option("--html", "html_path", type=click.Path(path_type=Path), help="Write a report in one file.")
@click.option(
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
    from needle_rig.workbench.learning.compare import compare
    from needle_rig.workbench.published.compare import compare_settled

    effects, model = library(directories), read_model(model_path, directories)
    if (settled := read_settled_values(data)) is not None:
        if html_path is not None or png_folder is not None:
            raise BadInput(
                f"{settled.name} has settled values only, no traces to draw; leave out --html and --png"
            )
        values = compare_settled(settled, effects, model)
        if as_json:
            click.echo(json.dumps(values.as_json(), ensure_ascii=False))
        else:
            _show_settled(values)
        return
    found = compare(read_data(data), effects, model)
    if png_folder is not None or html_path is not None:
        from needle_rig.figures.comparison import pictures, write_html
        from needle_rig.figures.page import write_pngs

        drawn = pictures(found)
        for path in write_pngs(drawn, png_folder) if png_folder is not None else ():
            click.echo(f"wrote {path}", err=True)
        if html_path is not None:
            write_html(found, drawn, html_path)
            click.echo(f"wrote {html_path}", err=True)
    if as_json:
        click.echo(json.dumps(found.as_json(), ensure_ascii=False))
    else:
        _show(found)


def _show(found: Comparison) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # names and notes come from files: brackets in them are no markup
    console = Console(highlight=False, markup=False)
    model = found.prepared.problem.base.name
    against = (
        f" against the model {model}: error on commands left out"
        f" {left_out_error(found.held_out_error)} × the noise, reduced χ² {found.reduced_chi2:.2f}"
    )
    console.print(Text.assemble((found.prepared.dataset.name, "bold"), against))
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("channel", "rmse", "noise", "in units of the noise"):
        table.add_column(heading)
    for name, values in found.channels.items():
        unit = values["unit"]
        table.add_row(
            name, f"{values['rmse']} {unit}", f"{values['noise']} {unit}", number(values["whitened"])
        )
    console.print(table)
    console.print("Worst places:" if found.worst else "No place is above 3 × its noise.")
    for place in found.worst:
        console.print(f"  {place.sigmas:6.0f}σ  {place.words}")
    for name, value in found.free_parameters.items():
        pull = f" ({value['pull_sigma']:+.1f}σ from what is stated)" if "pull_sigma" in value else ""
        console.print(f"fitted: {name} = {value['value']:g} {value.get('unit', '')}{pull}")
    for note in (*found.prepared.dataset.notes, *found.prepared.notes):
        console.print(f"note: {note}")


def _show_settled(found: SettledComparison) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # names and notes come from files: brackets in them are no markup
    console = Console(highlight=False, markup=False)
    against = (
        f" against the model {found.model}: error on motions left out"
        f" {left_out_error(found.held_out_error)} × the scatter, reduced χ² {found.reduced_chi2:.2f}"
    )
    console.print(Text.assemble((found.dataset, "bold"), against))
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("value", "measured", "model", "apart"):
        table.add_column(heading)
    for row in found.rows:
        error = row.measured.standard_error
        apart = "not weighed" if row.sigmas is None else f"{row.sigmas:.1f}σ"
        scatter = "" if error is None else f" ± {error:g}"
        table.add_row(
            row.words, f"{row.measured.value:g}{scatter} {row.measured.of.unit}", f"{row.model:.3g}", apart
        )
    console.print(table)
    for name, value in found.free_parameters.items():
        pull = f" ({value['pull_sigma']:+.1f}σ from what is stated)" if "pull_sigma" in value else ""
        console.print(f"fitted: {name} = {value['value']:g} {value['unit']}{pull}")
