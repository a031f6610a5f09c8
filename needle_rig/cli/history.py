"""needle-rig history: the steps that a model took, and how its error fell."""

from __future__ import annotations

import json
from pathlib import Path

import click

from needle_rig.cli._output import console
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import effects_option, json_option, number


@click.command("history")
@click.argument("model", type=click.Path(path_type=Path))
@effects_option
@picture_option("--png", "png_path", type=click.Path(path_type=Path), help="Write the ladder as a picture.")
@json_option
def command(model: Path, effects: tuple[str, ...], png_path: Path | None, as_json: bool) -> None:
    """Show how the error fell, a row a step: training, commands left out, noise floor.

    \b
    needle-rig history fitted.yaml --png ladder.png
    """
    from needle_rig.model import load_saved
    from needle_rig.workbench.learning.history import ladder

    saved = load_saved(model, effects=effects)
    steps = ladder(saved)
    if png_path is not None:
        from needle_rig.figures.ladder import ladder_figure

        ladder_figure(saved).savefig(png_path, dpi=110)
        click.echo(f"wrote {png_path}", err=True)
    if as_json:
        click.echo(json.dumps({"model": saved.model.name, "steps": [s.as_json() for s in steps]}))
        return
    if not steps:
        click.echo(f"{model}: no step yet; add an effect with needle-rig adopt")
        return
    from rich.table import Table

    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("step", "date", "dataset", "training", "left out", "floor"):
        table.add_column(heading)
    for step in steps:
        table.add_row(
            step.label,
            step.date,
            step.dataset,
            number(step.training),
            number(step.held_out),
            number(step.floor),
        )
    console().print(table)
