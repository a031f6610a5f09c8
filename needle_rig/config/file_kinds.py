"""The one judge of formats: which kind of file a file is, and of which number, by its key `format`.

It is KIND/NUMBER. A newer number is refused in a sentence, an older one is migrated.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable
from typing import Any

from needle_rig.config.places import Places
from needle_rig.records import JsonObject
from needle_rig.version import VERSION

KINDS: dict[str, tuple[str, str]] = {
    "needle-rig": ("a rig file", "name it as config, or as rig"),
    "needle-rig-dataset": ("a dataset", "name its folder as DATA"),
    "needle-rig-settled": ("a dataset of settled values", "name its folder as DATA"),
    "needle-rig-import": ("a mapping of a recording", "give it to needle-rig import"),
    "needle-rig-parameters": ("a parameter set", "name it as parameters"),
    "needle-rig-model": ("a model file", "name it as model"),
    "needle-rig-protocol": ("a protocol", "name it as protocol"),
    "needle-rig-diagnosis": ("a diagnosis", "give it to needle-rig adopt"),
    "needle-rig-watch": ("what a watch keeps of a run", "needle-rig watch reads it from beside the runs"),
    "needle-rig-calibration": ("a calibration", "needle-rig check reads it from its folder"),
    "needle-rig-run": ("a run", "name it as RUN"),
    "needle-rig-backup": ("a backup", "give it to needle-rig restore"),
    "needle-rig-report": ("a report", "unpack it with unzip"),
}
"""Each kind in words, and where a file of it is to be named."""


Migration = Callable[[JsonObject], JsonObject]
MIGRATIONS: dict[str, Migration] = {}
"""From a format that was, `needle-rig-model/1`, to the content of the next number of its kind.

The key `format` follows by itself. Empty: no format has changed yet. A run's content is its attributes."""

_DIGITS = 6
"""Of a number that is believed; what is longer came from no needle-rig."""
_SHOWN_LETTERS = 40


def as_read_here(data: JsonObject, places: Places, *wanted: str, writer: object = None) -> JsonObject:
    """`data` in the one of the formats `wanted` that is of its kind; older ones are migrated, `data` is kept.

    Raises what `judge_format` raises.
    """
    judge_format(data, places, *wanted, writer=writer)
    return migrated(data, *wanted)


def judge_format(data: JsonObject, places: Places, *wanted: str, writer: object = None) -> None:
    """Raise BadInput where no way leads from the format of `data` to one of those `wanted`.

    `writer` is the version of needle-rig that wrote it, where that is known. The sentence stands alone: the
    keys of another format would all be listed as mistakes.
    """
    if _way(data.get("format"), wanted)[-1] not in wanted:
        who = writer or data.get("written_by") or data.get("program")
        raise places.error(("format",), _refusal(data.get("format"), wanted, who))


def migrated(data: JsonObject, *wanted: str) -> JsonObject:
    """`data`, whose format was judged, in the one of the formats `wanted` that is of its kind."""
    for before, after in itertools.pairwise(_way(data.get("format"), wanted)):
        data = {**MIGRATIONS[before](copy.deepcopy(data)), "format": after}
    return data


def _way(given: Any, wanted: tuple[str, ...]) -> list[Any]:
    """The formats from `given`, one migration each, until one is wanted or no migration leads on."""
    way = [given]
    while way[-1] not in wanted and isinstance(way[-1], str) and way[-1] in MIGRATIONS:
        kind, number = _parts(way[-1])
        way.append(f"{kind}/{number + 1}")
    return way


def _parts(form: str) -> tuple[str, int]:
    """Kind and number of a format; the number is -1 where there is none."""
    kind, _, number = form.partition("/")
    return kind, int(number) if number.isdecimal() and len(number) <= _DIGITS else -1


def _refusal(given: object, wanted: tuple[str, ...], writer: object) -> str:
    """Why a file of the format `given` is not read where `wanted` are, and what to do."""
    here = " or ".join(f"{KINDS[_parts(w)[0]][0]} ({w})" for w in wanted)
    if given is None:
        return f"is missing; {here} is read here: write format: {wanted[0]}"
    kind, number = _parts(given) if isinstance(given, str) else ("", -1)
    same = next((w for w in wanted if _parts(w)[0] == kind), None)
    shown = str(given)[:_SHOWN_LETTERS]
    if same is not None and number > _parts(same)[1]:
        who = f"needle-rig {str(writer)[:_SHOWN_LETTERS]}" if writer else "a newer needle-rig"
        return (
            f"{KINDS[kind][0]} written by {who}, format {number}; needle-rig {VERSION} reads up to"
            f" {_parts(same)[1]}: upgrade needle-rig, or restore a backup from before"
        )
    if same is not None:
        return (
            f"version {shown.partition('/')[2]!r} of {KINDS[kind][0]} is not known, this needle-rig reads"
            f" {same}; take the needle-rig that wrote it, or write format: {same}"
        )
    if kind in KINDS:
        what, where = KINDS[kind]
        return f"this is {what} ({shown}), not {here}; {where}"
    return f"{repr(given)[:_SHOWN_LETTERS]} is not known; {here} is read here: write format: {wanted[0]}"
