"""Lines of text as small controllers send them: a clock, then numbers, such as `81234, 12.5, 11.9`."""

from __future__ import annotations

import functools
import math
import operator
import re
from collections.abc import Iterator
from dataclasses import dataclass

CLOCK_MODULUS = 2**32
"""millis() and micros() start again here."""

_LONGEST_LINE = 255
_LARGEST = 1e9
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]*)?")


@dataclass(frozen=True, slots=True)
class TextLine:
    """One line: what its clock counted, and its values; NaN where it says nan."""

    clock: int
    values: tuple[float, ...]


def decode_line(line: bytes, *, checksum: bool) -> TextLine | None:
    """The line without its end; None when anything about it is wrong.

    Fields are parted by commas, semicolons, tabs or blanks. With a `checksum` it ends in *HH.
    """
    if checksum:
        line, star, sent = line.rpartition(b"*")
        if not star or sent.upper() != b"%02X" % functools.reduce(operator.xor, line, 0):
            return None
    fields = re.split(r"[,;\s]\s*", line.decode("ascii", "replace").strip())
    clock, values = fields[0], [_value(field) for field in fields[1:]]
    if not re.fullmatch(r"[0-9]{1,10}", clock) or int(clock) >= CLOCK_MODULUS or None in values:
        return None
    return TextLine(int(clock), tuple(value for value in values if value is not None))


def _value(field: str) -> float | None:
    if field.lower() == "nan":
        return math.nan
    if not _NUMBER.fullmatch(field) or abs(float(field)) > _LARGEST:
        return None
    return float(field)


class TextStream:
    """Finds lines in a stream of bytes, however it is cut and whatever noise is in it."""

    def __init__(self, *, checksum: bool) -> None:
        self._checksum = checksum
        self._rest: bytes | None = None
        self.damaged = b""
        """The newest line that could not be read; empty after one that could."""

    def feed(self, data: bytes) -> Iterator[TextLine]:
        """The lines that `data` completes, oldest first. The first piece ever is the rest of a line."""
        *lines, rest = ((self._rest or b"") + data).split(b"\n")
        if lines or self._rest is not None:
            first, self._rest = self._rest is None, rest[-_LONGEST_LINE - 1 :]
            for line in lines[first:]:
                yield from self._read(line.rstrip(b"\r"))

    def _read(self, line: bytes) -> Iterator[TextLine]:
        if not line:
            return
        read = decode_line(line, checksum=self._checksum) if len(line) <= _LONGEST_LINE else None
        self.damaged = line if read is None else b""
        if read is not None:
            yield read
