"""The guard of the simulated rig decides as the firmware's does, step by step."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.firmware.host import HostNodes
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.simulation.drive_guard import DriveGuard
from needle_rig.units import nm, rad

NO_LIMIT = 2**31 - 1
COMMANDS = st.tuples(
    st.sampled_from([0, 0, 200_000, -200_000, 899_999, 900_001]), st.booleans(), st.booleans()
)
DEEDS = st.one_of(
    st.tuples(st.just("command"), COMMANDS),
    st.tuples(st.just("command"), st.just((0, False, True))),
    st.tuples(st.just("command"), st.just((200_000, True, False))),
    st.tuples(st.just("host"), st.sampled_from([True, True, False])),
    st.tuples(st.just("thinks"), st.sampled_from([True, True, False])),
    st.tuples(st.just("torque"), st.sampled_from([0, 0, 199_999, 200_001, -200_001, None])),
    st.tuples(st.just("damage"), st.integers(1, 12)),
    st.tuples(st.just("angle"), st.sampled_from([0, 0, 719_999, 720_001, 722_001, -720_001, -722_001])),
)


class Twins:
    """Both guards, told the same at the same time; the host speaks every 5 ms."""

    def __init__(self, nodes: HostNodes) -> None:
        self.lib, self.ffi = nodes.lib, nodes.ffi
        config: Any = self.ffi.new("struct nr_guard_config *", self.lib.nr_drive_defaults.guard)
        # Only the firmware judges what its motor does.
        config.rate_limit = config.stall_floor_mdeg = NO_LIMIT
        self.c: Any = self.ffi.new("struct nr_guard *")
        self.lib.nr_guard_init(self.c, config)
        self.python = DriveGuard()
        self.now_us = 0
        self.heartbeat = 0
        self.command = (0, False, False)
        self.host = self.thinks = True
        self.torque: int | None = 0
        self.angle_mdeg = 0
        self.say(counter_only=True)

    def do(self, what: str, value: Any) -> None:
        if what == "damage":
            for _ in range(value):
                self.lib.nr_guard_bad_frame(self.c)
                self.python.damaged()
        else:
            setattr(self, {"angle": "angle_mdeg"}.get(what, what), value)

    def say(self, *, counter_only: bool = False) -> None:
        velocity, enable, clear = self.command
        self.heartbeat += self.thinks
        said = self.ffi.new(
            "struct nr_command *",
            {
                "velocity": velocity,
                "enable": enable,
                "clear": clear,
                "counter": (self.c.last_counter + 1) % 16,
                "heartbeat": self.heartbeat % 65536,
            },
        )
        assert self.lib.nr_guard_command(self.c, self.now_us, said) is not counter_only
        if not counter_only:
            wish = Command(rad(velocity * 1e-4), enable, clear)
            self.python.receive(self.now_us, wish, self.heartbeat)

    def step(self) -> None:
        self.now_us += 1000
        if self.host and self.now_us % 5000 == 0:
            self.say()
        if self.torque is not None:
            self.lib.nr_guard_torque(self.c, self.now_us, self.torque, True)
            self.python.torque(self.now_us, nm(self.torque * 1e-5))
        permitted = self.lib.nr_guard_step(self.c, self.now_us, self.angle_mdeg, True, 0)
        velocity_rad_s = self.python.step(self.now_us, rad(self.angle_mdeg * 1e-3))
        assert (self.python.state, self.python.faults) == (
            DriveState(self.c.state),
            DriveFault(self.c.faults),
        )
        assert velocity_rad_s == rad(permitted * 1e-4)


@settings(max_examples=150)
@given(st.lists(st.tuples(DEEDS, st.sampled_from([1, 2, 5, 6, 20, 60, 110])), max_size=25))
def test_both_guards_stand_in_the_same_state_for_the_same_reason(
    nodes: HostNodes, deeds: list[tuple[tuple[str, Any], int]]
) -> None:
    twins = Twins(nodes)
    for (what, value), milliseconds in deeds:
        twins.do(what, value)
        for _ in range(milliseconds):
            twins.step()


def test_the_twins_come_through_every_state(nodes: HostNodes) -> None:
    twins = Twins(nodes)
    reached = []
    for command in ((0, False, False), (0, False, True), (200_000, True, False), (900_001, True, False)):
        twins.command = command
        for _ in range(10):
            twins.step()
        reached.append(twins.python.state)
    assert reached == [DriveState.SILENT, DriveState.READY, DriveState.RUNNING, DriveState.FAULT]
