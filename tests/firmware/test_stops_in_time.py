"""The drive node stops by its own decision within 60 ms of the last valid command, and stays stopped."""

from __future__ import annotations

import random
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.config.files import find_config_file
from needle_rig.records import Command, DriveFault, DriveState
from needle_rig.simulation.nodes.firmware_nodes import DriveFirmware, FirmwareNodes
from needle_rig.units import deg, rad
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, TORQUE_STATUS_ID, CanCodec
from tests.values import now

TRIALS = 200
STOP_MS = 60
CODEC = CanCodec(find_config_file("needle_rig.dbc"))
TORQUES = [CODEC.encode_torque(1e-4, 0, counter, 0.0) for counter in range(16)]


class Links:
    """Host, torque node and shaft around one drive node; both links can be cut."""

    def __init__(self, nodes: FirmwareNodes, start_us: int) -> None:
        self.drive = DriveFirmware(nodes, start_us)
        self.start_us = start_us
        self.ms = 0
        self.angle_rad = self.velocity_rad_s = self.asked_rad_s = 0.0
        self.sent = 0
        self.host = self.cable = True
        self.command = Command()
        self.last_command_ms = 0
        self.tick_ms = 5

    def run(self, milliseconds: int) -> Iterator[float]:
        """Pass time; gives what the bridge asks of the motor each millisecond."""
        for _ in range(milliseconds):
            self.ms += 1
            if self.host and self.ms % self.tick_ms == 0:
                self.sent += 1
                data = CODEC.encode_command(self.command, self.sent, self.sent)
                if self.cable:
                    self.drive.receive(0, DRIVE_COMMAND_ID, data)
                    self.last_command_ms = self.ms
            if self.cable:
                self.drive.receive(0, TORQUE_STATUS_ID, TORQUES[self.ms % 16])
            self.velocity_rad_s += (self.asked_rad_s - self.velocity_rad_s) * 0.1
            self.angle_rad += self.velocity_rad_s * 1e-3
            counts = round(deg(self.angle_rad) * 1000)
            _, self.asked_rad_s = self.drive.step(self.start_us + self.ms * 1000, counts)
            yield self.asked_rad_s

    def pass_(self, milliseconds: int) -> float:
        """Pass time; the fastest that the motor was asked for."""
        return max(abs(asked) for asked in self.run(milliseconds))

    def clear(self) -> None:
        self.command = Command()
        self.pass_(10)
        self.command = Command(clear=True)
        self.pass_(20)
        self.command = Command()
        self.pass_(10)


@pytest.fixture(scope="module")
def firmware(built: Path) -> FirmwareNodes:
    return FirmwareNodes(build=built)


@pytest.mark.parametrize("harm", ["host gone", "cable pulled", "host starved"])
def test_the_drive_stops_by_itself_and_moves_only_after_a_clear(firmware: FirmwareNodes, harm: str) -> None:
    rng = random.Random(harm)
    late = []
    for _ in range(TRIALS):
        links = Links(firmware, rng.randrange(2**32))
        links.pass_(rng.randrange(20, 60))
        links.clear()
        assert now(links.drive.state) is DriveState.READY
        turning = Command(rad(rng.choice((-1, 1)) * rng.uniform(5, 60)), enable=True)
        links.command = turning
        assert links.pass_(rng.randrange(40, 300)) > rad(2)
        links.host = harm == "cable pulled"
        links.cable = harm != "cable pulled"
        while any(links.run(1)):
            assert links.ms - links.last_command_ms <= STOP_MS
        late.append(links.ms - links.last_command_ms)
        assert now(links.drive.state) is DriveState.FAULT
        assert links.drive.faults & (DriveFault.COMMAND_AGE | DriveFault.TORQUE_AGE)
        assert links.pass_(rng.randrange(10, 500)) == 0.0
        # Back, and asking to turn as if nothing had been; starved, it first says what it had meant to say.
        links.host = links.cable = True
        assert links.pass_(rng.randrange(50, 200)) == 0.0
        assert now(links.drive.state) is DriveState.FAULT
        links.clear()
        assert links.drive.state is DriveState.READY
        links.command = turning
        assert links.pass_(60) > rad(1)
    assert len(late) == TRIALS
    assert max(late) <= STOP_MS
