"""Compiled reading of text: the nearest float64 or nothing, and plain rows without going cell by cell."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.importing import text_rows
from needle_rig.importing.text_kernel import POWERS, UNSURE, padded, parsed
from needle_rig.importing.text_rows import Shape

NULLS = padded(text_rows.NULLS)


def read(text: str) -> float | None:
    """The number in a table of one cell; None where the kernel leaves it to others."""
    numbers, spans = np.empty((1, 2)), np.empty((2, 0, 2), dtype=np.int64)
    raw = np.frombuffer(text.encode() + b"\n", np.uint8)
    doubted, words = np.empty((2, 4), dtype=np.int64), np.zeros(1, dtype=bool)
    rows, doubts = parsed(raw, ord(";"), ord("."), words, NULLS, POWERS, numbers, spans, doubted)
    assert rows in (1, UNSURE)
    if doubts:
        assert doubted[0].tolist() == [0, 0, 0, len(text)]
    return float(numbers[0, 0]) if rows == 1 and not doubts else None


@settings(max_examples=1000, deadline=None)
@given(st.floats(min_value=1e-40, max_value=1e40), st.integers(0, 40), st.sampled_from("rfge"))
def test_the_nearest_number_or_none(value: float, places: int, form: str) -> None:
    text = repr(value) if form == "r" else f"{value:.{places}{form}}"
    found = read(text)
    assert found is None or found == float(text)


@settings(max_examples=500, deadline=None)
@given(st.integers(0, 10**19 - 1), st.integers(-45, 40))
def test_nineteen_digits(digits: int, exponent: int) -> None:
    text = f"{digits}e{exponent}"
    found = read(text)
    assert found is None or found == float(text)


@pytest.mark.parametrize(
    "text",
    [
        "0.30000000000000004",
        "-1.7976931348623157",
        "6.02214076e23",
        "+5.",
        ".5",
        "-0",
        "1" + 25 * "0",
        "0.10000000000000000000",
    ],
)
def test_what_programs_write_is_read_at_once(text: str) -> None:
    found = read(text)
    assert found == float(text)
    assert math.copysign(1.0, found) == math.copysign(1.0, float(text))


@pytest.mark.parametrize("text", ["9007199254740993", "9007199254740995", "4503599627370497.5"])
def test_halfway_between_two_numbers(text: str) -> None:
    assert read(text) in (None, float(text))


@pytest.mark.parametrize("text", ["1e400", "1e-300", "1.5x", "1,5", "1e", "e5", "--1", "0x10"])
def test_what_is_left_to_others(text: str) -> None:
    assert read(text) is None


@pytest.mark.parametrize(
    ("delimiter", "comma", "rows"),
    [
        (",", False, '1,"2.5",NA,run\n2,3,,"a,b"\n'),
        (";", True, "1;2,5;NaN; run \n\n2;3;--;a,b\r\n"),
        ("\t", False, "1\t2.5\t\trun\n2\t3\tnull\ta,b\n"),
        (" ", False, "  1 2.5   nan run\n2\t3 - a,b  \n"),
    ],
)
def test_plain_rows_are_not_read_cell_by_cell(
    delimiter: str, comma: bool, rows: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = Shape(delimiter, comma, 0, 4, (False, False, False, True), tuple("abcd"), "utf-8", "log.csv")
    path = tmp_path / "log.csv"
    path.write_text(rows, encoding="utf-8", newline="")
    slow = text_rows._cell_by_cell(rows.encode(), 1, shape)
    monkeypatch.delattr(text_rows, "_cell_by_cell")
    values, words = text_rows.read_rows(path, shape)
    np.testing.assert_array_equal(values, [[1.0, 2.0], [2.5, 3.0], [np.nan, np.nan]])
    np.testing.assert_array_equal(values, slow[0])
    assert np.concatenate(words[3]).tolist() == [b"run", b"a,b"] == slow[1][3].tolist()


def test_a_tab_at_the_beginning_is_an_empty_field(tmp_path: Path) -> None:
    shape = Shape("\t", False, 0, 2, (False, False), ("a", "b"), "utf-8", "log.csv")
    path = tmp_path / "log.csv"
    path.write_text("1\t2\n\t3\n \t \n4\t5\n")
    np.testing.assert_array_equal(text_rows.read_rows(path, shape)[0], [[1, np.nan, 4], [2, 3, 5]])


@pytest.mark.parametrize("point", [".", ","])
def test_a_number_in_doubt_is_read_by_itself(
    point: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shape = Shape(";", point == ",", 0, 2, (False, False), ("a", "b"), "utf-8", "log.csv")
    path = tmp_path / "log.csv"
    written = ["9007199254740993", "1e-300", "0.1000000000000000055511151231257827021"]
    path.write_text("".join(f"{k};{each}\n" for k, each in enumerate(written)).replace(".", point))
    monkeypatch.delattr(text_rows, "_cell_by_cell")
    assert text_rows.read_rows(path, shape)[0][1].tolist() == [float(each) for each in written]
