"""ASAM MDF (MF4, and MDF of older versions): a table a group; logged frames of a bus by its database."""

from __future__ import annotations

import gc
import mmap
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

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
    lost: list[Column] = []
    dialect, failed = "", None
    with _silent():
        try:
            with path.open("rb") as stream, asammdf.MDF(stream) as file:
                dialect = f"MDF {file.version}"
                logged = [_is_of_frames(group) for group in file.groups]
                for index, group in enumerate(file.groups):
                    if not logged[index]:
                        lost += _group(file, index, group, leaves)
                lost += _unlinked(stream, file)
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
    return dialect, (*columns, *sent, *lost), rates


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


def _group(file: Any, index: int, group: Any, leaves: dict[str, Leaf]) -> list[Column]:
    """Adds the channels of a group to `leaves`; returns what its records hold that no channel tells of."""
    place = _plain(str(getattr(group.channel_group, "acq_name", "") or f"group {index + 1}"))
    while any(path.startswith(f"{place}/") for path in leaves):
        place += "'"
    master = file.masters_db.get(index)
    if master is not None and getattr(group.channels[master], "sync_type", _TIME) != _TIME:
        master = None  # its rows are counted, or turned, and that is a column like others
    size = int(getattr(group.channel_group, "samples_byte_nr", 0))
    beyond = [channel.name for channel in group.channels if _bytes_of(channel)[1] > size]
    if beyond:  # the library takes the kind of a row from all its channels
        raise ValueError(f"{', '.join(beyond)[:100]} reaches beyond the {size} bytes of a row")
    wanted = [(None, index, k) for k in range(len(group.channels)) if k != master]
    signals = file.select(wanted, ignore_value2text_conversions=True) if wanted else []
    if signals and master is not None:
        leaves[f"{place}/{STAMP}"] = (np.asarray(signals[0].timestamps, dtype=np.float64), "s")
    for (_, _, k), signal in zip(wanted, signals, strict=True):
        path = f"{place}/{_plain(signal.name) or f'channel {k + 1}'}"
        while path in leaves:
            path += "'"
        leaves[path] = (np.asarray(signal.samples), str(signal.unit or ""))
    return [
        Column(f"{place}, bytes {begin + 1} to {end} of a row", "", np.empty(0), fault=_NO_CHANNEL)
        for begin, end in _gaps(group)
    ]


_NO_CHANNEL = "belong to no channel, as where one is lost or damaged; export the recording again"
_TIME = 1
"""The kind of a master channel that is a time."""
_OF_TEXTS = 1
"""Flag of a group that holds what has no fixed length, and no channels."""


def _gaps(group: Any) -> list[tuple[int, int]]:
    """Bytes of a record that no channel reads, as [begin, end): a broken chain of channels leaves them."""
    if getattr(group.channel_group, "flags", 0) & _OF_TEXTS:
        return []
    size, gaps, known = int(group.channel_group.samples_byte_nr), [], 0
    for begin, end in [*sorted(_bytes_of(channel) for channel in group.channels), (size, size)]:
        if min(begin, size) > known:
            gaps.append((known, min(begin, size)))
        known = max(known, end)
    return gaps


_NO_LINK = "no link leads to it, as where one is damaged; export the recording again"


def _unlinked(stream: BinaryIO, file: Any) -> list[Column]:
    """Groups that are in the file and that no link reaches: a chain that ends early says nothing itself."""
    if not hasattr(file.header, "dg_nr"):
        linked = {group.channel_group.address for group in file.groups}
        places = [f"group at byte {at}" for at in _groups_in(stream) if at not in linked]
        return [Column(place, "", np.empty(0), fault=_NO_LINK) for place in places]
    # versions before 4 count their groups, and mark them by two letters that data hold by chance
    found = len({group.data_group.address for group in file.groups})
    places = [f"group {k + 1} of {file.header.dg_nr}" for k in range(found, file.header.dg_nr)]
    return [Column(place, "", np.empty(0), fault=_NO_LINK) for place in places]


def _groups_in(stream: BinaryIO) -> Iterator[int]:
    """Where version 4 has channel groups, by their mark and by a length that fits their number of links."""
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as held:
        at = held.find(_GROUP)
        while at >= 0:
            if at + _HEAD.size <= len(held):
                length, links = _HEAD.unpack_from(held, at)
                if length == _HEAD.size + 8 * links + _GROUP_DATA:
                    yield at
            at = held.find(_GROUP, at + 1)


_GROUP = b"##CG"
_HEAD = struct.Struct("<8xQQ")
"""Of a block: mark and reserved bytes, length, number of links."""
_GROUP_DATA = 32
"""Bytes of a channel group beside its head and links."""


def _bytes_of(channel: Any) -> tuple[int, int]:
    """Where a channel is in a record, as [begin, end); a version before 4 counts bits."""
    if hasattr(channel, "byte_offset"):
        first = 8 * channel.byte_offset + channel.bit_offset
    else:
        first = 8 * channel.additional_byte_offset + channel.start_offset
    return first // 8, (first + channel.bit_count + 7) // 8


def _plain(name: str) -> str:
    """Without the sign that parts a tree."""
    return name.replace("/", "∕")
