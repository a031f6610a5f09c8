"""A coupling slips once, at one instant of a series, and stays where it went.

Law: θ_held = θ_base − s from the instant t_s on, on the clock of the series: a set-screw or collet that lets
go for a moment. In the trial of the slip the needle is turned by −s; in the trials after it, which begin
relaxed, all its sensors read s less at one angle of the base.

Source: a clamped connection slips where the torque exceeds the friction of its grip, and then holds again:
Budynas, Nisbett, "Shigley's Mechanical Engineering Design", 10th ed. (2015), ch. 7-8 (set-screws) and
ch. 16-10.

Shows best: any series with the base at one angle before and after: all sensors jump by the same angle and
stay. Angles of sensors in one trial alone cannot tell it from their zeros.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial, parameter
from needle_rig.units import rad


def instants(trials: Sequence[Trial]) -> list[list[float]]:
    """Instants at which it may have slipped, s: the beginning of each trial but the first, and the times at
    which the base was turning, a row each motion."""
    found = []
    for place, trial in enumerate(trials):
        if place:
            found.append([trial.start_s])
        turned = np.abs(np.diff(trial.base_angle_rad))
        turning = np.flatnonzero(turned > LEAST_SHARE * turned.max(initial=0.0))
        middle_s = trial.start_s + 0.5 * (trial.time_s[1:] + trial.time_s[:-1])
        motions = np.split(turning, 1 + np.flatnonzero(np.diff(turning) > 1))
        found += [middle_s[motion].tolist() for motion in motions if motion.size]
    return found


LEAST_SHARE = 0.05
"""Share of a trial's largest step from which the base counts as turning: less is its drive's last creep, or
noise."""


@dataclass(frozen=True)
class CouplingSlip(Effect):
    """A jump of the needle's held end against the base encoder, once."""

    relatives = ("hall_offset", "chuck_backlash", "chuck_compliance")
    stage = -1

    slip_deg: float = parameter(
        off=0.0,
        lower=-360.0,
        upper=360.0,
        typical=5.0,
        smallest=0.5,
        literature=(-90.0, 90.0),
        unit="°",
    )
    at_s: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1e9,
        typical=60.0,
        smallest=1.0,
        literature=(0.0, 1e9),
        unit="s",
        shapes=True,
        places=instants,
    )

    def drive(self, trial: Trial) -> Array:
        """The held end's path (samples,) in rad: behind the base from a slip within the trial on."""
        path_rad = trial.base_angle_rad
        if self.at_s <= trial.start_s:
            return path_rad
        return path_rad - rad(self.slip_deg) * (trial.start_s + trial.time_s > self.at_s)

    def observe(self, reading: Reading) -> Reading:
        """Turn all angles of a trial after the slip, which begins relaxed where the needle is now."""
        if self.at_s > reading.trial.start_s:
            return reading
        return replace(reading, hall_rad=reading.hall_rad - rad(self.slip_deg))
