"""`needle-rig home`: turns the base to its zero, or finds a zero that was lost."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import move, socket_option, speed_option, told_base
from needle_rig.errors import BadInput


@click.command()
@click.option("--by", type=click.Choice(["angle", "hall", "index"]), help="How; default: angle.")
@click.option(
    "--here", type=float, metavar="DEG", help="Where the base stands, degrees, as a person sees it."
)
@speed_option
@socket_option
def command(by: str | None, here: float | None, speed: float | None, socket: Path | None) -> None:
    """Turn the base to 0°, or find its zero again after the drive node lost it.

    \b
    --by angle  turn to 0° by the zero that is known
    --by hall   take what the first Hall sensor and the torque say; nothing turns
    --by index  turn slowly, one turn at most, until the encoder's index mark passes
    --here 30   a person says at which angle the base stands; nothing turns

    Ctrl-C stops the drive.

    \b
    Exit codes: 0 done, 2 bad use or somebody else commands the rig, 3 a fault of the rig,
    4 stopped by a person.
    """
    if by is not None and here is not None:
        raise BadInput("give either --by or --here")
    order = {"by": "here" if here is not None else by or "angle", "angle_deg": here or 0.0}
    state = move(socket, "home", {**order, "speed_deg_s": speed})
    click.echo(f"The base stands at {told_base(state)}.")
