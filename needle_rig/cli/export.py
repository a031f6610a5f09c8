"""`needle-rig export RUN`: a run in formats that other programs read."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._runs import config_option, directory_option, the_run

if TYPE_CHECKING:
    from needle_rig.recording import RunFile


@click.command()
@click.argument("run")
@click.option("--csv", "wanted", flag_value="csv", help="A folder with one CSV a source and run.yaml.")
@click.option("--mcap", "wanted", flag_value="mcap", help="One MCAP file: JSON messages with schema.")
@click.option(
    "--picture", "wanted", flag_value="png", help="The picture: angles, torque, shaft after each motion."
)
@click.option(
    "--dataset", "wanted", flag_value="dataset", help="A folder that diagnose and identify read as a trial."
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="Where to write.  [default: here, named as the run]"
)
@directory_option
@config_option
def command(
    run: str, wanted: str | None, out: Path | None, directory: Path | None, config_path: Path | None
) -> None:
    """Export RUN (a path, a name from `needle-rig runs`, a part of one, or last); nothing is overwritten.

    Angles come out in degrees, torques in N·mm, time_s from the first row of the run.
    """
    from needle_rig.config.places import show_path
    from needle_rig.recording import mark_read

    if wanted is None:
        raise click.UsageError("Say which format: --csv, --mcap, --picture or --dataset.")
    found = the_run(run, directory, config_path)
    if not found.complete:
        click.echo(f"{show_path(found.path)}: {_why_no_end(found)}; exporting what is there", err=True)
    if wanted == "mcap":
        from needle_rig.recording.export_mcap import export_mcap

        written = export_mcap(found, out or Path(f"{found.name}.mcap"))
    elif wanted == "csv":
        from needle_rig.recording.export_csv import export_csv

        written = out or Path(f"{found.name}_csv")
        export_csv(found, written)
    elif wanted == "png":
        from needle_rig.figures.run import draw_run

        written = draw_run(found, _new(out or Path(f"{found.name}.png")))
    else:
        from needle_rig.dataset import write_dataset
        from needle_rig.workbench.observations.runs import runs_as_dataset

        written = write_dataset(runs_as_dataset([found]), out or Path(f"{found.name}_dataset"))
    mark_read(found.path)
    if found.simulated:
        click.echo(f"{found.name}: no real needle was turned, the rig was simulated", err=True)
    click.echo(show_path(written))


def _why_no_end(run: RunFile) -> str:
    from needle_rig.recording import being_written

    if being_written(run.path):
        return "is still running"
    torn_bytes = run.torn_bytes
    return "was cut off" + (f", {torn_bytes} bytes at its end are torn and left out" if torn_bytes else "")


def _new(path: Path) -> Path:
    from needle_rig.config.places import show_path
    from needle_rig.errors import BadInput

    if os.path.lexists(path):
        raise BadInput(f"{show_path(path)}: exists already; name another place with --out")
    return path
