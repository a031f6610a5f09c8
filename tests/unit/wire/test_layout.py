"""The layouts against cantools, which reads the same DBC in its general way."""

from __future__ import annotations

import random
from types import SimpleNamespace
from typing import Any

import cantools
import pytest

from needle_rig.config.files import find_config_file
from needle_rig.wire.can_frames import _MESSAGES
from needle_rig.wire.layout import Layout

DATABASE: Any = cantools.database.load_file(find_config_file("needle_rig.dbc"))
FRAMES = 2000


@pytest.mark.parametrize(("name", "signals"), _MESSAGES.values(), ids=lambda value: str(value)[:20])
def test_every_frame_reads_as_cantools_reads_it(name: str, signals: tuple[str, ...]) -> None:
    message, source = DATABASE.get_message_by_name(name), random.Random(name)
    layout = Layout(message, signals)
    for _ in range(FRAMES):
        data = source.randbytes(8)
        wanted = message.decode(data, decode_choices=False)
        read = layout.decode(data)
        assert read == [wanted[signal] for signal in signals]
        assert [type(value) for value in read] == [type(wanted[signal]) for signal in signals]


@pytest.mark.parametrize(("name", "signals"), _MESSAGES.values(), ids=lambda value: str(value)[:20])
def test_every_value_is_written_as_cantools_writes_it(name: str, signals: tuple[str, ...]) -> None:
    message, source = DATABASE.get_message_by_name(name), random.Random(name)
    layout = Layout(message, signals)
    for _ in range(FRAMES):
        values = {
            signal.name: source.uniform(signal.minimum, signal.maximum)
            if isinstance(signal.scale, float)
            else source.randint(int(signal.minimum), int(signal.maximum))
            for signal in message.signals
            if signal.name != "checksum"
        }
        wanted = message.encode({**values, "checksum": 0}, strict=False)
        assert layout.encode(*(values[signal] for signal in signals)) == wanted


@pytest.mark.parametrize(
    "change", [{"byte_order": "big_endian"}, {"is_float": True}, {"offset": 1}, {"is_multiplexer": True}]
)
def test_a_signal_of_another_form_is_refused(change: dict[str, object]) -> None:
    plain = {"name": "x", "byte_order": "little_endian", "is_float": False, "offset": 0}
    plain |= {"is_multiplexer": False, "start": 0, "length": 8, "is_signed": False, "scale": 1}
    usual = SimpleNamespace(name="X", length=8, signals=[SimpleNamespace(**plain)])
    other = SimpleNamespace(name="X", length=8, signals=[SimpleNamespace(**{**plain, **change})])
    assert Layout(usual, ("x",)).decode(b"\x05" + bytes(7)) == [5]
    with pytest.raises(ValueError, match=r"X\.x: give an integer, low byte first, offset 0"):
        Layout(other, ("x",))
    with pytest.raises(ValueError, match="X: x; the nodes use y"):
        Layout(usual, ("y",))
