"""`needle-rig jog`: turns the base by an angle or to one."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import move, socket_option, speed_option, told_base
from needle_rig.errors import BadInput


@click.command()
@click.option("--by", type=float, metavar="DEG", help="How far to turn, degrees; negative: the other way.")
@click.option("--to", type=float, metavar="DEG", help="Where to turn, degrees.")
@speed_option
@socket_option
def command(by: float | None, to: float | None, speed: float | None, socket: Path | None) -> None:
    """Turn the base of the running daemon's rig by or to an angle, without a run's file.

    Ctrl-C stops the drive.

    \b
    Exit codes: 0 it is there, 2 bad use or somebody else commands the rig, 3 a fault of the rig,
    4 stopped by a person.
    """
    if (by is None) == (to is None):
        raise BadInput("give either --by, as in --by 5, or --to")
    state = move(socket, "jog", {"by_deg": by, "to_deg": to, "speed_deg_s": speed})
    click.echo(f"The base stands at {told_base(state)}.")
