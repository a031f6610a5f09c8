"""Drives a guard of the host library in milliseconds, with one call for what a host and a torque node do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from needle_rig.firmware.host import HostNodes
from needle_rig.records import DriveFault, DriveState


@dataclass
class Guard:
    """A guard with the drive's default limits, its links alive unless told otherwise."""

    nodes: HostNodes
    now_us: int = 0
    angle_mdeg: float = 0.0
    torque: int = 0
    encoder_good: bool = True
    emergency_stop: bool = False
    counter: int = 0
    heartbeat: int = 0
    host_alive: bool = True
    host_thinks: bool = True
    torque_alive: bool = True
    torque_good: bool = True
    follows: float = 1.0
    velocity: int = 0
    enable: bool = False
    clear: bool = False
    acknowledge: bool = True
    sight_us: int = 0
    permitted: int = 0

    def __post_init__(self) -> None:
        self.lib = self.nodes.lib
        self.c: Any = self.nodes.ffi.new("struct nr_guard *")
        self.limits: Any = self.lib.nr_drive_defaults.guard
        self.lib.nr_guard_init(self.c, self.nodes.ffi.addressof(self.lib.nr_drive_defaults, "guard"))

    @property
    def state(self) -> DriveState:
        return DriveState(self.c.state)

    @property
    def faults(self) -> DriveFault:
        return DriveFault(self.c.faults)

    def say(self, *, counter: int | None = None) -> bool:
        """One command frame now."""
        if counter is None:
            self.counter = (self.counter + 1) % 16
            counter = self.counter
        if self.host_thinks:
            self.heartbeat = (self.heartbeat + 1) % 65536
        command = self.nodes.ffi.new(
            "struct nr_command *",
            {
                "velocity": self.velocity,
                "enable": self.enable,
                "clear": self.clear,
                "acknowledge": self.acknowledge,
                "sight_us": self.sight_us,
                "counter": counter,
                "heartbeat": self.heartbeat,
            },
        )
        return bool(self.lib.nr_guard_command(self.c, self.now_us % 2**32, command))

    def tick(self, milliseconds: int = 1) -> int:
        """Pass time; the host speaks every 5 ms, the torque node every 1 ms, the shaft follows."""
        for _ in range(milliseconds):
            self.now_us += 1000
            if self.host_alive and self.now_us // 1000 % 5 == 0:
                self.say()
            if self.torque_alive:
                self.lib.nr_guard_torque(self.c, self.now_us % 2**32, self.torque, self.torque_good)
            self.angle_mdeg += self.follows * self.expected * 1e-1 * 1e-3
            self.permitted = self.step()
        return self.permitted

    @property
    def expected(self) -> float:
        """The velocity at which a shaft with the nominal lag turns now, 1e-4 deg/s."""
        return float(self.c.motion.expected_q8 / 256)

    def step(self) -> int:
        """One step of the guard, without anybody speaking."""
        senses = self.nodes.ffi.new("struct nr_senses *")
        senses.angle_mdeg = round(self.angle_mdeg)
        senses.encoder_good, senses.emergency_stop = self.encoder_good, self.emergency_stop
        return int(self.lib.nr_guard_step(self.c, self.now_us % 2**32, senses, self.permitted))

    def jump(self, elapsed_us: int) -> None:
        """The clock stands `elapsed_us` after the last step, the shaft where it should be by then."""
        self.now_us = self.c.step_us + elapsed_us
        self.angle_mdeg += self.follows * self.permitted * elapsed_us * 1e-7

    def ready(self) -> Guard:
        """Boot, hear the host, be cleared."""
        self.tick(10)
        self.clear_now()
        assert self.state is DriveState.READY
        self.tick(20)
        return self

    def clear_now(self) -> None:
        """What a host does to clear: stop, ask once, stop asking."""
        self.enable, self.velocity, self.clear = False, 0, True
        self.tick(10)
        self.clear = False
        self.tick(10)

    def running(self, velocity: int = 100_000) -> Guard:
        """Turning at `velocity`, in 1e-4 deg/s."""
        self.ready()
        self.enable, self.velocity = True, velocity
        self.tick(10)
        assert self.state is DriveState.RUNNING
        return self
