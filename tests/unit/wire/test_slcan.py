"""Lines of an slcan adapter against python-can's own reading of them."""

from __future__ import annotations

import queue
import random
from types import SimpleNamespace

import can
from can.interfaces.slcan import slcanBus
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.wire.slcan import SlcanStream, slcan_line

frames = st.tuples(st.integers(0, 0x7FF), st.binary(max_size=8))
letters = st.text("0123456789abcdefABCDEFtTrRzZ\a ", max_size=40).map(str.encode)


def cans(line: bytes) -> tuple[int, bytes] | None:
    """What python-can takes a line for; None where it is no plain frame."""
    waiting: queue.SimpleQueue[str] = queue.SimpleQueue()
    waiting.put(line.decode())
    try:
        message, _ = slcanBus._recv_internal(SimpleNamespace(_queue=waiting), 0)  # type: ignore[arg-type]
    except (ValueError, IndexError, KeyError):
        return None
    if message is None or message.is_extended_id or message.is_remote_frame or message.is_fd:
        return None
    return message.arbitration_id, bytes(message.data)


@given(st.lists(frames, max_size=20), st.randoms())
def test_frames_are_found_however_the_stream_is_cut(
    sent: list[tuple[int, bytes]], source: random.Random
) -> None:
    text = b"".join(slcan_line(*frame) for frame in sent)
    stream, found = SlcanStream(), []
    while text:
        size = source.randint(1, 40)
        found += stream.feed(text[:size])
        text = text[size:]
    assert found == sent


@given(frames)
def test_a_line_is_what_python_can_sends(frame: tuple[int, bytes]) -> None:
    said: list[str] = []
    message = can.Message(arbitration_id=frame[0], data=frame[1], is_extended_id=False)
    port = SimpleNamespace(write_timeout=None)
    slcanBus.send(SimpleNamespace(_write=said.append, serialPortOrig=port), message)  # type: ignore[arg-type]
    assert slcan_line(*frame) == said[0].encode() + b"\r"
    assert cans(said[0].encode()) == frame


@given(letters)
def test_no_line_is_taken_for_another_frame_than_python_can_does(line: bytes) -> None:
    found = SlcanStream().feed(line + b"\r")
    assert all(frame in [cans(part) for part in line.split(b"\a")] for frame in found)


def test_a_time_stamp_is_left_out_and_so_are_other_kinds_of_frame() -> None:
    stream = SlcanStream()
    assert stream.feed(b"t1012AABB1234\rT000001012AABB\rr1012\rt1013AABB\rz\r\a") == [(0x101, b"\xaa\xbb")]


def test_noise_without_an_end_is_not_kept() -> None:
    stream = SlcanStream()
    stream.feed(b"x" * 100_000)
    assert len(stream._rest) == 64
    assert stream.feed(b"\r" + slcan_line(1, b"a")) == [(1, b"a")]
