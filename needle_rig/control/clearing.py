"""Asking the drive to clear its own faults; what it says of them until then is no news."""

from __future__ import annotations

from needle_rig.control.faults import Fault
from needle_rig.records import Command, DriveState, Measurement

CLEAR_S = 1.0
"""How long a clear is repeated to the drive before its faults count again."""
CLEAR_EVERY = 4
"""Ticks from one clear to the next: the drive takes only one that follows a command without."""


def awake(measurement: Measurement) -> bool:
    """Whether the drive obeys velocities."""
    return measurement.drive_state in (DriveState.READY, DriveState.RUNNING)


class ClearHandshake:
    """The clear that a person, a start or the end of a passing fault asks for."""

    def __init__(self) -> None:
        self._left_s = 0.0
        self._ticks = 0

    @property
    def asked(self) -> bool:
        """Whether a clear still goes out."""
        return self._left_s > 0.0

    def ask(self) -> None:
        """Clear the drive in the next ticks."""
        self._left_s = CLEAR_S

    def step(self, measurement: Measurement, dt_s: float) -> bool:
        """One tick; whether the drive's own faults are those that are being cleared, and no news."""
        self._ticks += 1
        if not self.asked:
            return False
        faulty = measurement.drive_state is DriveState.FAULT or bool(measurement.drive_faults)
        self._left_s = 0.0 if awake(measurement) and not faulty else self._left_s - dt_s
        return faulty

    def command(self, measurement: Measurement, fault: Fault | None) -> Command | None:
        """What goes out while the drive sleeps; None when it is awake or nothing is to be cleared.

        A fault that passes by itself asks for its own clear.
        """
        passing = fault is not None and not fault.latching
        wanted = self.asked or (passing and measurement.drive_state is DriveState.FAULT)
        if not wanted or awake(measurement):
            return None
        return Command(clear=self._ticks % CLEAR_EVERY == 0)
