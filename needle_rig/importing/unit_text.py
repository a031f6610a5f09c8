"""Units as people write them: `[deg]`, `(N·mm)`, `mNm`, `in-lbs`, `usec`; their sizes are pint's."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from needle_rig.importing.unit_library import Dimension, measured

_NUMBER = r"[-+]?(?:\d+(?:[.,]\d*)?|[.,]\d+)"


@dataclass(frozen=True)
class Unit:
    """One unit: `si` is what one of it is in SI, angles in rad; `text` is how it is written here."""

    text: str
    dimension: Dimension
    """other: a unit that is known to be none of those that a channel can have."""
    si: float


NAMED = {
    "time": ("s", "ms", "µs", "ns", "min", "h"),
    "angle": ("deg", "rad", "mrad", "turn", "arcmin"),
    "rate": ("rad/s", "deg/s", "rpm"),
    "length": ("mm", "m"),
    "speed": ("mm/s", "m/s"),
    "force": ("N", "kN"),
    "torque": ("N·m", "N·cm", "N·mm", "mN·m", "µN·m", "ozf·in", "lbf·in", "lbf·ft", "gf·cm", "kgf·cm"),
}
"""What an error offers, by dimension; any other unit of it that pint knows serves as well."""

_WORDS = {
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sek": "s", "sekunden": "s",
    "ms": "ms", "msec": "ms", "msecs": "ms", "millis": "ms", "millisecond": "ms", "milliseconds": "ms",
    "us": "µs", "µs": "µs", "usec": "µs", "usecs": "µs", "microsecond": "µs", "microseconds": "µs",
    "ns": "ns", "nsec": "ns", "nsecs": "ns", "nanosecond": "ns", "nanoseconds": "ns",
    "min": "min", "mins": "min", "minute": "min", "minutes": "min",
    "h": "h", "hr": "h", "hrs": "h", "hour": "h", "hours": "h",
    "°": "deg", "º": "deg", "˚": "deg", "deg": "deg", "degs": "deg", "degree": "deg", "degrees": "deg",
    "rad": "rad", "rads": "rad", "radian": "rad", "radians": "rad",
    "mrad": "mrad", "mrads": "mrad", "milliradian": "mrad", "milliradians": "mrad",
    "turn": "turn", "turns": "turn", "rev": "turn", "revs": "turn", "revolution": "turn",
    "revolutions": "turn", "arcmin": "arcmin",
    "rpm": "rpm", "rev/min": "rpm", "u/min": "rpm", "1/min": "rpm", "min-1": "rpm", "min^-1": "rpm",
    "rev/s": "turn/s", "rps": "turn/s", "mm": "mm",
}  # fmt: skip
"""The field's spellings of times, angles and rates in small letters, as pint has them."""
_OTHER = frozenset({"%", "v", "volts", "a", "amps", "hz", "khz", "lsb", "cts", "ticks", "steps", "raw", "c"})
"""What columns of raw readings are in, which is no unit in pint, or another one there."""
COUNTED = frozenset(
    {"count", "counts", "cts", "lsb", "tick", "ticks", "step", "steps", "raw", "v", "mv", "volt", "volts"}
)
"""Of a raw reading that becomes an angle or a torque by a scale that a person knows."""
_UNCLEAR = frozenset({"grad", "grads", "gon", "mnm/mnm"})
"""The German `grad` is a degree, the English one 1/400 of a turn: told by neither."""
_BETWEEN = r"[\s·.*⋅×∙_-]?"
_TORQUE = re.compile(rf"(?P<prefix>[nµmcdkM]?)(?P<n>[Nn]){_BETWEEN}(?P<length>[mMcCdD]?)(?P<m>[mM])")
_IMPERIAL = re.compile(
    rf"(?P<a>oz|lb|g|kg|kp)s?(?P<f>f?){_BETWEEN}(?P<b>in|ft|cm|mm|m)"
    rf"|(?P<d>in|ft|cm|mm|m){_BETWEEN}(?P<c>oz|lb|g|kg|kp)s?f?",
    re.IGNORECASE,
)

_WRITABLE = re.compile(r"(1/)?[\s()]*[A-Za-zµΩ°%][\w°%·*/^.()\s-]*")
_RATE = re.compile(
    r"(?P<stem>.+?)[_\s](?P<of>deg|rad|rev|mm|cm|m)[_\s]?(?:per|p)?[_\s](?P<per>s|min)2?", re.IGNORECASE
)


@lru_cache(maxsize=4096)
def unit_of(text: str) -> Unit | None:
    """The unit that `text` names, brackets around it or not; None when it names none that is known here.

    Where capitals would change the value (MNm), nothing is taken for granted.
    """
    bare = text.strip().strip("[](){}<>").strip().rstrip(".").replace("μ", "µ")
    low = bare.lower()
    if not bare or len(bare) > 40 or low in _UNCLEAR:
        return None
    if low in COUNTED or low in _OTHER:
        return Unit(bare, "other", float("nan"))
    expression = _WORDS.get(low) or torque_text(bare)
    if expression is None:
        if (_TORQUE.fullmatch(bare) and bare != "nm") or not _WRITABLE.fullmatch(bare):
            return None
        # `m/s2`, `min-1`; a digit after a letter alone is a part of a name, as in S1
        expression = re.sub(r"(?<=[A-Za-z])(\^-?\d|-\d|(?<=/[A-Za-z])\d)", _power, bare)
        # A number in it would scale: such a unit is asked for.
        if re.search(r"(?<!\*\*)(?<!-)\d", expression.removeprefix("1/")):
            return None
    found = measured(expression.replace("·", "*"))
    if found is None:
        return None
    dimension, si = found
    return Unit(expression if dimension != "other" else bare, dimension, si)


def _power(found: re.Match[str]) -> str:
    return f"**{found[0].removeprefix('^')}"


def torque_text(bare: str) -> str | None:
    """A torque as it is written in workshops (`mNm`, `N-cm`, `in-lbs`), as `mN·m`; None for anything else."""
    bare = re.sub(r"^u(?=[Nn])", "µ", bare)
    found = _TORQUE.fullmatch(bare)
    if found is not None:
        prefix, length, rest = found["prefix"], found["length"], found["m"]
        capitals = bare.isupper() or re.sub(r"\W", "", bare).isupper()
        if prefix == "M" or (prefix and found["n"] == "n" and capitals):
            return None
        if capitals and not prefix:  # NM, NMM, NCM: a writer without small letters
            length, rest = length.lower(), "m"
        if found["n"] == "n" and not prefix and not length and rest == "m" and bare == "nm":
            return None  # a nanometre
        if not capitals and (length.isupper() or rest.isupper()):
            return None
        return f"{prefix}N·{length.lower()}m"
    found = _IMPERIAL.fullmatch(bare)
    if found is None:
        return None
    force, length = (found["a"] or found["c"]).lower(), (found["b"] or found["d"]).lower()
    if force in ("g", "kg") and length == "m" and not found["f"]:
        return None
    return f"{'kg' if force == 'kp' else force}f·{length}"


def is_counted(text: str) -> bool:
    """Whether a unit is one of raw readings, which a person's scale makes an angle or a torque."""
    return text.strip().lower() in COUNTED


def known_unit(text: str) -> Unit:
    """A unit that is known to be one. Raises AssertionError."""
    unit = unit_of(text)
    assert unit is not None, text
    return unit


def _is_plain(text: str) -> bool:
    """Whether a text without brackets is a unit for sure: in names, `d`, `day` or `cycle` are words."""
    bare = text.strip().rstrip(".").replace("μ", "µ")
    return bare.lower() in _WORDS or torque_text(bare) is not None


def split_name(name: str) -> tuple[str, str]:
    """A column's name without its unit, and the unit as written there, empty without one.

    `q1 [deg]`, `Mz (N·mm)`, `Torque, N-mm`, `angle/°`, `time_ms`, `base_angle_deg`, `Torque in mNm`.
    """
    shown = name.strip().strip('"').strip()
    rate = _RATE.fullmatch(shown)
    if rate is not None:
        return rate["stem"], f"{rate['of']}/{rate['per']}"
    newtons = re.fullmatch(
        r"(?P<stem>.*(?:force|kraft|load|thrust|\bf[xyz]?))[_\s](?P<unit>k?N)", shown, re.I
    )
    if newtons is not None:
        return newtons["stem"], newtons["unit"]
    for pattern in (
        r"(?P<stem>.*?)\s*[\[({<](?P<unit>[^\])}>]*)[\])}>]\s*",
        r"(?P<stem>.+?)\s*[,;/:|]\s*(?P<unit>[^,;/:|]+)",
        r"(?P<stem>.+?)\s+in\s+(?P<unit>\S+)",
        r"(?P<stem>.+?)[_\s](?P<unit>[A-Za-zµμ°º˚·⋅-]+[_\s]?[A-Za-z]*)",
        r"(?P<stem>.+?)_(?P<unit>[A-Za-zµμ°º˚·⋅-]+)",
    ):
        match = re.fullmatch(pattern, shown)
        if match is None:
            continue
        unit = match["unit"].strip()
        if not re.search(r"[^\W\d_]|°", unit):
            continue
        # A lone capital or an abbreviation at the end of a name (`hall_A`, `sensor C`) is no unit.
        if pattern.startswith("(?P<stem>.*?)") or _is_plain(unit):
            return match["stem"].strip(), unit
    return shown, ""


def number_with_unit(text: str) -> tuple[float, str] | None:
    """(1000.0, "Hz") for "1000 Hz"; None when it is no number."""
    match = re.fullmatch(rf"\s*({_NUMBER}(?:[eE][-+]?\d+)?)\s*(.*?)\s*", text)
    return None if match is None else (float(match[1].replace(",", ".")), match[2])
