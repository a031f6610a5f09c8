"""Logs of a CAN bus (candump, ASC, BLF, TRC, python-can's CSV): frames to signals by the bus's database."""

from __future__ import annotations

import os
import re
from array import array
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from needle_rig.config.files import find_config_file
from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.importing.library_log import without_log
from needle_rig.importing.messages import STAMP
from needle_rig.importing.recording import MAX_COLUMNS, Column, Read
from needle_rig.numerics import Array

OWN = "needle_rig.dbc"
"""The database of this rig's bus, which is taken where no other is named."""
BLOCK = 1 << 16
"""Frames that are unpacked at once: a bit of them takes a byte."""
_SHOWN = re.compile(
    r"\s*\((?P<time>\d+\.\d+)\)\s+(?P<channel>\S+)\s+(?P<id>[0-9A-Fa-f]+)\s+\[\d+\]\s+"
    r"(?P<data>(?:[0-9A-Fa-f]{2}(?:\s|$))*)"
)
"""A line that candump shows, or `cantools decode` behind it."""


class Frame(NamedTuple):
    """One frame of data on its bus."""

    time_s: float
    channel: str
    number: int
    data: bytes


class Sent:
    """All frames of one number, in the order of the log: as bytes, since ten million fit so."""

    def __init__(self) -> None:
        self.times_s = array("d")
        self.lengths = bytearray()
        self.data = bytearray()

    def add(self, frame: Frame) -> None:
        """One more."""
        self.times_s.append(frame.time_s)
        self.lengths.append(len(frame.data))
        self.data += frame.data


def load_can() -> None:
    """Load python-can, which has to come before asammdf: each imports the other, and MF4 is read only so."""
    import can  # noqa: F401


def by_can(reader: str) -> Callable[[Path], Iterator[Frame]]:
    """Frames of a file by a reader of python-can."""

    def read(path: Path) -> Iterator[Frame]:
        import can

        with getattr(can, reader)(path) as messages:
            for m in messages:
                # A log that ends within a frame has fewer bytes than the frame says. A classic frame that
                # says more than eight has eight (ISO 11898-1).
                whole = len(m.data) >= (m.dlc if m.is_fd else min(m.dlc, 8))
                if whole and not m.is_error_frame and not m.is_remote_frame:
                    yield Frame(m.timestamp, str(m.channel), m.arbitration_id, bytes(m.data))

    return read


def _shown(path: Path) -> Iterator[Frame]:
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            found = _SHOWN.match(line)
            if found is not None:
                data = bytes.fromhex(found["data"])
                yield Frame(float(found["time"]), found["channel"], int(found["id"], 16), data)


_KINDS: tuple[tuple[re.Pattern[bytes], str, Callable[[Path], Iterator[Frame]]], ...] = (
    (re.compile(rb"LOGG"), "BLF", by_can("BLFReader")),
    (re.compile(rb"date .*\r?\n\s*base +(hex|dec)"), "ASC", by_can("ASCReader")),
    (re.compile(rb";\$FILEVERSION|;#{20}"), "TRC", by_can("TRCReader")),
    (re.compile(rb"timestamp,arbitration_id,"), "python-can's CSV", by_can("CSVReader")),
    (re.compile(rb"\(\d+\.\d+\) +\S+ +[0-9A-Fa-f]+#"), "candump", by_can("CanutilsLogReader")),
    (re.compile(rb"\s*\(\d+\.\d+\)\s+\S+\s+[0-9A-Fa-f]+\s+\[\d+\]"), "candump as shown", _shown),
)
"""By the first bytes: what it is, and what reads it."""


def is_bus_log(head: bytes) -> bool:
    """Whether a file that begins so is a log of a CAN bus."""
    return any(kind.match(head) for kind, _, _ in _KINDS)


def read_bus_log(path: Path, shown: str, dbc: Path | None) -> Read:
    """Dialect in words, columns and no rates: a table a message, on the clock of the log. Raises BadInput."""
    with path.open("rb") as file:
        head = file.read(512)
    name, read = next((name, read) for kind, name, read in _KINDS if kind.match(head))
    try:
        with without_log("can"):
            sent = sent_in(read(path))
    except Exception as error:  # noqa: BLE001 - damaged logs raise anything, down to struct's and zlib's errors
        raise BadInput(f"{shown}: cannot be read as {name}: {str(error)[:200]}; record again") from None
    return f"{name}, decoded by {called(dbc)}", decoded(sent, shown, dbc), {}


def called(dbc: Path | None) -> str:
    """How a database is called in sentences."""
    return show_path(dbc) if dbc else OWN


def sent_in(frames: Iterator[Frame]) -> dict[tuple[str, int], Sent]:
    """Frames by channel and number."""
    sent: dict[tuple[str, int], Sent] = {}
    for frame in frames:
        key = frame.channel, frame.number
        if key not in sent:
            sent[key] = Sent()
        sent[key].add(frame)
    return sent


def decoded(sent: Mapping[tuple[str, int], Sent], shown: str, dbc: Path | None) -> tuple[Column, ...]:
    """The signals of frames by message, on the log's clock. Raises BadInput."""
    database, used = database_at(dbc), called(dbc)
    columns: list[Column] = []
    several = len({channel for channel, _ in sent}) > 1
    unknown = []
    for (channel, number), frames in sent.items():
        try:
            message: Any = database.get_message_by_frame_id(number)
        except KeyError:
            unknown.append(f"0x{number:X}")
            fault = f"{len(frames.times_s)} frames, and {used} has no message 0x{number:X}"
            columns.append(Column(f"{channel} 0x{number:X}", "", np.empty(0), fault=fault))
            continue
        table = f"{channel} {message.name}" if several else str(message.name)
        columns.append(Column(f"{table}: {STAMP}", "s", np.array(frames.times_s), table))
        columns += [
            Column(f"{table}.{signal.name}", signal.unit or "", values, table)
            for signal, values in _signals(message, frames)
        ]
    if len(unknown) == len(sent):
        held = f"its frames are {', '.join(sorted(unknown)[:6])}" if unknown else "it holds no frame of data"
        raise BadInput(
            f"{shown}: {held}, and {used} has none of them; name the bus's own with --dbc FILE.dbc"
        )
    if len(columns) > MAX_COLUMNS:
        raise BadInput(
            f"{shown}: {len(columns)} signals, more than {MAX_COLUMNS}; name a --dbc with the rig's messages"
        )
    return tuple(columns)


def database_at(path: Path | None) -> Any:
    """The database of a bus, ours without a path. Raises BadInput."""
    import cantools

    place = path or find_config_file(OWN)
    try:
        return cantools.database.load_file(os.fspath(place), strict=False)
    except (OSError, ValueError, KeyError, cantools.Error) as error:
        raise BadInput(
            f"{show_path(place)}: cannot be read as a CAN database: {str(error)[:200]}; name a .dbc"
        ) from None


def _signals(message: Any, frames: Sent) -> Iterator[tuple[Any, Array]]:
    """Values of every signal (frames,), in its unit; NaN where a frame is too short, or holds another one."""
    lengths = np.frombuffer(frames.lengths, np.uint8).astype(np.int64)
    size = max(message.length, int(lengths.max()))
    payload = np.zeros((len(lengths), size), dtype=np.uint8)
    payload[np.arange(size) < lengths[:, None]] = np.frombuffer(frames.data, np.uint8)
    raw = {signal.name: unpacked(payload, signal) for signal in message.signals}
    for signal in message.signals:
        values = raw[signal.name] * float(signal.scale) + float(signal.offset)
        last = _last_bit(signal)
        values[8 * lengths <= last] = np.nan
        if signal.multiplexer_ids is not None and signal.multiplexer_signal in raw:
            values[~np.isin(raw[signal.multiplexer_signal], signal.multiplexer_ids)] = np.nan
        yield signal, values


def _first_bit(signal: Any) -> int:
    """In the order in which its bits follow each other."""
    if signal.byte_order == "little_endian":
        return int(signal.start)
    return int(8 * (signal.start // 8) + 7 - signal.start % 8)


def _last_bit(signal: Any) -> int:
    return _first_bit(signal) + int(signal.length) - 1


def unpacked(payload: np.ndarray, signal: Any) -> Array:
    """The raw numbers (frames,) of a signal in bytes (frames, size), before scale and offset."""
    little = signal.byte_order == "little_endian"
    first, length = _first_bit(signal), int(signal.length)
    weights = np.left_shift(np.uint64(1), np.arange(length, dtype=np.uint64))
    found = np.empty(len(payload), dtype=np.uint64)
    for begin in range(0, len(payload), BLOCK):
        bits = np.unpackbits(payload[begin : begin + BLOCK], axis=1, bitorder="little" if little else "big")[
            :, first : first + length
        ]
        bits = bits if little else bits[:, ::-1]
        found[begin : begin + BLOCK] = bits.astype(np.uint64) @ weights[: bits.shape[1]]
    if signal.is_float:
        kind = {16: np.float16, 32: np.float32, 64: np.float64}[length]
        return np.asarray(found.astype(f"<u{length // 8}").view(kind), dtype=np.float64)
    if not signal.is_signed:
        return found.astype(np.float64)
    shift = np.uint64(64 - length)
    return np.asarray(np.left_shift(found, shift).view(np.int64) >> np.int64(64 - length), dtype=np.float64)
