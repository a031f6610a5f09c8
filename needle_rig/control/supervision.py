"""Everything that is watched beside the limits of single values: motion, shaft, reference, other masters.

It runs from switch-on to switch-off: in motion, at rest, in a hold, between sequences, and beside other
faults. A link that is dead takes away what it alone can tell, and nothing else.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.following import CLEAR_TEXT, FollowingError, FollowingLimits
from needle_rig.control.limits import LINKS
from needle_rig.control.reference import Reference
from needle_rig.control.shaft import ShaftLimits, ShaftWatch, spring_to_first_sensor
from needle_rig.physics.rod import Layout
from needle_rig.records import Command, DriveState, Measurement

BLIND_S = 0.1
"""An enabled drive that was not heard for longer may do what it likes: at 60°/s it turns by 6°, as far as the
following error allows."""


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
        self._telling = False
        self._foreign_commands = 0

    def begin(self) -> None:
        """A sequence starts."""
        self._shaft.begin()

    def motion(self) -> None:
        """The next motion of a sequence starts."""
        self._shaft.motion()

    def clear(self, measurement: Measurement | None) -> None:
        """A person has looked: a motion that was not asked for and another master are forgiven.

        What the witnesses of the shaft say against one another is not: a reference alone settles it.
        """
        self._following.rebase()
        if measurement is not None:
            self._foreign_commands = measurement.foreign_commands

    def step(
        self,
        now: Measurement,
        heard: Collection[str],
        last: Command,
        dt_s: float,
        *,
        unseen_s: float,
        in_time: bool,
    ) -> Iterator[Fault]:
        """One tick: `last` was in force for `dt_s`, `heard` are the links whose values may be used.

        `unseen_s` is the time for which this computer listened and the drive was not heard. While this
        computer is not `in_time`, values of different age stand side by side: they are not compared.
        """
        self._following.commanded(last.velocity_rad_s if last.enable else 0.0, dt_s)
        if last.enable and unseen_s > BLIND_S:
            yield Fault(
                FaultName.BLIND,
                "drive",
                f"the drive is enabled and was not heard for {unseen_s * 1e3:.0f} ms, limit"
                f" {BLIND_S * 1e3:g} ms: nobody sees what the base does; check its link",
                latching=False,
            )
        if now.foreign_commands > self._foreign_commands:
            yield Fault(
                FaultName.SECOND_MASTER,
                "drive",
                f"another master sent {now.foreign_commands - self._foreign_commands} commands to the drive;"
                f" take it off the bus{CLEAR_TEXT}",
                latching=True,
            )
        if "drive" not in heard:
            return
        all_heard = len(heard) == len(LINKS)
        lost = self.reference.step(now, dt_s, can_confirm=all_heard)
        if lost is not None:
            yield lost
        if lost is not None or self.reference.wanted_rad is not None:
            self._following.rebase()
            self._refer(now, whole=in_time and all_heard)
            return
        self._telling = False
        if now.drive_state in (DriveState.SILENT, DriveState.FAULT):
            self._following.rebase()  # without its supply a hand may turn it
        else:
            astray = self._following.sample(now.base_angle_rad, now.drive_age_s, enabled=last.enable)
            if astray is not None:
                yield astray
        if in_time and all_heard:
            disagreement = self._shaft.step(now, dt_s)
            if disagreement is not None:
                yield disagreement

    def _refer(self, now: Measurement, *, whole: bool) -> None:
        """The drive has no zero, or is being told one: then the newest `whole` reading is the shaft's datum.

        A drive that takes its zero and is wrong in its next answer is held against that reading.
        """
        wanted_rad = self.reference.wanted_rad
        if wanted_rad is not None and whole:
            self._shaft.rebase(replace(now, base_angle_rad=wanted_rad))
        elif wanted_rad is None or not self._telling:
            self._shaft.rebase()
        self._telling = wanted_rad is not None
