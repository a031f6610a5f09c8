"""How often each Hall sensor's magnet has turned: wrapped angles to angles without end."""

from __future__ import annotations

import math
from collections.abc import Sequence

from needle_rig.units import deg

GAP_S = 0.25
"""Within it no rig turns half a turn: the nearest turn is right. After more, the base tells where to look."""
SURE_RAD = math.pi / 2.0
"""Further from where the base's motion puts it, the turn could as well be the next one."""


class HallTurns:
    """Follows every sensor over any number of turns; one whose turns are lost keeps its value and ages."""

    def __init__(self, sensors: Sequence[str]) -> None:
        self._sensors = tuple(sensors)
        count = len(self._sensors)
        self._angle_rad = [math.nan] * count
        self._from_base_rad = [math.nan] * count
        self._healthy_s = [-math.inf] * count
        self._lost = [""] * count
        self._told_rad = [math.nan] * count
        self.complaint = ""
        """What is wrong with the newest reading, and what to do."""

    @property
    def angle_rad(self) -> tuple[float, ...]:
        """Angles in the order of the sensors; NaN before the first."""
        return tuple(self._angle_rad)

    @property
    def healthy_s(self) -> float:
        """When the sensor that is longest without a good value had one."""
        return min(self._healthy_s)

    def take(
        self, angle_rad: Sequence[float], unusable: Sequence[str], now_s: float, base_rad: float
    ) -> None:
        """A reading that is news: an angle a sensor, and why it cannot be used (empty where it can).

        `base_rad` is the base's angle now, NaN when it is not known.
        """
        complaints = []
        for index, (angle, reason) in enumerate(zip(angle_rad, unusable, strict=True)):
            complaint = reason or self._follow(index, angle, now_s, base_rad)
            if complaint:
                complaints.append(f"{self._sensors[index]} {complaint}")
        self.complaint = "; ".join(complaints)

    def refer(self, base_rad: float) -> None:
        """The base stands at `base_rad`, says somebody who knows: lost turns are those nearest to it."""
        self._told_rad = [
            base_rad if lost else told for lost, told in zip(self._lost, self._told_rad, strict=True)
        ]

    def _follow(self, index: int, angle: float, now_s: float, base_rad: float) -> str:
        last_rad, told_rad = self._angle_rad[index], self._told_rad[index]
        expected = angle if math.isnan(last_rad) else last_rad
        if not math.isnan(told_rad):
            expected = told_rad
        elif self._lost[index]:
            return self._lost[index]
        elif not math.isnan(last_rad) and now_s - self._healthy_s[index] > GAP_S:
            away_s = now_s - self._healthy_s[index]
            if math.isnan(base_rad):
                return f"was away for {away_s:.1f} s; its turns wait for the drive's angle"
            from_base_rad = self._from_base_rad[index]
            # never seen beside a base: as at the first frame
            expected = angle if math.isnan(from_base_rad) else base_rad + from_base_rad
            off_rad = math.remainder(angle - expected, math.tau)
            if abs(off_rad) > SURE_RAD:
                self._lost[index] = (
                    f"was away for {away_s:.1f} s and came back {abs(deg(off_rad)):.0f}° from where the "
                    "base's motion puts it: its turns are not known; give the base its reference anew"
                )
                return self._lost[index]
        self._angle_rad[index] = expected + math.remainder(angle - expected, math.tau)
        if not math.isnan(base_rad):
            self._from_base_rad[index] = self._angle_rad[index] - base_rad
        self._healthy_s[index] = now_s
        self._told_rad[index], self._lost[index] = math.nan, ""
        return ""
