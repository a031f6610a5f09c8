"""Bytes of delimited text to numbers, compiled: each number is the float64 nearest to what is written.

What it is not sure of it leaves to `text_rows`. It gives the place of a number whose last bit is in doubt.
Other text is read cell by cell there, which finds the words for an error.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from needle_rig.physics.kernel._cache import kept

UNSURE = -1
"""Instead of a number of rows."""
SPACES = 0
"""As a delimiter: any number of spaces and tabs."""
_LARGEST = 60
"""Decimal exponent; a digit of a sensor lies nearer to 1."""
_FULL = 10**18
"""From here on one digit more would be the twentieth, and 64 bits hold nineteen."""
NONE, SURE, DOUBTED = 0, 1, 2
"""Of a field: it is no number, its number is known, it is one whose last bit is in doubt."""
_EXACT = 1 << 53
"""Below this a whole number is a float64, and so is a power of ten up to 10^22: one rounding is left."""
_EXACT_POWER = 22
_ERROR = 2.0**-98
"""Of a product of two pairs of float64, relatively: at most 2^-100 (Dekker, Numer. Math. 18, 1971)."""
_SPLIT = 134217729.0
"""2^27 + 1: halves a float64 in two of 26 bits (Dekker)."""
_TAB, _LINE, _RETURN, _SPACE, _QUOTE, _PLUS, _MINUS, _ZERO, _NINE = b'\t\n\r "+-09'
_EXPONENTS = tuple(b"eE")


def _powers() -> Any:
    """10^-60 … 10^60, each as the sum of two float64, (121, 2)."""
    rows = []
    for exponent in range(-_LARGEST, _LARGEST + 1):
        power = Fraction(10) ** exponent
        high = float(power)
        rows.append((high, float(power - Fraction(high))))
    return np.array(rows)


POWERS = _powers()


def padded(words: tuple[str, ...]) -> Any:
    """Array (words, longest + 1) of the words as bytes, filled up with zeros."""
    longest = max(map(len, words)) + 1
    return np.array([list(word.encode().ljust(longest, b"\0")) for word in words], dtype=np.uint8)


@kept(nogil=True)
def parsed(text, delimiter, point, is_word, nulls, powers, numbers, spans, doubted):
    """Number of rows in `text`, or UNSURE; numbers (columns, rows) and where words begin and end are filled.

    `doubted` is filled with column, row, begin and end of numbers in doubt; the second answer is their count.
    Blank lines are no rows. A field that is empty or stands in `nulls` (n, length) is NaN.
    """
    size, row, at, doubts = text.size, 0, 0, 0
    while at < size:
        while at < size and _is_blank(text[at]):
            at += 1
        if at >= size or text[at] == _LINE:
            at += 1
            continue
        while at > 0 and text[at - 1] != _LINE:  # a tab may stand for an empty field
            at -= 1
        column, number, word = 0, 0, 0
        while True:
            if column >= is_word.size:
                return UNSURE, 0
            begin, end, at = _field(text, at, delimiter)
            if at < 0:
                return UNSURE, 0
            if is_word[column]:
                spans[row, word, 0], spans[row, word, 1] = begin, end
                word += 1
            else:
                kind, value = _number(text, begin, end, point, powers)
                if kind == DOUBTED:
                    if doubts == doubted.shape[0]:
                        return UNSURE, 0
                    doubted[doubts] = number, row, begin, end
                    doubts += 1
                elif kind == NONE:
                    if not _is_null(text, begin, end, nulls):
                        return UNSURE, 0
                    value = np.nan
                numbers[number, row] = value
                number += 1
            column += 1
            if at >= size or text[at] == _LINE:
                break
            if delimiter != SPACES:
                at += 1
        at += 1
        if column != is_word.size:
            return UNSURE, 0
        row += 1
    return row, doubts


@kept(nogil=True, inline="always")
def _is_blank(byte):
    return byte in (_SPACE, _TAB, _RETURN)


@kept(nogil=True)
def _field(text, at, delimiter):
    """Where the content of a field begins and ends, and where the field does; -1 for quotes in its midst."""
    size = text.size
    first = at
    while at < size and _is_blank(text[at]) and text[at] != delimiter:
        at += 1
    begin = at
    if at < size and text[at] == _QUOTE:
        if delimiter == SPACES or at != first:
            return 0, 0, -1
        at += 1
        begin = at
        while at < size and text[at] != _QUOTE and text[at] != _LINE:
            at += 1
        if at >= size or text[at] == _LINE:
            return 0, 0, -1
        end = at
        at += 1
    else:
        while at < size and text[at] != delimiter and text[at] != _LINE:
            if text[at] == _QUOTE:
                return 0, 0, -1
            if delimiter == SPACES and _is_blank(text[at]):
                break
            at += 1
        end = at
    while at < size and _is_blank(text[at]) and text[at] != delimiter:
        at += 1
    if delimiter != SPACES and at < size and text[at] != delimiter and text[at] != _LINE:
        return 0, 0, -1
    while begin < end and _is_blank(text[begin]):
        begin += 1
    while begin < end and _is_blank(text[end - 1]):
        end -= 1
    return begin, end, at


@kept(nogil=True)
def _number(text, at, end, point, powers):
    """NONE, SURE or DOUBTED, and the number that is sure."""
    negative = at < end and text[at] == _MINUS
    if at < end and (text[at] == _MINUS or text[at] == _PLUS):
        at += 1
    digits, exponent = np.uint64(0), np.int64(0)
    seen, after, cut = False, False, False
    while at < end:
        byte = text[at]
        if _ZERO <= byte <= _NINE:
            seen = True
            if digits < np.uint64(_FULL):
                digits = digits * np.uint64(10) + np.uint64(byte - _ZERO)
                if after:
                    exponent -= 1
            else:
                cut = cut or byte != _ZERO
                if not after:
                    exponent += 1
        elif byte == point and not after:
            after = True
        else:
            break
        at += 1
    if not seen:
        return NONE, 0.0
    if at < end:
        if text[at] != _EXPONENTS[0] and text[at] != _EXPONENTS[1]:
            return NONE, 0.0
        at += 1
        down = at < end and text[at] == _MINUS
        if at < end and (text[at] == _MINUS or text[at] == _PLUS):
            at += 1
        if at >= end or end - at > 4:
            return NONE, 0.0
        written = np.int64(0)
        while at < end:
            if not _ZERO <= text[at] <= _NINE:
                return NONE, 0.0
            written = written * 10 + np.int64(text[at]) - _ZERO
            at += 1
        exponent += -written if down else written
    known, value = _scaled(digits, exponent, powers)
    if cut:
        # what was cut off lies between these two
        other_known, other = _scaled(digits + np.uint64(1), exponent, powers)
        known = known and other_known and value == other
    return SURE if known else DOUBTED, -value if negative else value


@kept(nogil=True)
def _scaled(digits, exponent, powers):
    """Whether digits · 10^exponent is sure to the last bit, and its value."""
    if digits == np.uint64(0):
        return True, 0.0
    if abs(exponent) > _LARGEST:
        return False, 0.0
    high, low = powers[exponent + _LARGEST]
    if digits < np.uint64(_EXACT) and abs(exponent) <= _EXACT_POWER:
        whole = np.float64(digits)
        return True, whole * high if exponent >= 0 else whole / powers[_LARGEST - exponent, 0]
    rest = digits & np.uint64(2047)
    upper, lower = np.float64(digits - rest), np.float64(rest)
    whole = upper + lower
    lower -= whole - upper
    product = whole * high
    left = whole * _SPLIT
    left -= left - whole
    right = high * _SPLIT
    right -= right - high
    small_left, small_right = whole - left, high - right
    error = ((left * right - product) + left * small_right + small_left * right) + small_left * small_right
    error += whole * low + lower * high
    doubt = abs(product) * _ERROR
    # between the two bounds no rounding changes: the value is the nearest one
    return product + (error - doubt) == product + (error + doubt), product + error


@kept(nogil=True)
def _is_null(text, begin, end, nulls):
    for row in range(nulls.shape[0]):
        if end - begin < nulls.shape[1] and nulls[row, end - begin] == 0:
            same = True
            for k in range(end - begin):
                if nulls[row, k] != text[begin + k]:
                    same = False
                    break
            if same:
                return True
    return False
