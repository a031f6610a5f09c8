"""Asking the drive to leave SILENT or FAULT. Every clear follows from an order; none goes out by itself."""

from __future__ import annotations

import math

from needle_rig.records import COMMAND_AGE_S, TEMPORARY, Command, DriveFault, DriveState, Measurement

CLEAR_S = 1.0
"""How long a clear is repeated to the drive before its faults count again."""
CLEAR_EVERY = 4
"""Ticks from one clear to the next: the drive takes only one that follows a command without."""


def awake(measurement: Measurement) -> bool:
    """Whether the drive obeys velocities."""
    return measurement.drive_state in (DriveState.READY, DriveState.RUNNING)


class ClearHandshake:
    """The clear that an order asks for: a motion wakes the drive, a person's clear acknowledges faults."""

    def __init__(self) -> None:
        self._left_s = 0.0
        self._ticks = 0
        self._acknowledged: DriveFault | None = None
        self._sight_s = math.inf

    @property
    def asked(self) -> bool:
        """Whether a clear still goes out."""
        return self._left_s > 0.0

    def wake(self) -> None:
        """Wake the drive in the next ticks; an acknowledgement that is on its way goes on."""
        if not self.asked:
            self._acknowledged = None
        self._left_s = CLEAR_S

    def acknowledge(self, faults: DriveFault, age_s: float) -> None:
        """A person has seen `faults`, which the drive said `age_s` ago: clear these in the next ticks."""
        self._acknowledged, self._sight_s, self._left_s = faults, age_s, CLEAR_S

    def cancel(self) -> None:
        """Something came that nobody has seen yet."""
        self._left_s = 0.0

    def covers(self, measurement: Measurement) -> bool:
        """Whether the drive's own faults are those that are being cleared, and so no news."""
        if not self.asked:
            return False
        faults = measurement.drive_faults
        if self._acknowledged is None:
            return bool(faults) and not faults & ~TEMPORARY
        return not faults & ~(TEMPORARY | self._acknowledged)

    def step(self, measurement: Measurement, dt_s: float) -> None:
        """One tick: what the drive says ends the asking, or time does."""
        self._ticks += 1
        if not self.asked:
            return
        self._sight_s += dt_s
        done = awake(measurement) and not measurement.drive_faults
        self._left_s = 0.0 if done else max(self._left_s - dt_s, 0.0)

    def command(self, measurement: Measurement) -> Command | None:
        """What goes out while the drive sleeps; None when it is awake or nothing is to be cleared.

        A drive that was not heard for `COMMAND_AGE_S` may have latched what nobody has seen: it is not
        acknowledged.
        """
        if not self.asked or awake(measurement):
            return None
        now = self._ticks % CLEAR_EVERY == 0
        seen = self._acknowledged is not None and measurement.drive_age_s <= COMMAND_AGE_S
        if now and seen:
            return Command(clear=True, acknowledge=True, sight_s=self._sight_s)
        return Command(clear=now)
