"""The options that choose a rig: a simulated one, and what is behind its ports."""

from __future__ import annotations

from pathlib import Path

from needle_rig.errors import BadInput


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
