"""Raw Data Transfer of ATI's network sensors: datagrams, and the page that tells their scale.

Of ATI, Net F/T manual 9620-05-NET FT, chapters 9.1 and 10, and Ethernet Axia manual 9610-05, chapter 12.
Multi-byte values are sent high byte first.
"""

from __future__ import annotations

import math
import re
import struct
from dataclasses import dataclass
from xml.etree import ElementTree

from needle_rig.errors import BadInput

PAGE = "netftapi2.xml"
STOP, START = 0x0000, 0x0002
SEQUENCE_MODULUS = 2**32
INTERNAL_RATE_HZ = 7000.0
"""At which `ft_sequence` counts where the page does not tell (`runrate`)."""

_HEADER = 0x1234
_REQUEST = struct.Struct(">HHI")
_RECORD = struct.Struct(">III6i")
_NM_PER_LBF_IN = 0.1129848290276167
_UNITS_NM = {
    "nm": 1.0,
    "nmm": 1e-3,
    "knm": 1e3,
    "lbfin": _NM_PER_LBF_IN,
    "lbfft": 12.0 * _NM_PER_LBF_IN,
    "kgfcm": 9.80665e-2,
}
"""N·m in the unit of torque that the page names, its letters alone."""


@dataclass(frozen=True, slots=True)
class RdtRecord:
    """One sample. `status` is 0 when nothing is wrong; forces and torques are counts of x, y, z."""

    rdt_sequence: int
    ft_sequence: int
    status: int
    force: tuple[int, int, int]
    torque: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class SensorPage:
    """What the sensor says of itself."""

    counts_per_nm: float
    internal_rate_hz: float


def encode_request(command: int) -> bytes:
    """A request; START asks for records without end."""
    return _REQUEST.pack(_HEADER, command, 0)


def decode_record(data: bytes) -> RdtRecord | None:
    """The record in a datagram; None when it is none."""
    if len(data) != _RECORD.size:
        return None
    rdt, ft, status, *values = _RECORD.unpack(data)
    fx, fy, fz, tx, ty, tz = values
    return RdtRecord(rdt, ft, status, (fx, fy, fz), (tx, ty, tz))


def decode_page(content: bytes) -> SensorPage:
    """The sensor's page. Raises BadInput with what it lacks."""
    if b"<!" in content:  # a document type, whose entities could grow without end
        raise BadInput(f"{PAGE} has more in it than values; is this the sensor's address?")
    try:
        root = ElementTree.fromstring(content)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise BadInput(f"{PAGE} is no XML: {error}; is this the sensor's address?") from None
    said = {element.tag.rpartition("}")[2].lower(): (element.text or "").strip() for element in root.iter()}
    if said.get("comrdte", "enabled").lower() not in ("enabled", "1"):
        raise BadInput("the sensor does not send by RDT; enable it on its page Communications")
    unit = said.get("scfgtu", "")
    unit_nm = _UNITS_NM.get(re.sub("[^a-z]", "", unit.lower()))
    if unit_nm is None:
        raise BadInput(f"{PAGE}: the unit of torque, scfgtu, is {unit!r}; set N-m on its page Configurations")
    counts = _positive(said.get("cfgcpt", ""))
    if counts is None:
        raise BadInput(
            f"{PAGE}: counts per torque, cfgcpt, is {said.get('cfgcpt', '')!r}, no positive number"
        )
    return SensorPage(counts / unit_nm, _positive(said.get("runrate", "")) or INTERNAL_RATE_HZ)


def _positive(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if 0.0 < value < math.inf else None
