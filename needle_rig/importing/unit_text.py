"""Units as people write them: `[deg]`, `(N·mm)`, `mNm`, `rad`, `usec`; to a dimension and a factor to SI."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

_NUMBER = r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)"


@dataclass(frozen=True)
class Unit:
    """One unit: `si` is what one of it is in s, rad or N·m; `text` is how it is written here."""

    text: str
    dimension: str
    """time, angle or torque; other: a unit that is known to be none of them."""
    si: float


_TIME = {"s": 1.0, "ms": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0}
_ANGLE = {"deg": math.pi / 180, "rad": 1.0, "mrad": 1e-3, "turn": 2 * math.pi, "arcmin": math.pi / 10800}
_TORQUE = {
    "N·m": 1.0,
    "N·cm": 1e-2,
    "N·mm": 1e-3,
    "mN·m": 1e-3,
    "µN·m": 1e-6,
    "nN·m": 1e-9,
    "kN·m": 1e3,
    "mN·mm": 1e-6,
    "ozf·in": 7.0615518333333e-3,
    "lbf·in": 0.1129848290276167,
    "gf·cm": 9.80665e-5,
    "kgf·cm": 9.80665e-2,
}
UNITS = {
    text: Unit(text, dimension, si)
    for dimension, table in (("time", _TIME), ("angle", _ANGLE), ("torque", _TORQUE))
    for text, si in table.items()
}
"""Units that a mapping can name."""

_WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s",
    "msec": "ms", "millisecond": "ms", "milliseconds": "ms",
    "us": "µs", "usec": "µs", "microsecond": "µs", "microseconds": "µs",
    "nsec": "ns", "nanosecond": "ns", "nanoseconds": "ns",
    "minute": "min", "minutes": "min", "hr": "h", "hour": "h", "hours": "h",
    "°": "deg", "degree": "deg", "degrees": "deg", "grad": "", "gon": "",
    "radian": "rad", "radians": "rad", "milliradian": "mrad", "milliradians": "mrad",
    "rev": "turn", "revs": "turn", "revolution": "turn", "revolutions": "turn", "turns": "turn",
}  # fmt: skip
"""Other spellings; the German `grad` is a degree and the English one 1/400 of a turn: told by neither."""
_OTHER = frozenset(
    {
        *("v", "mv", "volt", "volts", "a", "ma", "amp", "amps", "ampere", "w", "hz", "khz", "%", "lsb"),
        *("n", "mn", "kn", "newton", "nm/s", "kg", "g", "m", "mm", "cm", "um", "µm", "m/s", "mm/s", "m/s2"),
        *("°c", "c", "degc", "k", "bar", "pa", "kpa", "mpa", "count", "counts", "cts", "1/s"),
        *("deg/s", "°/s", "rad/s", "rpm", "°/s2", "rad/s2"),
    }
)
_TORQUE_TEXT = re.compile(r"(n|µ|u|m|k)?n[\s·.*⋅×_-]?(m|c)?m", re.IGNORECASE)
_IMPERIAL = re.compile(r"(oz|lb|g|kg)f?[\s·.*⋅×_-]?(in|cm)|(in|cm)[\s·.*⋅×_-]?(oz|lb|g|kg)f?", re.IGNORECASE)


def unit_of(text: str) -> Unit | None:
    """The unit that `text` names, brackets around it or not; None when it names none that is known here.

    Where capitals would change the value (MNm), nothing is taken for granted.
    """
    bare = text.strip().strip("[](){}").strip().replace("μ", "µ").replace("^", "")
    if not bare:
        return None
    low = bare.lower()
    if low in _WORDS:
        low = _WORDS[low]
    if low in _TIME or low in _ANGLE:
        return UNITS[low]
    found = _TORQUE_TEXT.fullmatch(bare)
    if found and not (found[1] or "").isupper() and found[0].upper() != bare:
        prefix = (found[1] or "").replace("u", "µ")
        text = f"{prefix}N·{(found[2] or '').lower()}m"
        return UNITS.get(text)
    if found and bare in ("NM", "NMM", "NCM"):
        return UNITS[f"N·{(found[2] or '').lower()}m"]
    found = _IMPERIAL.fullmatch(bare)
    if found:
        force, length = (found[1] or found[4]).lower(), (found[2] or found[3]).lower()
        return UNITS.get(f"{force}f·{length}")
    if bare.lower() in _OTHER:
        return Unit(bare, "other", math.nan)
    return None


def split_name(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit as written there, empty without one.

    `q1 [deg]`, `Mz (N·mm)`, `Torque, N-mm`, `angle/°`, `time_ms`, `base_angle_deg`, `Torque in mNm`.
    """
    shown = name.strip().strip('"').strip()
    for pattern in (
        r"(?P<stem>.*?)\s*[\[({<](?P<unit>[^\])}>]*)[\])}>]\s*",
        r"(?P<stem>.+?)\s*[,;/:|]\s*(?P<unit>[^,;/:|]+)",
        r"(?P<stem>.+?)\s+in\s+(?P<unit>\S+)",
        r"(?P<stem>.+?)[_\s](?P<unit>[A-Za-zµμ°·⋅]+[_\s]?[A-Za-z]*)",
        r"(?P<stem>.+?)_(?P<unit>[A-Za-zµμ°·⋅]+)",
    ):
        match = re.fullmatch(pattern, shown)
        if match is None:
            continue
        unit = match["unit"].strip()
        if not re.search(r"[^\W\d_]|°", unit):
            continue
        if unit_of(unit) is not None or (pattern.startswith("(?P<stem>.*?)") and unit):
            short = unit_of(unit)
            # A lone capital or an abbreviation at the end of a name (`hall_A`, `sensor C`) is no unit.
            if short is not None and short.dimension == "other" and not shown.endswith(("]", ")", "}", ">")):
                continue
            return match["stem"].strip(), unit
    return shown, ""


def number_with_unit(text: str) -> tuple[float, str] | None:
    """(1000.0, "Hz") for "1000 Hz"; None when it is no number."""
    match = re.fullmatch(rf"\s*({_NUMBER}(?:[eE][-+]?\d+)?)\s*(.*?)\s*", text)
    return None if match is None else (float(match[1].replace(",", ".")), match[2])
