"""Lines of text: read strictly, found in any stream."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.wire.text_lines import TextStream, decode_line


@pytest.mark.parametrize(
    "line",
    [b"81234, 12.5, -3", b"81234,12.5,-3", b"81234\t12.5\t-3.", b"81234;+12.50; -3.0", b" 81234 12.5  -3 "],
)
def test_numbers_may_be_parted_as_sketches_part_them(line: bytes) -> None:
    read = decode_line(line, checksum=False)
    assert read is not None
    assert (read.clock, read.values) == (81234, (12.5, -3.0))


@pytest.mark.parametrize(
    "line",
    [
        b"12.5, 3.0",
        b"-1, 3.0",
        b"4294967296, 3.0",
        b"1, 3.0x",
        b"1, 0x10",
        b"1, 1e3",
        b"1, inf",
        b"1, 3.0,",
        b"1,, 3.0",
        b"1, 3\xb7",
        b"1, 9999999999",
        b"",
        b"ready",
    ],
)
def test_a_line_with_anything_else_in_it_is_refused_whole(line: bytes) -> None:
    assert decode_line(line, checksum=False) is None


def test_nan_is_a_sensor_that_does_not_answer() -> None:
    read = decode_line(b"1, nan, NaN, 2", checksum=False)
    assert read is not None
    assert [math.isnan(value) for value in read.values] == [True, True, False]


def test_a_checksum_is_the_exclusive_or_as_in_nmea() -> None:
    read = decode_line(b"1, 2*0F", checksum=True)
    assert ord("1") ^ ord(",") ^ ord(" ") ^ ord("2") == 0x0F
    assert read is not None
    assert read.values == (2.0,)
    assert decode_line(b"1, 2*0f", checksum=True) == read


@pytest.mark.parametrize("line", [b"1, 2", b"1, 3*0F", b"1, 2*2", b"1, 2*", b"1, 2*0F0", b"*00"])
def test_a_line_without_its_checksum_is_refused(line: bytes) -> None:
    assert decode_line(line, checksum=True) is None


def test_a_checksum_that_nobody_asked_for_is_no_number() -> None:
    assert decode_line(b"1, 2*0F", checksum=False) is None


@given(st.lists(st.integers(1, 7), min_size=1, max_size=60))
def test_lines_are_found_however_the_stream_is_cut(cuts: list[int]) -> None:
    sent = b"rest of a line\n" + b"".join(b"%d, %d.5\r\n" % (n, n) for n in range(20))
    stream, read, at = TextStream(checksum=False), [], 0
    for cut in [*cuts, len(sent)]:
        read += list(stream.feed(sent[at : at + cut]))
        at += cut
    assert [(line.clock, line.values) for line in read] == [(n, (n + 0.5,)) for n in range(20)]


def test_the_first_piece_is_never_a_line_for_it_may_have_lost_its_beginning() -> None:
    assert [line.clock for line in TextStream(checksum=False).feed(b"34, 5\n1, 5\n")] == [1]


@given(st.lists(st.binary(max_size=400), max_size=8))
def test_whatever_noise_came_the_next_whole_line_is_read(noise: list[bytes]) -> None:
    stream = TextStream(checksum=False)
    for piece in noise:
        list(stream.feed(piece))
    assert [line.clock for line in stream.feed(b"\n7, 1.5\n")][-1:] == [7]
    assert stream.damaged == b""


def test_a_line_that_cannot_be_read_is_kept_to_be_shown() -> None:
    stream = TextStream(checksum=False)
    list(stream.feed(b"\nangle=3\n"))
    assert stream.damaged == b"angle=3"
