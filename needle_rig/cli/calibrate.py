"""`needle-rig calibrate`: measures what is wrong with the rig's sensors and writes the nodes' pages."""

from __future__ import annotations

import asyncio
import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.errors import BadInput
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.calibration.stand import Stand
    from needle_rig.calibration.steps import Calibration, Target

_STEPS = {
    "drive": "The drive is off: the base is turned by hand a turn at a time, mark to mark, there and back.",
    "torque": "The needle is out of its tissue; weights of known torque go on the load cell one by one.",
    "hall": "The needle is free, out of its tissue; the drive turns it a full turn there and back.",
}


@click.command()
@click.argument("node", type=click.Choice(["drive", "torque", "hall"]))
@click.option("--rig", "bench", type=click.Choice(["bench"]), help="The simulated rig with its firmware.")
@click.option("--config", type=click.Path(), help="Rig file of a real rig.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("calibration"), show_default=True)
@click.option("--serial", type=click.IntRange(1, 2**32 - 1), required=True, help="Serial number of the node.")
@click.option(
    "--weights",
    metavar="N·MM,…",
    default="0,0.5,1,1.5",
    show_default=True,
    help="Weights on the load cell, N·mm.",
)
@click.option(
    "--errors", type=click.IntRange(min=1), default=1, show_default=True, help="Bench: which errors."
)
@click.option("--yes", is_flag=True, help="Ask nothing before a step.")
def command(
    node: str,
    bench: str | None,
    config: str | None,
    out: Path,
    serial: int,
    weights: str,
    errors: int,
    yes: bool,
) -> None:
    """Calibrate a node: guided steps, a fit with the picture of its residual, a page for the node.

    The node must be neutral (its calibration page blank), so that it sends what its converters see; it alone
    applies the page, and the daemon corrects nothing. Begin with the drive, whose encoder is the scale for
    the Hall sensors. Written to --out: NODE.yaml, NODE.png and NODE.hex, to be flashed with
    `st-flash --format ihex write NODE.hex`.
    """
    from needle_rig.calibration.steps import Target

    rig = bench or config
    if rig is None or None not in (bench, config):
        raise BadInput("give either --rig bench, or --config with the rig file of a real rig")
    loads = _weights(weights)
    out.mkdir(parents=True, exist_ok=True)
    target = Target(out, serial, datetime.date.today())
    click.echo(_STEPS[node])
    if not yes:
        click.confirm(f"The {node} node is neutral (no page flashed) and the rig is prepared?", abort=True)
    done = asyncio.run(_calibrate(node, _stand(node, rig, out, errors, yes), target, loads))
    for line in done.lines:
        click.echo(line)
    for file in done.files:
        click.echo(f"wrote {file}")
    if node == "drive":
        if not (yes or rig == "bench"):
            click.confirm(f"Flash {out / 'drive.hex'}, switch the drive on again. Done?", abort=True)
        elif rig != "bench":
            click.echo("Flash the page; the jog that checks it was left out.")
            return
        click.echo(asyncio.run(_check(_stand("", rig, out, errors, yes))))


def _weights(text: str) -> tuple[float, ...]:
    try:
        loads = tuple(float(word) for word in text.split(","))
    except ValueError:
        raise BadInput(f"--weights {text}: give N·mm with commas between, as in --weights 0,0.5,1") from None
    if len(set(loads)) < 2:
        raise BadInput(f"--weights {text}: two different ones at least, as in --weights 0,1")
    return loads


def _stand(kind: str, rig: str, pages: Path, errors: int, yes: bool) -> Stand:
    """The simulated rig, whose other nodes carry the pages in `pages`; or a real rig."""
    from needle_rig.calibration.stand import BenchStand, RealStand

    if rig == "bench":
        overrides: JsonObject = {"simulation.sensor_errors_seed": errors}
        return BenchStand(kind, pages, overrides)
    from needle_rig.config.loader import load_rig_config

    def confirm(text: str) -> None:
        if yes:
            click.echo(text)
        else:
            click.prompt(f"{text}; then Enter", default="", show_default=False, prompt_suffix=" ")

    return RealStand(load_rig_config(rig), confirm)


async def _calibrate(node: str, stand: Stand, target: Target, loads: tuple[float, ...]) -> Calibration:
    from needle_rig.calibration import steps as calibrate

    await stand.rig.open()
    try:
        if node == "drive":
            return await calibrate.calibrate_drive(stand, target)
        if node == "torque":
            return await calibrate.calibrate_torque(stand, target, loads)
        return await calibrate.calibrate_hall(stand, target)
    finally:
        await stand.rig.close()


async def _check(stand: Stand) -> str:
    from needle_rig.calibration.steps import check_drive

    await stand.rig.open()
    try:
        return await check_drive(stand)
    finally:
        await stand.rig.close()
