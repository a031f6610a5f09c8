"""One turn with a small oscillation on top, to keep the needle slipping."""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.control.strategy import Dither as Oscillation
from needle_rig.control.strategy import History, Strategy, Task, Waypoint
from needle_rig.errors import BadInput
from needle_rig.units import deg, rad


@dataclass(frozen=True)
class Dither(Strategy):
    """Base to θ_d while it oscillates by a small angle; the oscillation then dies away.

    The angle is ± `amplitude_deg`, at `frequency_hz`. Rejected by Reed 2008: a small oscillation frees only
    the needle near its base.
    """

    amplitude_deg: float = 2.0
    frequency_hz: float = 1.5

    def __post_init__(self) -> None:
        if not 0.0 < self.amplitude_deg <= 180.0 or not 0.0 < self.frequency_hz <= 20.0:
            raise BadInput("dither: amplitude_deg must be 0 to 180 and frequency_hz 0 to 20")

    def check(self, task: Task) -> None:
        """Refuse an oscillation that the drive cannot follow."""
        rate = 2.0 * math.pi * self.frequency_hz
        peak = rad(self.amplitude_deg) * rate
        if peak > task.velocity_limit_rad_s or peak * rate > task.acceleration_limit_rad_s2:
            raise BadInput(
                f"dither: {self.amplitude_deg:g}° at {self.frequency_hz:g} Hz needs {deg(peak):.0f}°/s and"
                f" {deg(peak * rate):.0f}°/s², the drive has {deg(task.velocity_limit_rad_s):.0f}°/s and"
                f" {deg(task.acceleration_limit_rad_s2):.0f}°/s²; choose less of either"
            )

    def next(self, task: Task, history: History) -> Waypoint | None:
        """One motion; None after it."""
        if len(history) > 1:
            return None
        oscillation = Oscillation(rad(self.amplitude_deg), self.frequency_hz)
        return Waypoint(task.target_rad, "rotate", dither=oscillation)

    def expected_motions(self) -> int:
        """One."""
        return 1
