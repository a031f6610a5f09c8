"""The following error: what was commanded so far against what the encoder says was turned, at any speed.

The drive node judges the same within milliseconds (firmware/core/nr_motion.c); this is the second pair of
eyes, on the other side of the bus.
"""

from __future__ import annotations

import math
from collections import deque
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
SHORTEST_S = 1e-6
"""Two samples that are nearer in time are one."""
CLEAR_TEXT = ", then: needle-rig clear"


@dataclass(frozen=True)
class FollowingLimits:
    """`floor_rad` at standstill, and on top what `response_s` explains, the time that bus, drive and motor
    may take to answer: behind the command what its speed covers in it, ahead what it has slowed down by."""

    floor_rad: float
    response_s: float


class CommandedPath:
    """Integral of the commanded velocity, to be asked at any time since the last question."""

    def __init__(self) -> None:
        self._now_s = 0.0
        self._now_rad = 0.0
        self._parts: deque[tuple[float, float, float]] = deque([(0.0, 0.0, 0.0)])
        """Since when, rad commanded until then, rad/s from then on."""

    def add(self, velocity_rad_s: float, dt_s: float) -> None:
        """`velocity_rad_s` was in force for the last `dt_s`."""
        if velocity_rad_s != self._parts[-1][2]:
            self._parts.append((self._now_s, self._now_rad, velocity_rad_s))
        self._now_s += dt_s
        self._now_rad += velocity_rad_s * dt_s

    @property
    def now_s(self) -> float:
        """The end of what was added."""
        return self._now_s

    def until(self, time_s: float) -> tuple[float, float, float]:
        """rad commanded until `time_s`, rad/s in force then, the largest speed since the last question."""
        parts, fastest_rad_s = self._parts, 0.0
        while len(parts) > 1 and parts[1][0] < time_s:
            fastest_rad_s = max(fastest_rad_s, abs(parts.popleft()[2]))
        start_s, start_rad, velocity_rad_s = parts[0]
        fastest_rad_s = max(fastest_rad_s, abs(velocity_rad_s))
        return start_rad + velocity_rad_s * (time_s - start_s), velocity_rad_s, fastest_rad_s


class FollowingError:
    """Commanded less turned, from one sample of the encoder to the next, whether the base is driven or not.

    A sample is held against what had been commanded when it was taken: an answer that comes late, or only now
    and then, is judged by the same limits.
    """

    def __init__(self, limits: FollowingLimits) -> None:
        self._limits = limits
        self._path = CommandedPath()
        self.rebase()

    def rebase(self) -> None:
        """The base may be turned by something else, or its angle is being set: begin at the next sample."""
        self.error_rad = 0.0
        self._last: tuple[float, float, float] | None = None
        self._peak_rad_s = 0.0
        self._asked_rad_s = 0.0
        self._turned_rad_s = 0.0

    def commanded(self, velocity_rad_s: float, dt_s: float) -> None:
        """`velocity_rad_s` was in force for the last `dt_s` > 0."""
        self._path.add(velocity_rad_s, dt_s)

    def sample(self, angle_rad: float, age_s: float, *, enabled: bool) -> Fault | None:
        """The newest sample of the encoder, taken `age_s` ago; a latching fault when it is too far from what
        was commanded until then."""
        time_s = self._path.now_s - age_s
        if self._last is None:
            asked_rad, _, _ = self._path.until(time_s)
            self._last = (time_s, asked_rad, angle_rad)
            return None
        last_s, last_asked_rad, last_rad = self._last
        dt_s = time_s - last_s
        if dt_s < SHORTEST_S:
            return None
        asked_rad, commanded_rad_s, fastest_rad_s = self._path.until(time_s)
        self._last = (time_s, asked_rad, angle_rad)
        return self._judge(
            asked_rad - last_asked_rad, angle_rad - last_rad, dt_s, commanded_rad_s, fastest_rad_s, enabled
        )

    def _judge(
        self,
        asked_rad: float,
        turned_rad: float,
        dt_s: float,
        commanded_rad_s: float,
        fastest_rad_s: float,
        enabled: bool,
    ) -> Fault | None:
        forgiven_rad = SCALE_TOLERANCE * abs(asked_rad) + DRIFT_RAD_S * dt_s
        error_rad = self.error_rad + asked_rad - turned_rad
        # an answer that comes later than the command is no error to be forgiven: it comes back at the end
        late_rad = self._limits.response_s * commanded_rad_s
        least_rad, most_rad = (late_rad, 0.0) if late_rad < 0.0 else (0.0, late_rad)
        if error_rad > most_rad:
            error_rad = max(error_rad - forgiven_rad, most_rad)
        elif error_rad < least_rad:
            error_rad = min(error_rad + forgiven_rad, least_rad)
        self.error_rad = error_rad
        kept = math.exp(-dt_s / self._limits.response_s)
        self._peak_rad_s = max(fastest_rad_s, self._peak_rad_s * kept)
        self._asked_rad_s += (1.0 - kept) * (asked_rad / dt_s - self._asked_rad_s)
        self._turned_rad_s += (1.0 - kept) * (turned_rad / dt_s - self._turned_rad_s)
        limit_rad = self._limit_rad(commanded_rad_s)
        if abs(self.error_rad) <= limit_rad:
            return None
        return Fault(*self._told(enabled, limit_rad), latching=True)

    def _limit_rad(self, commanded_rad_s: float) -> float:
        """What the error may be now, on the side on which it is."""
        late_rad_s = self._peak_rad_s
        if self.error_rad * commanded_rad_s < 0.0:
            late_rad_s -= abs(commanded_rad_s)
        return self._limits.floor_rad + self._limits.response_s * late_rad_s

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
