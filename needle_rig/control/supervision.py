"""Everything that is watched beside the limits of single values: motion, shaft, reference, other masters."""

from __future__ import annotations

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.following import CLEAR_TEXT, FollowingError, FollowingLimits
from needle_rig.control.reference import Reference
from needle_rig.control.shaft import ShaftLimits, ShaftWatch, spring_to_first_sensor
from needle_rig.physics.rod import Layout
from needle_rig.records import Command, DriveState, Measurement

SIGHT_S = 0.02
"""Of an encoder angle that is older nobody knows what the base did since: twenty frames are missing."""


class Supervision:
    """Judges what the rig did with the last command. `reference` is what it knows of the drive's zero."""

    def __init__(
        self,
        following: FollowingLimits,
        shaft: ShaftLimits,
        reference_tolerance_rad: float,
        layout: Layout,
        torsional_rigidity_nm2: float,
    ) -> None:
        self._following = FollowingError(following)
        self._shaft = ShaftWatch(shaft, layout, torsional_rigidity_nm2)
        spring = spring_to_first_sensor(layout, torsional_rigidity_nm2) if layout.sensor_positions_m else None
        self.reference = Reference(spring, reference_tolerance_rad)
        self._foreign_commands = 0

    def begin(self) -> None:
        """A sequence starts."""
        self._shaft.begin()

    def motion(self) -> None:
        """The next motion of a sequence starts."""
        self._shaft.motion()

    def clear(self, measurement: Measurement | None) -> None:
        """A person has looked: what was found until now is forgiven."""
        self._following.reset()
        if measurement is not None:
            self._foreign_commands = measurement.foreign_commands

    def lost_sight(self) -> None:
        """The drive was not heard: what it did meanwhile cannot be held against it."""
        self._following.reset()

    def step(self, now: Measurement, last: Command, dt_s: float, *, active: bool) -> Fault | None:
        """One tick with fresh values; `last` was in force for `dt_s`, `active` while a sequence runs."""
        if now.foreign_commands > self._foreign_commands:
            return Fault(
                FaultName.SECOND_MASTER,
                "drive",
                f"another master sent {now.foreign_commands - self._foreign_commands} commands to the drive;"
                f" take it off the bus{CLEAR_TEXT}",
                latching=True,
            )
        lost = self.reference.step(now, dt_s)
        if lost is not None:
            self._following.reset()
            return lost
        by_hand = now.drive_state in (DriveState.SILENT, DriveState.FAULT)
        if self.reference.wanted_rad is not None or by_hand or now.drive_age_s > SIGHT_S:
            # its angle is being set, a hand may turn it, or it is out of sight
            self._following.reset()
            return None
        astray = self._following.step(last.velocity_rad_s, last.enable, now.base_angle_rad, dt_s)
        return astray or (self._shaft.step(now, dt_s) if active else None)
