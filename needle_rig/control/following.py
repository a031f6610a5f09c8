"""The following error: what was commanded so far against what the encoder says was turned, at any speed.

The drive node judges the same within milliseconds (firmware/core/nr_motion.c); this is the second pair of
eyes, on the other side of the bus.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.control.faults import Fault, FaultName
from needle_rig.units import deg, rad

SCALE_TOLERANCE = 0.05
"""Share by which a drive's velocity may differ from the command: node clocks are off by up to 2 %
(`LinkClock`), and a drive of another make rounds its units."""
DRIFT_RAD_S = rad(0.1)
"""Forgiven all the time: a drive that holds a load may sink by so much, and is asked back up."""
REVERSE_SHARE = 0.2
"""Of the commanded speed: turning back faster than this is no standstill; an encoder's flicker is less."""
CLEAR_TEXT = ", then: needle-rig clear"


@dataclass(frozen=True)
class FollowingLimits:
    """`floor_rad` at standstill, and on top what `response_s` explains, the time that bus, drive and motor
    may take to answer: behind the command what its speed covers in it, ahead what it has slowed down by."""

    floor_rad: float
    response_s: float


class FollowingError:
    """Integral of commanded minus turned since it was last `reset`; kept while the base is not driven too."""

    def __init__(self, limits: FollowingLimits) -> None:
        self._limits = limits
        self.reset()

    def reset(self) -> None:
        """The base may have been turned by something else: begin anew at the next angle."""
        self.error_rad = 0.0
        self._last_rad: float | None = None
        self._peak_rad_s = 0.0
        self._asked_rad_s = 0.0
        self._turned_rad_s = 0.0

    def _limit_rad(self, commanded_rad_s: float) -> float:
        """What the error may be now, on the side on which it is."""
        late_rad_s = self._peak_rad_s
        if self.error_rad * commanded_rad_s < 0.0:
            late_rad_s -= abs(commanded_rad_s)
        return self._limits.floor_rad + self._limits.response_s * late_rad_s

    def step(self, commanded_rad_s: float, enabled: bool, angle_rad: float, dt_s: float) -> Fault | None:
        """One tick: `commanded_rad_s` was in force for `dt_s` > 0, at the end of which the base stands at
        `angle_rad`; a latching fault when the two have come too far apart."""
        if self._last_rad is None:
            self._last_rad = angle_rad
        asked_rad, turned_rad = commanded_rad_s * dt_s, angle_rad - self._last_rad
        self._last_rad = angle_rad
        forgiven_rad = SCALE_TOLERANCE * abs(asked_rad) + DRIFT_RAD_S * dt_s
        error_rad = self.error_rad + asked_rad - turned_rad
        # an answer that comes later than the command is no error to be forgiven: it comes back at the end
        late_rad = self._limits.response_s * commanded_rad_s
        least_rad, most_rad = min(late_rad, 0.0), max(late_rad, 0.0)
        if error_rad > most_rad:
            error_rad = max(error_rad - forgiven_rad, most_rad)
        elif error_rad < least_rad:
            error_rad = min(error_rad + forgiven_rad, least_rad)
        self.error_rad = error_rad
        kept = math.exp(-dt_s / self._limits.response_s)
        self._peak_rad_s = max(abs(commanded_rad_s), self._peak_rad_s * kept)
        self._asked_rad_s += (1.0 - kept) * (commanded_rad_s - self._asked_rad_s)
        self._turned_rad_s += (1.0 - kept) * (turned_rad / dt_s - self._turned_rad_s)
        limit_rad = self._limit_rad(commanded_rad_s)
        if abs(self.error_rad) <= limit_rad:
            return None
        return Fault(*self._told(enabled, limit_rad), latching=True)

    def _told(self, enabled: bool, limit_rad: float) -> tuple[FaultName, str, str]:
        error_deg, limit_deg = deg(abs(self.error_rad)), deg(limit_rad)
        size = f"by {error_deg:.1f}°, limit {limit_deg:.1f}°"
        asked_rad_s = self._asked_rad_s
        if not enabled:
            return (
                FaultName.IDLE_MOTION,
                "drive",
                f"the base moved {size} while nothing was asked of it; check the power stage"
                f" (if you turned it by hand, `needle-rig release` it first){CLEAR_TEXT}",
            )
        if self.error_rad * asked_rad_s <= 0.0:
            return (
                FaultName.RUNAWAY,
                "drive",
                f"the base turned further than asked, {size}; check the power stage and the encoder's scale"
                f"{CLEAR_TEXT}",
            )
        if self._turned_rad_s * asked_rad_s < -REVERSE_SHARE * asked_rad_s**2:
            return (
                FaultName.WRONG_DIRECTION,
                "drive",
                f"the base turns against what is asked, {size}; check the wiring of motor and encoder"
                f"{CLEAR_TEXT}",
            )
        return (
            FaultName.NOT_TURNING,
            "drive",
            f"the base lags behind what is asked {size}: the motor is dead, blocked or off its supply, or the"
            f" encoder stands still; check them{CLEAR_TEXT}",
        )
