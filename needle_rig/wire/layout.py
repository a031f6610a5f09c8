"""Where the signals of a CAN message lie in its eight bytes: taken once from the DBC, used for all frames."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

BYTES = 8


class Layout:
    """Integer signals, low byte first, without an offset: (value / scale) as so many bits at a place.

    The general way of cantools, which this is compared with in its test, takes five times as long.
    """

    def __init__(self, message: Any, names: Sequence[str]) -> None:
        """`message` is cantools'; `names` are its signals without the checksum, in the order of the values.

        Raises ValueError when the message is of another form.
        """
        there = {signal.name: signal for signal in message.signals if signal.name != "checksum"}
        if set(there) != set(names) or message.length != BYTES:
            raise ValueError(f"{message.name}: {', '.join(there)}; the nodes use {', '.join(names)}")
        signals = [there[name] for name in names]
        for signal in signals:
            if (
                signal.byte_order != "little_endian"
                or signal.is_float
                or signal.offset
                or signal.is_multiplexer
            ):
                raise ValueError(f"{message.name}.{signal.name}: give an integer, low byte first, offset 0")
        # subtracting the sign bit after flipping it extends the sign; an unsigned signal has none
        self._fields = tuple(
            (s.start, 2**s.length - 1, 2 ** (s.length - 1) if s.is_signed else 0, s.scale) for s in signals
        )

    def decode(self, data: bytes) -> list[Any]:
        """The values of eight bytes: int where the scale is, else float."""
        bits = int.from_bytes(data, "little")
        return [(((bits >> start & mask) ^ sign) - sign) * scale for start, mask, sign, scale in self._fields]

    def encode(self, *values: float) -> bytes:
        """Eight bytes of values that are within their signals; what belongs to no signal is zero."""
        bits = 0
        for value, (start, mask, _, scale) in zip(values, self._fields, strict=True):
            bits |= (round(value / scale) & mask) << start
        return bits.to_bytes(BYTES, "little")
