"""The options that choose what is behind the simulated ports."""

from __future__ import annotations

from needle_rig.errors import BadInput


def bench_nodes(rig: str | None, image: bool, fast: bool = False) -> str | None:
    """Value of simulation.nodes for --rig and --image; None leaves the file's. Raises BadInput."""
    if rig is None:
        if image:
            raise BadInput("--image chooses how the bench's firmware runs: give it with --rig bench")
        return None
    if fast:
        raise BadInput("--fast has no nodes and no firmware; leave out --fast or --rig bench")
    return "image" if image else "firmware"
