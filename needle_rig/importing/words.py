"""A column of words: dates as seconds since 1970, clock times as seconds, others as labels."""

from __future__ import annotations

import datetime
import math
import re
from collections.abc import Sequence
from itertools import product

import numpy as np
import numpy.typing as npt

from needle_rig.importing.recording import MAX_COLUMNS, Column
from needle_rig.numerics import Array

_DAYS = (
    "%Y-%m-%d",
    "%d.%m.%Y",
    "%m/%d/%Y",
    "%Y/%m/%d",
    "%d/%m/%Y",
    "%m-%d-%Y",
    "%d-%m-%Y",
    "%d-%b-%Y",
    "%d %b %Y",
)
_CLOCKS = ("%H:%M:%S", "%H:%M:%S.%f", "%I:%M:%S %p", "%I:%M:%S.%f %p")
FORMS = (*(" ".join(pair) for pair in product(_DAYS, _CLOCKS)), *_CLOCKS)
"""For the standard library's strptime, in the order of trial: one holds for all rows or for none.

A parser that guesses row by row would read 12/02 as December and 13/02 as February in one file.
"""
_FRACTION = re.compile(r"(?<=:\d\d:\d\d)[.,:](\d{1,6})\d*")
_ZONE = re.compile(r" ?(Z|UTC|[+-]\d\d:?\d\d)$")
_MIDNIGHT = datetime.datetime(1900, 1, 1)
_EPOCH = datetime.datetime(1970, 1, 1)
DAY_S = 86400.0


def words_column(name: str, unit: str, parts: Sequence[npt.NDArray[np.bytes_]], codec: str) -> Column:
    """The column of the words in `parts`, which are encoded in `codec`; an empty one is missing."""
    first = next((w for part in parts for w in part if w), b"").decode(codec, "replace")
    for form in FORMS:
        if _moment(first, form) is not None:
            seconds = [_moments(_texts(part, codec), form) for part in parts]
            if all(part is not None for part in seconds):
                values = np.concatenate([part for part in seconds if part is not None])
                known = np.isfinite(values)
                if form in _CLOCKS:  # the day ends at midnight, the recording does not
                    values[known] = np.unwrap(values[known], period=DAY_S)
                return Column(name, "s", values)
    labels: dict[str, float] = {}
    places: list[Array] = []
    for part in parts:
        texts = _texts(part, codec)
        for text in dict.fromkeys(texts):
            if text:
                labels.setdefault(text, float(len(labels)))
        if len(labels) > MAX_COLUMNS:
            fault = (
                f"holds more than {MAX_COLUMNS} different words, neither numbers nor times, as {first[:30]!r}"
            )
            return Column(name, unit, np.full(sum(map(len, parts)), math.nan), fault=fault)
        places.append(np.array([labels.get(text, math.nan) for text in texts]))
    return Column(name, unit, np.concatenate(places), labels=tuple(labels))


def _texts(part: npt.NDArray[np.bytes_], codec: str) -> list[str]:
    return [word.decode(codec, "replace") for word in part.tolist()]


def _moments(texts: Sequence[str], form: str) -> Array | None:
    """Seconds of texts that are all of one form, NaN for empty ones; None otherwise."""
    seconds = []
    for text in texts:
        moment = _moment(text, form) if text else math.nan
        if moment is None:
            return None
        seconds.append(moment)
    return np.array(seconds, dtype=np.float64)


def _moment(text: str, form: str) -> float | None:
    """Seconds since 1970, or since midnight; None for a text of another form."""
    plain = _FRACTION.sub(r".\1", _ZONE.sub("", " ".join(text.replace("T", " ").split())))
    try:
        moment = datetime.datetime.strptime(plain, form)
    except ValueError:
        return None
    return (moment - (_MIDNIGHT if form in _CLOCKS else _EPOCH)).total_seconds()
