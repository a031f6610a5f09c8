"""The outside of one node: what its pins see and what it puts out, in the units of its converters."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

PAGE_SIZE = 256
ADC_CHANNELS = 8


@dataclass
class Pins:
    """Inputs are set before a poll, outputs are taken after it.

    `adc` are 12-bit counts (sine, cosine of each Hall sensor in turn), `load_cell` signed 24-bit counts or
    None when the converter has nothing new, `encoder_counts` a 32-bit counter, `duty` the motor's duty
    (±2¹⁵), `supply` the safe-torque-off line, `page` the calibration page.
    """

    time_us: int = 0
    adc: list[int] = field(default_factory=lambda: [0] * ADC_CHANNELS)
    load_cell: int | None = None
    encoder_counts: int = 0
    encoder_good: bool = True
    index: bool = False
    emergency_stop: bool = False
    page: bytes = b"\xff" * PAGE_SIZE
    can_in: deque[tuple[int, bytes]] = field(default_factory=deque)
    can_out: list[tuple[int, bytes]] = field(default_factory=list)
    uart_out: bytearray = field(default_factory=bytearray)
    duty: int = 0
    supply: bool = False

    def take_can(self) -> list[tuple[int, bytes]]:
        """The (id, data) of frames that the node sent since the last call, oldest first."""
        taken, self.can_out = self.can_out, []
        return taken

    def take_uart(self) -> bytes:
        """Serial bytes that the node sent since the last call."""
        taken = bytes(self.uart_out)
        self.uart_out.clear()
        return taken
