"""The options that choose a rig: a simulated one, and what is behind its ports."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from needle_rig.cli._complete import completing
from needle_rig.errors import BadInput

_OPTIONS = (
    click.option(
        "--config", type=click.Path(), help="Rig file; default: config/rig.yaml, or the shipped one."
    ),
    click.option(
        "--parameters",
        shell_complete=completing("parameters"),
        help="Parameter set of the simulated needle, such as rig_rigid.",
    ),
    click.option("--model", type=click.Path(), help="Model file that planning strategies use."),
    click.option("--seed", type=int, help="Seed of the simulated rig's noise."),
    click.option("--simulated", is_flag=True, help="The simulated rig, also where a real one is set up."),
    click.option("--rig", type=click.Choice(["bench"]), help="The simulated rig with its firmware."),
    click.option("--image", is_flag=True, help="With --rig bench: the Cortex-M images, not the library."),
    click.option("--fast", is_flag=True, help="The simulated rig in virtual time instead of real time."),
)


def rig_options(command: Any) -> Any:
    """The options of a command that starts a rig, or the daemon of one."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def simulated_rig_file() -> Path:
    """The rig file of --simulated: the nearest rig.yaml if it is of a simulated rig, else the shipped one."""
    from needle_rig.config.files import find_config_file, shipped_file
    from needle_rig.config.loader import load_rig_config

    nearest = find_config_file("rig.yaml")
    return nearest if load_rig_config(nearest).kind == "simulated" else shipped_file("rig.yaml")


def bench_nodes(rig: str | None, image: bool) -> str | None:
    """Value of simulation.nodes for --rig and --image; None leaves the file's. Raises BadInput."""
    if rig is None:
        if image:
            raise BadInput("--image chooses how the bench's firmware runs: give it with --rig bench")
        return None
    return "image" if image else "firmware"
