"""ASAM MDF (MF4, and MDF of older versions): a table a group; logged frames of a bus by its database."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import Leaf, columns_of
from needle_rig.importing.bus_log import Sent, by_can, called, decoded, load_can, sent_in
from needle_rig.importing.library_log import without_log
from needle_rig.importing.messages import STAMP
from needle_rig.importing.recording import Column, Read

_FRAMES = ("CAN_DataFrame", "CAN_ErrorFrame", "CAN_RemoteFrame")
"""What a group of logged frames begins its channels' names with."""


def read_mdf(path: Path, shown: str, dbc: Path | None) -> Read:
    """Dialect in words, columns and rates. Raises BadInput."""
    load_can()
    asammdf = needed("asammdf", "an MDF file", "import")
    leaves: dict[str, Leaf] = {}
    frames: dict[tuple[str, int], Sent] = {}
    logged: list[bool] = []
    dialect, failed = "", None
    with _silent():
        try:
            with path.open("rb") as stream, asammdf.MDF(stream) as file:
                dialect = f"MDF {file.version}"
                logged = [_is_of_frames(group) for group in file.groups]
                for index, group in enumerate(file.groups):
                    if not logged[index]:
                        _group(file, index, group, leaves)
            if any(logged):
                frames = sent_in(by_can("MF4Reader")(path))
        except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to struct's errors
            failed = str(error)[:200] or type(error).__name__
    if failed is not None:
        raise BadInput(f"{shown}: cannot be read as MDF: {failed}; save it again as MF4, or export it as CSV")
    sent: tuple[Column, ...] = ()
    if any(logged):
        sent = decoded(frames, shown, dbc)
        dialect += f", decoded by {called(dbc)}"
    if sent and not leaves:
        return dialect, sent, {}
    columns, rates = columns_of(leaves, shown)
    return dialect, (*columns, *sent), rates


@contextmanager
def _silent() -> Iterator[None]:
    """Without what the library logs of a damaged file, and its half-made objects print when they go."""
    said, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        with without_log("asammdf"):
            yield
            gc.collect()
    finally:
        sys.unraisablehook = said


def _is_of_frames(group: Any) -> bool:
    return any(channel.name.startswith(_FRAMES) for channel in group.channels)


def _group(file: Any, index: int, group: Any, leaves: dict[str, Leaf]) -> None:
    master = file.masters_db.get(index)
    wanted = [(None, index, k) for k, channel in enumerate(group.channels) if k != master and channel.name]
    signals = file.select(wanted, ignore_value2text_conversions=True) if wanted else []
    if not signals:
        return
    place = _plain(str(getattr(group.channel_group, "acq_name", "") or f"group {index + 1}"))
    while any(path.startswith(f"{place}/") for path in leaves):
        place += "'"
    leaves[f"{place}/{STAMP}"] = (np.asarray(signals[0].timestamps, dtype=np.float64), "s")
    for signal in signals:
        leaves[f"{place}/{_plain(signal.name)}"] = (np.asarray(signal.samples), str(signal.unit or ""))


def _plain(name: str) -> str:
    """Without the sign that parts a tree."""
    return name.replace("/", "∕")
