"""Bytes of a CSV file to numbers, compiled: a few nanoseconds a character."""

from __future__ import annotations

import numba
import numpy as np

SHORT, LONG, BAD = 1, 2, 3


@numba.njit(cache=True, nogil=True)
def parse_rows(  # type: ignore[no-untyped-def]
    data, at, at_line, n_columns, text_at, delimiter, decimal, values, line, text_start, text_length
):
    """Fill rows until the arrays or the data end.

    Returns rows, the offset and line to go on from (of the bad row after an error), an error code,
    the column (or the number of fields) and the bounds of the bad field.
    """
    size = data.size
    row = 0
    while row < values.shape[0] and at < size:
        row_start = at
        blank = True
        j = at
        while j < size and data[j] != 10:
            if data[j] != 32 and data[j] != 13:
                blank = False
            j += 1
        row_end = j
        if blank:
            at = row_end + 1
            at_line += 1
            continue
        column = 0
        number = 0
        i = row_start
        while True:
            field_start = i
            while i < row_end and data[i] != delimiter:
                i += 1
            field_end = i
            if column >= n_columns:
                return row, row_start, at_line, 2, column, field_start, field_end
            if column == text_at:
                text_start[row] = field_start
                text_length[row] = field_end - field_start
            else:
                ok, value = _number(data, field_start, field_end, decimal)
                if not ok:
                    return row, row_start, at_line, 3, column, field_start, field_end
                values[row, number] = value
                number += 1
            column += 1
            if i >= row_end:
                break
            i += 1
        if column < n_columns:
            return row, row_start, at_line, 1, column, row_start, row_end
        line[row] = at_line
        row += 1
        at = row_end + 1
        at_line += 1
    return row, min(at, size), at_line, 0, 0, 0, 0


@numba.njit(cache=True, nogil=True)
def _number(data, start, end, decimal):  # type: ignore[no-untyped-def]
    """Whether the field is a number (or empty, NaN), and it; exact to the last bit but one."""
    while start < end and (data[start] == 32 or data[start] == 34):
        start += 1
    while end > start and (data[end - 1] == 32 or data[end - 1] == 13 or data[end - 1] == 34):
        end -= 1
    if start == end:
        return True, np.nan
    i = start
    negative = False
    if data[i] == 45 or data[i] == 43:
        negative = data[i] == 45
        i += 1
        if i == end:
            return negative, np.nan  # a lone minus stands for "no value"
    letter = data[i] | 32
    if letter == 110:  # nan, na, null, none, n/a
        return end - i <= 4, np.nan
    mantissa = np.int64(0)
    digits = 0
    kept = 0
    exponent = 0
    point = False
    while i < end:
        c = data[i]
        if c >= 48 and c <= 57:
            digits += 1
            if kept < 18:
                mantissa = mantissa * 10 + np.int64(c - 48)
                if mantissa > 0:
                    kept += 1
                if point:
                    exponent -= 1
            elif not point:
                exponent += 1
        elif c == decimal and not point:
            point = True
        else:
            break
        i += 1
    if digits == 0:
        return False, np.nan
    if i < end:
        if data[i] | 32 != 101:
            return False, np.nan
        i += 1
        sign = 1
        if i < end and (data[i] == 45 or data[i] == 43):
            sign = -1 if data[i] == 45 else 1
            i += 1
        if i == end:
            return False, np.nan
        power = 0
        while i < end:
            if data[i] < 48 or data[i] > 57:
                return False, np.nan
            power = min(power * 10 + int(data[i] - 48), 10_000)
            i += 1
        exponent += sign * power
    value = float(mantissa)
    if exponent < 0:
        value = value / 10.0 ** min(-exponent, 300)
    elif exponent > 0:
        value = value * 10.0 ** min(exponent, 300)
    return True, -value if negative else value


@numba.njit(cache=True, nogil=True)
def text_changes(data, start, length):  # type: ignore[no-untyped-def]
    """True where a row's text differs from that of the row before."""
    change = np.ones(start.size, dtype=np.bool_)
    for row in range(1, start.size):
        if length[row] != length[row - 1]:
            continue
        same = True
        for i in range(length[row]):
            if data[start[row] + i] != data[start[row - 1] + i]:
                same = False
                break
        change[row] = not same
    return change
