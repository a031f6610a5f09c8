"""What a person may have meant: units in key names, misspelt keys, values in another unit."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_RAD = 57.29577951308232

UNITS: dict[str, dict[str, tuple[float, str]]] = {
    "time": {"s": (1, "s"), "ms": (1e-3, "ms"), "us": (1e-6, "µs"), "min": (60, "min"), "h": (3600, "h")},
    "length": {"mm": (1, "mm"), "m": (1000, "m"), "cm": (10, "cm"), "um": (1e-3, "µm")},
    "angle": {"deg": (1, "°"), "rad": (_RAD, "rad"), "mrad": (_RAD * 1e-3, "mrad")},
    "torque": {
        "nmm": (1, "N·mm"),
        "mnm": (1, "mN·m"),
        "nm": (1000, "N·m"),
        "unm": (1e-3, "µN·m"),
        "ncm": (10, "N·cm"),
    },
    "rate": {
        "deg_s": (1, "°/s"),
        "rad_s": (_RAD, "rad/s"),
        "rpm": (6, "rpm"),
        "deg_per_s": (1, "°/s"),
        "rad_per_s": (_RAD, "rad/s"),
    },
    "acceleration": {"deg_s2": (1, "°/s²"), "rad_s2": (_RAD, "rad/s²")},
    "frequency": {"hz": (1, "Hz"), "khz": (1000, "kHz"), "mhz": (1e6, "MHz")},
    "modulus": {"gpa": (1, "GPa"), "mpa": (1e-3, "MPa"), "pa": (1e-9, "Pa")},
    "density": {"g_cm3": (1, "g/cm³"), "kg_m3": (1e-3, "kg/m³")},
    "bitrate": {"kbit_s": (1, "kbit/s"), "bit_s": (1e-3, "bit/s"), "mbit_s": (1000, "Mbit/s")},
    "gain": {"per_s": (1, "1/s"), "per_ms": (1000, "1/ms")},
    "droop": {"deg_s_per_nmm": (1, "°/s per N·mm"), "rad_s_per_nmm": (_RAD, "rad/s per N·mm")},
}
"""Key suffixes by dimension, with the factor to the first of their kind and the symbol a person reads."""

_SUFFIXES = sorted(
    ((suffix, dimension) for dimension, units in UNITS.items() for suffix in units),
    key=lambda entry: -len(entry[0]),
)


def split_unit(key: str) -> tuple[str, str, str]:
    """("settle", "s", "time") for "settle_s"; the last two empty when the key names no known unit."""
    for suffix, dimension in _SUFFIXES:
        if key.endswith("_" + suffix):
            return key[: -len(suffix) - 1], suffix, dimension
    return key, "", ""


def symbol(key: str) -> str:
    """ " N·mm" for "torque_limit_nmm" (with the space, none before °); empty without a unit."""
    _, suffix, dimension = split_unit(key)
    if not suffix:
        return ""
    shown = UNITS[dimension][suffix][1]
    return shown if shown.startswith("°") else f" {shown}"


def key_endings(unit: str) -> tuple[str, ...]:
    """What the name of a value in `unit` may end in: "nmm_per_rad" for "N·mm/rad", "deg_s" for "°/s".

    Empty for a plain ratio, "1". Brackets and the dots of products are left out.
    """
    above, *below = unit.replace("°", "deg").replace("²", "2").replace("³", "3").split("/")
    written = "_per_".join(["" if above == "1" else above, *below]).replace(" per ", "_per_")
    ending = re.sub(r"[^a-z0-9_]", "", written.lower().replace("µ", "u"))
    ending = ending.removeprefix("1_").lstrip("_")
    return tuple(dict.fromkeys([ending, re.sub("_per_s(?![a-z])", "_s", ending)])) if ending else ()


def number(value: float) -> str:
    """A number as a person writes it: no float dust, no needless exponent."""
    return f"{value:.6g}"


def meant_key(
    key: str, value: object, allowed: Iterable[str], taken: Iterable[str]
) -> tuple[str, str] | None:
    """The allowed key that a person may have meant by `key`, and the hint that says so."""
    taken = set(taken)
    free = [k for k in allowed if k not in taken]
    stem, suffix, dimension = split_unit(key.lower())
    for candidate in free:
        other_stem, other_suffix, other_dimension = split_unit(candidate)
        if other_stem != stem or candidate == key.lower():
            continue
        if not suffix and other_suffix:
            return candidate, f"did you mean {candidate}? (the unit belongs to the name)"
        if dimension == other_dimension and suffix != other_suffix:
            units = UNITS[dimension]
            if isinstance(value, int | float) and not isinstance(value, bool):
                converted = float(value) * units[suffix][0] / units[other_suffix][0]
                written = number(converted)
                written = written if any(c in written for c in ".en") else f"{written}.0"
                return candidate, f"did you mean {candidate}: {written}?"
            return candidate, f"did you mean {candidate}, in {units[other_suffix][1]}?"
    close = difflib.get_close_matches(key.lower(), free, n=1, cutoff=0.6)
    return (close[0], f"did you mean {close[0]}?") if close else None


def meant_value(
    key: str, value: float, lower: float | None, upper: float | None, *, strict: bool = False
) -> str:
    """ " ; did you mean 5?" when `value` lies in the range once read in another unit; empty otherwise."""

    def fits(candidate: float) -> bool:
        above = lower is None or candidate > lower or (candidate == lower and not strict)
        return above and (upper is None or candidate <= upper)

    _, suffix, dimension = split_unit(key)
    if not suffix or value == 0:
        return ""
    units = UNITS[dimension]
    if value < 0:
        return f"; did you mean {number(-value)}?" if fits(-value) else ""
    for other, (factor, shown) in units.items():
        candidate = value * factor / units[suffix][0]
        if other != suffix and candidate != value and fits(candidate):
            return f"; did you mean {number(candidate)} ({number(value)} {shown})?"
    return ""


def number_from_text(key: str, text: str) -> str:
    """What to write instead of `text` where a number belongs, as a hint; empty when nobody can tell."""
    match = re.fullmatch(r"\s*([-+]?[0-9][0-9_ ']*(?:[.,][0-9]+)?(?:[eE][-+]?[0-9]+)?)\s*([^\s0-9].*)?", text)
    if match is None:
        return ""
    digits = re.sub(r"[_ ']", "", match[1]).replace(",", ".")
    value = float(digits)
    unit = (match[2] or "").strip()
    _, suffix, dimension = split_unit(key)
    if not unit or not suffix:
        return f"; write {number(value)}"
    plain = {"deg": "°", "degrees": "°", "nmm": "N·mm", "n mm": "N·mm", "n·mm": "N·mm", "us": "µs"}
    wanted = plain.get(unit.lower(), unit)
    for factor, shown in UNITS[dimension].values():
        if shown.lower() == wanted.lower() or shown.replace("·", "").lower() == wanted.lower():
            converted = value * factor / UNITS[dimension][suffix][0]
            return f"; write {number(converted)} alone, the unit is in the key"
    return "; write the number alone, the unit is in the key"
