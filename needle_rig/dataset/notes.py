"""Notes on many files gathered: what is said of most of them is said once."""

from __future__ import annotations

import re
from collections.abc import Sequence

OFTEN = 3
"""Files from which a note is said once for all of them."""
_PLACED = re.compile(r"(?P<file>[^:\n]+?)(?::\d+)?: (?P<said>.*)", re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])\d[\d,]*(?:\.\d+)?(?![\w.]*\d)")


def gathered(notes: Sequence[str]) -> tuple[str, ...]:
    """The notes, "file: …" or "file:line: …", with those that differ in file and numbers alone as one.

    It stands where the first stood, with each number that differs as "lowest to highest".
    """
    groups: dict[str, list[tuple[str, str, str]]] = {}
    for note in dict.fromkeys(notes):
        placed = _PLACED.fullmatch(note)
        file, said = (placed["file"], placed["said"]) if placed else ("", note)
        groups.setdefault(_NUMBER.sub("#", said), []).append((note, file, said))
    found: list[str] = []
    for group in groups.values():
        files = dict.fromkeys(file for _, file, _ in group)
        if len(files) >= OFTEN:
            found.append(
                f"{group[0][1]} and {len(files) - 1} others: {_ranged([said for *_, said in group])}"
            )
        else:
            found += [note for note, *_ in group]
    return tuple(found)


def _ranged(said: Sequence[str]) -> str:
    """Texts that differ in their numbers alone as one."""
    columns = list(zip(*(_NUMBER.findall(text) for text in said), strict=True))
    ends = iter([(min(c, key=_value), max(c, key=_value)) for c in columns])

    def ranged(_: re.Match[str]) -> str:
        low, high = next(ends)
        return low if _value(low) == _value(high) else f"{low} to {high}"

    return _NUMBER.sub(ranged, said[0])


def _value(number: str) -> float:
    return float(number.replace(",", ""))
