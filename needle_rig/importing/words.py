"""A column of words: dates as seconds since 1970, clock times as seconds, others as labels."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from needle_rig.importing.recording import MAX_COLUMNS, Column
from needle_rig.numerics import Array

_TIME = r"[ T](?P<clock>\d{1,2}:\d{2}:\d{2})(?P<part>[.,]\d{1,6})?\d*Z?"
_DATES = tuple(
    re.compile(day + _TIME)
    for day in (
        r"(?P<y>\d{4})-(?P<m>\d{1,2})-(?P<d>\d{1,2})",
        r"(?P<d>\d{1,2})\.(?P<m>\d{1,2})\.(?P<y>\d{4})",
        r"(?P<m>\d{1,2})/(?P<d>\d{1,2})/(?P<y>\d{4})",
        r"(?P<y>\d{4})/(?P<m>\d{1,2})/(?P<d>\d{1,2})",
        r"(?P<d>\d{1,2})/(?P<m>\d{1,2})/(?P<y>\d{4})",
    )
)
"""In the order in which they are tried: one holds for all rows or for none."""
_CLOCK = re.compile(r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,]\d+)?)")


def words_column(name: str, unit: str, parts: Sequence[npt.NDArray[np.bytes_]], codec: str) -> Column:
    """The column of the words in `parts`, which are encoded in `codec`; an empty one is missing."""
    first = next((w for part in parts for w in part if w), b"").decode(codec, "replace")
    for date in _DATES:
        if date.fullmatch(first):
            seconds = [_dates(_texts(part, codec), date) for part in parts]
            if all(part is not None for part in seconds):
                return Column(name, "s", np.concatenate([part for part in seconds if part is not None]))
    if _CLOCK.fullmatch(first):
        clock = [[_clock_s(text) for text in _texts(part, codec)] for part in parts]
        return Column(name, "s", np.concatenate([np.array(part, dtype=np.float64) for part in clock]))
    labels: dict[str, float] = {}
    places: list[Array] = []
    for part in parts:
        texts = _texts(part, codec)
        for text in dict.fromkeys(texts):
            if text:
                labels.setdefault(text, float(len(labels)))
        if len(labels) > MAX_COLUMNS:
            return Column(name, unit, np.full(sum(map(len, parts)), math.nan))
        places.append(np.array([labels.get(text, math.nan) for text in texts]))
    return Column(name, unit, np.concatenate(places), labels=tuple(labels))


def _texts(part: npt.NDArray[np.bytes_], codec: str) -> list[str]:
    return [word.decode(codec, "replace") for word in part.tolist()]


def _dates(texts: Sequence[str], date: re.Pattern[str]) -> Array | None:
    """Seconds since 1970 of texts that are all dates of one form, NaN for empty ones; None otherwise."""
    written = []
    for text in texts:
        found = date.fullmatch(text)
        if found is None and text:
            return None
        written.append(_iso(found) if found else "NaT")
    try:
        moments = np.array(written, dtype="datetime64[us]")
    except ValueError:  # a thirteenth month
        return None
    seconds = moments.astype(np.int64) / 1e6
    return np.where(np.isnat(moments), math.nan, seconds)


def _iso(found: re.Match[str]) -> str:
    clock = found["clock"].rjust(8, "0")
    part = (found["part"] or "").replace(",", ".")
    return f"{found['y']}-{found['m'].rjust(2, '0')}-{found['d'].rjust(2, '0')}T{clock}{part}"


def _clock_s(text: str) -> float:
    """Seconds since midnight; NaN for what is no time."""
    found = _CLOCK.fullmatch(text)
    if found is None:
        return math.nan
    return float(found[1]) * 3600 + float(found[2]) * 60 + float(found[3].replace(",", "."))
