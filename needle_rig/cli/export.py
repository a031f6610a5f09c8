"""`needle-rig export RUN`: a run in formats that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._runs import config_option, directory_option, the_run
from needle_rig.questions.export import Export, Form

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
    run: str, wanted: Form | None, out: Path | None, directory: Path | None, config_path: Path | None
) -> None:
    """Export RUN (a path, a name from `needle-rig runs`, a part of one, or last); nothing is overwritten.

    Angles come out in degrees, torques in N·mm, time_s from the first row of the run.
    """
    from needle_rig.config.places import show_path

    if wanted is None:
        raise click.UsageError("Say which format: --csv, --mcap, --picture or --dataset.")
    found = the_run(run, directory, config_path)
    if not found.complete:
        click.echo(f"{show_path(found.path)}: {_why_no_end(found)}; exporting what is there", err=True)
    written = Export(run=found, form=wanted, out=out).answer()
    if found.simulated:
        click.echo(f"{found.name}: no real needle was turned, the rig was simulated", err=True)
    click.echo(show_path(written))


def _why_no_end(run: RunFile) -> str:
    from needle_rig.recording import being_written

    if being_written(run.path):
        return "is still running"
    torn_bytes = run.torn_bytes
    return "was cut off" + (f", {torn_bytes} bytes at its end are torn and left out" if torn_bytes else "")
