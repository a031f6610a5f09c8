"""The drive node's C code with a motor, an encoder and a host around it: fast enough for thousands."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from needle_rig.firmware.host import HostNodes
from needle_rig.records import DriveFault, DriveState

FULL_DEG_S = 180.0
FULL_DUTY = 32768


@dataclass
class Shaft:
    """Degrees, deg/s, N·mm. The motor has gain, lag, dead time and droop; every default is the bench's."""

    nodes: HostNodes
    gain: float = 1.0
    time_constant_s: float = 0.010
    delay_ms: int = 2
    droop_deg_s_per_nmm: float = 1.0
    torque_nmm: float = 0.0
    period_ms: int = 5
    encoder_gain: float = 1.0
    encoder_stuck: bool = False
    """Ticks on, stands still."""
    shorted_deg_s: float | None = None
    emergency_stop: bool = False
    jitter: Callable[[int], int] = field(default=lambda _ms: 0)
    """By how many ms a command of the host comes late."""
    wanted_deg_s: Callable[[int], float] | None = None
    enable: bool = False
    clear: bool = False

    def __post_init__(self) -> None:
        lib, ffi = self.nodes.lib, self.nodes.ffi
        self.node: Any = ffi.new("struct nr_drive_node *")
        lib.nr_drive_init(self.node, ffi.addressof(lib.nr_drive_defaults), ffi.new("uint8_t[256]"))
        self._in: Any = ffi.new("struct nr_drive_inputs *", {"encoder_good": True})
        self._out: Any = ffi.new("struct nr_drive_outputs *")
        self._command: Any = ffi.new("struct nr_command *")
        self._guard: Any = ffi.addressof(self.node, "guard")
        self._coming: deque[float] = deque([0.0] * (self.delay_ms + 1))
        self.ms = 0
        self.sent = 0
        self._due_ms = 0
        self.true_deg = self.read_deg = self.speed_deg_s = 0.0
        self.asked_deg = self.lowest_deg = self.highest_deg = 0.0
        self.beyond_deg = 0.0
        """How far the shaft went beyond every place that was asked for."""
        self.supply = False

    @property
    def state(self) -> DriveState:
        return DriveState(self._guard.state)

    @property
    def faults(self) -> DriveFault:
        return DriveFault(self._guard.faults)

    def say(self) -> None:
        wanted = self.wanted_deg_s(self.ms) if self.wanted_deg_s is not None and self.enable else 0.0
        self.sent += 1
        command = self._command
        command.velocity, command.enable, command.clear = round(wanted * 1e4), self.enable, self.clear
        command.counter, command.heartbeat = self.sent % 16, self.sent % 65536
        self.nodes.lib.nr_guard_command(self._guard, self.ms * 1000, command)

    def run(self, milliseconds: int) -> Shaft:
        lib = self.nodes.lib
        decay = math.exp(-1e-3 / self.time_constant_s)
        for _ in range(milliseconds):
            self.ms += 1
            if self.ms >= self._due_ms:
                self.say()
                next_ms = (self.ms // self.period_ms + 1) * self.period_ms
                self._due_ms = next_ms + self.jitter(next_ms)
            lib.nr_guard_torque(self._guard, self.ms * 1000, round(self.torque_nmm * 1e5), True)
            ramp_deg_s = self.node.ramp * 1e-4
            self._move(decay)
            self.asked_deg += ramp_deg_s * 1e-3
            self._in.counts = math.floor(self.read_deg * 1000.0)
            self._in.emergency_stop = self.emergency_stop
            lib.nr_drive_tick(self.node, self.ms * 1000, self._in, self._out)
            self.supply = self._out.supply
            self._coming.append(self._out.duty)
            self.highest_deg = max(self.highest_deg, self.asked_deg)
            self.lowest_deg = min(self.lowest_deg, self.asked_deg)
            beyond = max(self.true_deg - self.highest_deg, self.lowest_deg - self.true_deg)
            self.beyond_deg = max(self.beyond_deg, beyond)
        return self

    def _move(self, decay: float) -> None:
        duty = self._coming.popleft()
        load = self.droop_deg_s_per_nmm * self.torque_nmm
        final = self.gain * duty / FULL_DUTY * FULL_DEG_S - load if duty else 0.0
        if self.shorted_deg_s is not None:
            final = self.shorted_deg_s
        if not self.supply:
            final = 0.0
        turned = final * 1e-3 + (self.speed_deg_s - final) * self.time_constant_s * (1.0 - decay)
        self.speed_deg_s = final + (self.speed_deg_s - final) * decay
        self.true_deg += turned
        if not self.encoder_stuck:
            self.read_deg += turned * self.encoder_gain

    def ready(self) -> Shaft:
        """Cleared, its supply's contact closed."""
        self.run(60)
        self.clear = True
        self.run(60)
        self.clear = False
        self.run(35)
        assert self.state is DriveState.READY
        return self

    def turning(self, wanted_deg_s: Callable[[int], float] | float) -> Shaft:
        """Enabled at a speed, or at what a function of the ms since now gives."""
        start_ms = self.ms
        if callable(wanted_deg_s):
            self.wanted_deg_s = lambda ms: wanted_deg_s(ms - start_ms)
        else:
            self.wanted_deg_s = lambda _ms: wanted_deg_s
        self.enable = True
        return self

    def until_fault(self, milliseconds: int) -> int | None:
        """The ms after which it stopped by itself, and then its run-down; None when it does not."""
        for passed in range(milliseconds):
            if self.state is DriveState.FAULT:
                self.run(300)
                return passed
            self.run(1)
        return None
