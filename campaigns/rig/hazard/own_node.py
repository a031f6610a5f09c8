"""The rig with this project's nodes: the firmware's own C in virtual time."""

from __future__ import annotations

from dataclasses import replace

from campaigns.rig.hazard.setups import Setup
from needle_rig.records import TEMPORARY, Command, DriveState, Measurement
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.firmware_rig import FirmwareRig
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, DRIVE_REFERENCE_ID


class OwnNodeRig(FirmwareRig):
    """Implements `hazard.rigs.Rig`. The drive's answers are `late_ms` on their way, and the host knows it."""

    def __init__(self, setup: Setup, seed: int) -> None:
        self._late_s = 0.0
        config = setup.config(seed)
        super().__init__(config, build_plant(config))
        self._late_s = self.links.drive.delay_s = setup.late_ms * 1e-3
        for _ in range(setup.late_ms + 1):
            self.step()

    def read(self) -> Measurement:
        """The newest frames; the drive's are as old as their way is long."""
        now = super().read()
        return replace(now, drive_age_s=now.drive_age_s + self._late_s)

    @property
    def awake(self) -> bool:
        """The node lets the motor have its supply."""
        return self.nodes.drive.supply_on

    @property
    def running(self) -> bool:
        """The bridge is on."""
        return self.nodes.drive.state is DriveState.RUNNING or self.nodes.drive.powered

    @property
    def latched(self) -> bool:
        """The node says a fault that does not pass."""
        drive = self.nodes.drive
        return drive.state is DriveState.FAULT and bool(drive.faults & ~TEMPORARY)

    def fail_drive(self, code: int) -> None:
        """This node has no such codes."""
        raise NotImplementedError

    def foreign(self, wish: Command, *, number: int) -> None:
        """A whole command frame."""
        count = self.sent + number
        self.send(DRIVE_COMMAND_ID, self.codec.encode_command(wish, count, count))

    def foreign_reference(self, angle_rad: float) -> None:
        """A whole reference frame."""
        self.send(DRIVE_REFERENCE_ID, self.codec.encode_reference(angle_rad, self.sent, self.sent))
