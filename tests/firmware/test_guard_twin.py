"""The guard of the simulated rig decides as the firmware's does, step by step."""

from __future__ import annotations

from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.firmware.host import HostNodes
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.simulation.drive.drive_guard import DriveGuard
from needle_rig.units import nm, rad

COMMANDS = st.tuples(
    st.sampled_from([0, 0, 200_000, -200_000, 899_999, 900_001]), st.booleans(), st.booleans(), st.booleans()
)
DEEDS = st.one_of(
    st.tuples(st.just("command"), COMMANDS),
    st.tuples(st.just("command"), st.just((0, False, True, False))),
    st.tuples(st.just("command"), st.just((0, False, True, True))),
    st.tuples(st.just("sight_us"), st.sampled_from([0, 5_000, 60_000, 1_275_000])),
    st.tuples(st.just("command"), st.just((200_000, True, False, False))),
    st.tuples(st.just("host"), st.sampled_from([True, True, False])),
    st.tuples(st.just("thinks"), st.sampled_from([True, True, False])),
    st.tuples(st.just("torque"), st.sampled_from([0, 0, 199_999, 200_001, -200_001, None])),
    st.tuples(st.just("damage"), st.integers(1, 12)),
    st.tuples(st.just("angle"), st.sampled_from([0, 0, 719_999, 720_001, 722_001, -720_001, -722_001])),
    st.tuples(st.just("share"), st.sampled_from([1.0, 1.0, 0.0, 0.5, 1.6, -1.0])),
    st.tuples(st.just("drift_mdeg"), st.sampled_from([0, 0, 0, 3, -90])),
    st.tuples(st.just("estop"), st.sampled_from([False, False, True])),
    st.tuples(st.just("foreign"), st.integers(1, 5)),
    st.tuples(st.just("repeat"), st.integers(1, 5)),
    st.tuples(st.just("reference"), st.tuples(st.sampled_from([-1, 0, 0]), st.integers(-9000, 9000))),
)


class Twins:
    """Both guards, told the same at the same time; the host speaks every 5 ms."""

    def __init__(self, nodes: HostNodes) -> None:
        self.lib, self.ffi = nodes.lib, nodes.ffi
        self.c: Any = self.ffi.new("struct nr_guard *")
        self.lib.nr_guard_init(self.c, self.ffi.addressof(self.lib.nr_drive_defaults, "guard"))
        self.python = DriveGuard()
        self.now_us = 0
        self.counter = self.heartbeat = 0
        self.command = (0, False, False, False)
        self.sight_us = 0
        self.host = self.thinks = True
        self.torque: int | None = 0
        self.angle_mdeg = self.asked = self.drift_mdeg = 0
        self.share = 1.0
        self.estop = False
        self.say()

    def do(self, what: str, value: Any) -> None:
        if what == "damage":
            for _ in range(value):
                self.lib.nr_guard_bad_frame(self.c)
                self.python.damaged()
        elif what == "foreign":
            for _ in range(value):
                self.tell((300_000, True, False, False), self.counter + 7, self.heartbeat + 1)
        elif what == "repeat":
            for _ in range(value):
                self.tell(self.command, self.counter, self.heartbeat)
        elif what == "reference":
            beat, angle_mdeg = value
            heartbeat = (self.heartbeat + beat) % 65536
            taken = bool(self.lib.nr_guard_reference(self.c, self.now_us, heartbeat, angle_mdeg))
            assert self.python.reference(self.now_us, heartbeat, rad(angle_mdeg * 1e-3)) == taken
            if taken:
                self.angle_mdeg = angle_mdeg
        else:
            setattr(self, {"angle": "angle_mdeg"}.get(what, what), value)

    def say(self) -> None:
        self.heartbeat += self.thinks
        self.counter += 1
        self.tell(self.command, self.counter, self.heartbeat)

    def tell(self, command: tuple[int, bool, bool, bool], counter: int, heartbeat: int) -> None:
        velocity, enable, clear, acknowledge = command
        said = self.ffi.new(
            "struct nr_command *",
            {
                "velocity": velocity,
                "enable": enable,
                "clear": clear,
                "acknowledge": acknowledge,
                "sight_us": self.sight_us,
                "counter": counter % 16,
                "heartbeat": heartbeat % 65536,
            },
        )
        wish = Command(rad(velocity * 1e-4), enable, clear, acknowledge, sight_s=self.sight_us * 1e-6)
        taken = bool(self.lib.nr_guard_command(self.c, self.now_us, said))
        assert self.python.receive(self.now_us, wish, counter % 16, heartbeat % 65536) == taken

    def step(self) -> None:
        self.now_us += 1000
        if self.host and self.now_us % 5000 == 0:
            self.say()
        if self.torque is not None:
            self.lib.nr_guard_torque(self.c, self.now_us, self.torque, True)
            self.python.torque(self.now_us, nm(self.torque * 1e-5))
        expected = self.c.motion.expected_q8 / 256
        self.angle_mdeg += round(self.share * expected * 1e-4) + self.drift_mdeg
        senses = self.ffi.new("struct nr_senses *", {"angle_mdeg": self.angle_mdeg, "encoder_good": True})
        senses.emergency_stop = self.estop
        permitted = self.lib.nr_guard_step(self.c, self.now_us, senses, self.asked)
        angle_rad = rad(self.angle_mdeg * 1e-3)
        velocity_rad_s = self.python.step(self.now_us, angle_rad, self.asked, emergency_stop=self.estop)
        self.asked = permitted
        python, motion = self.python, self.c.motion
        assert (python.state, python.faults) == (DriveState(self.c.state), DriveFault(self.c.faults))
        assert (python.supply, python.referenced) == (bool(self.c.supply), bool(self.c.referenced))
        assert velocity_rad_s == rad(permitted * 1e-4)
        twin = python.motion
        seen = (twin.following, twin.expected_q8, twin.pace_q8, twin.resting)
        assert seen == (motion.following, motion.expected_q8, motion.pace_q8, bool(motion.resting))


@settings(max_examples=3 * settings().max_examples)
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
    for command in (
        (0, False, False, False),
        (0, False, True, False),
        (200_000, True, False, False),
        (900_001, True, False, False),
    ):
        twins.command = command
        for _ in range(25):
            twins.step()
        reached.append(twins.python.state)
    assert reached == [DriveState.SILENT, DriveState.READY, DriveState.RUNNING, DriveState.FAULT]
