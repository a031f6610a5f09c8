import math
import random

import pytest
from crccheck.crc import Crc16CcittFalse
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.wire.hall_frames import (
    MAX_SENSORS,
    HallStream,
    cobs_decode,
    cobs_encode,
    decode_hall,
    encode_hall,
)

angles = st.lists(st.floats(-20, 20), min_size=1, max_size=MAX_SENSORS)


def frame(counter: int = 7) -> bytes:
    return encode_hall(counter, 123_456 + counter * 1000, [0.1, -2.0, 3.1, 0.0], [40_000] * 4)


@given(st.binary(max_size=1200))
def test_cobs_round_trip_without_zeros(content: bytes) -> None:
    stuffed = cobs_encode(content)
    assert b"\0" not in stuffed
    assert cobs_decode(stuffed) == content
    assert len(stuffed) <= len(content) + 2 + len(content) // 254


@pytest.mark.parametrize(
    ("content", "stuffed"),
    [
        (b"", "01"),
        (b"\0", "01 01"),
        (b"\0\0", "01 01 01"),
        (b"\x11\x22\0\x33", "03 11 22 02 33"),
        (b"\x11\0\0\0", "02 11 01 01 01"),
    ],
)
def test_cobs_of_the_literature(content: bytes, stuffed: str) -> None:
    assert cobs_encode(content) == bytes.fromhex(stuffed)


@given(st.binary(max_size=300))
def test_cobs_decode_refuses_or_round_trips(stuffed: bytes) -> None:
    content = cobs_decode(stuffed)
    if content is not None:
        assert b"\0" not in stuffed
        assert cobs_decode(cobs_encode(content)) == content


@given(angles, st.integers(0, 10**6), st.integers(0, 2**40), st.data())
def test_readings_survive_the_wire(
    angle_rad: list[float], counter: int, time_us: int, data: st.DataObject
) -> None:
    count = len(angle_rad)
    field = data.draw(st.lists(st.integers(0, 65535), min_size=count, max_size=count))
    sent = encode_hall(counter, time_us, angle_rad, field)
    assert sent.index(0) == len(sent) - 1
    got = decode_hall(sent[:-1])
    assert got is not None
    assert (got.counter, got.field) == (counter % 65536, tuple(field))
    assert got.node_time_s == pytest.approx((time_us % 2**32) * 1e-6)
    for found, wanted in zip(got.angle_rad, angle_rad, strict=True):
        assert abs(found) <= math.pi + 1e-6
        assert abs(math.remainder(found - wanted, math.tau)) <= 0.51e-6


@pytest.mark.parametrize(("angle_rad", "field"), [([], []), ([0.0], []), ([0.0] * 10, [0] * 10)])
def test_frames_that_no_node_could_send_are_not_made(angle_rad: list[float], field: list[int]) -> None:
    with pytest.raises(ValueError, match="give 1 to 9"):
        encode_hall(0, 0, angle_rad, field)


@given(st.lists(st.integers(0, 60), min_size=1, max_size=5), st.binary(max_size=600), st.data())
def test_the_stream_finds_every_frame_after_noise_however_it_is_cut(
    counters: list[int], noise: bytes, data: st.DataObject
) -> None:
    stream = HallStream()
    wire = noise + b"\0" + b"".join(frame(counter) for counter in counters)
    got = []
    while wire:
        size = data.draw(st.integers(1, 200))
        got += [reading.counter for reading in stream.feed(wire[:size])]
        wire = wire[size:]
    assert got[-len(counters) :] == counters


def test_noise_without_an_end_does_not_pile_up() -> None:
    stream = HallStream()
    for _ in range(1000):
        assert not list(stream.feed(b"\xff" * 1000))
    assert len(stream._rest) < 1000
    assert [reading.counter for reading in stream.feed(b"\0" + frame(3))] == [3]
    assert stream.damaged == 1


def check_mutants(count: int, seed: int) -> int:
    """Damage frames at random; what is still taken must have the right CRC by another program."""
    source = random.Random(seed)
    good = frame()[:-1]
    taken = 0
    for _ in range(count):
        bad = bytearray(good)
        kind = source.randrange(4)
        for _ in range(source.randint(1, 6)):
            place = source.randrange(len(bad))
            if kind == 0:
                bad[place] ^= 1 << source.randrange(8)
            elif kind == 1:
                bad[place] = source.randrange(256)
            elif kind == 2 and len(bad) > 1:
                del bad[place]
            else:
                bad.insert(place, source.randrange(256))
        if decode_hall(bytes(bad)) is not None:
            content = cobs_decode(bytes(bad))
            assert content is not None
            assert Crc16CcittFalse.calc(content[:-2]) == int.from_bytes(content[-2:], "little")
            taken += bytes(bad) != good
    return taken


def test_mutated_frames_with_a_wrong_crc_are_never_taken() -> None:
    assert check_mutants(50_000, seed=1) <= 8


@pytest.mark.slow
def test_a_million_mutated_frames() -> None:
    # 16 bits of CRC let one in 65536 random frames by; most of these do less damage than that.
    assert check_mutants(1_000_000, seed=2) <= 60
