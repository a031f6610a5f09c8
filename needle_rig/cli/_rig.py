"""The options that choose what is behind the simulated ports."""

from __future__ import annotations

from needle_rig.errors import BadInput


def bench_nodes(rig: str | None, image: bool) -> str | None:
    """Value of simulation.nodes for --rig and --image; None leaves the file's. Raises BadInput."""
    if rig is None:
        if image:
            raise BadInput("--image chooses how the bench's firmware runs: give it with --rig bench")
        return None
    return "image" if image else "firmware"
