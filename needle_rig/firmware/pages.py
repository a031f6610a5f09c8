"""Calibration pages as they lie in the nodes' flash: the layout of firmware/core/nr_calibration.h."""

from __future__ import annotations

import binascii
import datetime
import io
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.config.regular_file import read_regular
from needle_rig.errors import BadInput
from needle_rig.firmware.pins import PAGE_SIZE

ADDRESS = 0x080E0000
"""Sector 11 of the STM32F405's flash."""
HALL_SENSORS = 4
NEUTRAL_MID_COUNTS = 2048
NEUTRAL_DUTY_PER_VELOCITY = 1193

LIMIT_BYTES = 1_000_000
"""A page takes 1 kB of Intel hex; a tool that writes its whole sector of 128 kB makes 360 kB."""

_HEADER = struct.Struct("<IIIHH")
_MAGIC = {"hall": 0x314C4148, "torque": 0x31515254, "drive": 0x31565244}


@dataclass(frozen=True)
class HallSensorPage:
    """One sensor: counts to an angle.

    s = (sine − sine_offset)·sine_gain, c likewise; raw = atan2(s, c);
    angle = raw − zero − Σ amplitude_k·sin(k·raw + phase_k), k = 1, 2. Offsets in counts, angles in rad.
    """

    sine_offset: float = NEUTRAL_MID_COUNTS
    cosine_offset: float = NEUTRAL_MID_COUNTS
    sine_gain: float = 1.0
    cosine_gain: float = 1.0
    zero_rad: float = 0.0
    amplitude_rad: tuple[float, float] = (0.0, 0.0)
    phase_rad: tuple[float, float] = (0.0, 0.0)


def hall_page(sensors: Sequence[HallSensorPage], serial: int, date: datetime.date) -> bytes:
    """The Hall node's page; always four sensors, those that are missing neutral."""
    four = [*sensors, *[HallSensorPage()] * (HALL_SENSORS - len(sensors))]
    content = b"".join(
        struct.pack(
            "<9i",
            *(round(offset * 256) for offset in (sensor.sine_offset, sensor.cosine_offset)),
            *(round(gain * 2**14) for gain in (sensor.sine_gain, sensor.cosine_gain)),
            *(round(angle * 1e6) for angle in (sensor.zero_rad, *sensor.amplitude_rad, *sensor.phase_rad)),
        )
        for sensor in four
    )
    return _sealed("hall", content, serial, date)


def torque_page(offset_counts: float, nmm_per_count: float, serial: int, date: datetime.date) -> bytes:
    """The torque node's page: torque = (counts − offset)·gain."""
    gain = nmm_per_count / 1e-5
    return _sealed("torque", struct.pack("<ii", round(offset_counts), round(gain * 2**24)), serial, date)


def drive_page(
    counts_per_turn: int, serial: int, date: datetime.date, duty_per_velocity: int = NEUTRAL_DUTY_PER_VELOCITY
) -> bytes:
    """The drive node's page; a negative count a turn turns the encoder around."""
    return _sealed("drive", struct.pack("<ii", counts_per_turn, duty_per_velocity), serial, date)


def write_page(path: Path, page: bytes) -> None:
    """`page` as an Intel hex file at its place in flash."""
    from intelhex import IntelHex

    image = IntelHex()
    image.puts(ADDRESS, page.rstrip(b"\xff"))
    image.write_hex_file(str(path))


def read_page(path: Path) -> bytes:
    """The page in a hex file, as flash holds it. Raises BadInput when there is none."""
    from intelhex import HexReaderError, IntelHex

    raw = read_regular(path, str(path), LIMIT_BYTES, missing=lambda: "; make one: needle-rig calibrate")
    try:
        image = IntelHex(io.StringIO(raw.decode("ascii")))
    except (UnicodeDecodeError, HexReaderError) as error:
        raise BadInput(
            f"{path}: no calibration page can be read ({error}); make one: needle-rig calibrate"
        ) from None
    image.padding = 0xFF
    page: bytes = image.tobinstr(start=ADDRESS, size=PAGE_SIZE)
    if not page.rstrip(b"\xff"):
        raise BadInput(f"{path}: holds nothing at 0x{ADDRESS:08X}, where the page belongs")
    return page


def _sealed(kind: str, content: bytes, serial: int, date: datetime.date) -> bytes:
    day = date.year * 10000 + date.month * 100 + date.day
    checksum = binascii.crc_hqx(content, 0xFFFF)
    return (_HEADER.pack(_MAGIC[kind], serial, day, len(content), checksum) + content).ljust(
        PAGE_SIZE, b"\xff"
    )
