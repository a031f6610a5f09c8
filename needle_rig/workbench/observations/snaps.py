"""Where a needle snapped: a sensor that turned further than the base did, for a moment.

A shaft in tissue whose resistance never falls passes on the turn of its base and adds nothing to it: as in
diffusion (the maximum principle) no place turns faster than the base has turned. Where resistance falls with
the rate, the slip or the angle, stored twist is let go at once (stick-slip). That is seen in the data alone,
before any model is fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.units import deg
from needle_rig.workbench.policy import POLICY

Array = npt.NDArray[np.float64]

MEDIAN_OF_THREE = 0.67
"""Standard deviation of the median of three normal numbers."""
NORMAL_MEDIAN = 0.6745
"""Median of |x| of a standard normal number."""


@dataclass(frozen=True)
class Snap:
    """The largest one of a motion at one sensor, in degrees over `POLICY.snaps.span_s`."""

    file: str
    motion: str
    sensor: str
    time_s: float
    turned_deg: float
    base_deg: float
    """What the base turns at its fastest in that time."""


def snaps(dataset: Dataset) -> tuple[Snap, ...]:
    """Every motion and sensor that snapped, the largest first."""
    noise_rad = _noise(dataset)
    found = [snap for trial in dataset.trials for snap in _of_trial(trial, dataset.sensor_names, noise_rad)]
    return tuple(sorted(found, key=lambda snap: -abs(snap.turned_deg)))


def sentence(found: Sequence[Snap]) -> str:
    """What was seen, for a person; empty where nothing was."""
    if not found:
        return ""
    motions = len({(snap.file, snap.motion) for snap in found})
    largest = found[0]
    return (
        f"the needle snaps (stick-slip) in {motions} motion{'s' if motions > 1 else ''}: at"
        f" {largest.time_s:.1f} s of {largest.file} {largest.sensor} turned {abs(largest.turned_deg):.1f}°"
        f" within {POLICY.snaps.span_s:g} s, the base at most {largest.base_deg:.1f}°"
    )


def _noise(dataset: Dataset) -> Array:
    """White noise of each sensor (sensors,), rad, from neighbouring samples, most of which are of rest."""
    steps = np.abs(np.concatenate([np.diff(trial.hall_rad, axis=0) for trial in dataset.trials]))
    known = [column[np.isfinite(column)] for column in steps.T]
    middle = np.array([np.median(column) if column.size else 0.0 for column in known])
    spread = middle / (NORMAL_MEDIAN * np.sqrt(2.0))
    # a sensor that is dead, or repeats its last digit, shows no spread
    return np.asarray(np.where(spread > 0.0, spread, np.inf))


def _of_trial(trial: DatasetTrial, names: Sequence[str], noise_rad: Array) -> list[Snap]:
    if trial.trial.tip_torque_nm is not None:
        return []  # a load turns the needle without its base
    time_s, base_rad = trial.trial.time_s, trial.trial.base_angle_rad
    sample_s = float(np.median(np.diff(time_s)))
    apart = max(3, round(POLICY.snaps.span_s / sample_s))
    if len(time_s) < apart + 3:
        return []
    # medians of three, so that one wild sample is none
    angle = np.median(np.lib.stride_tricks.sliding_window_view(trial.hall_rad, 3, axis=0), axis=2)
    turned = angle[apart:] - angle[:-apart]
    widest = apart + 2
    base = float(np.abs(base_rad[widest:] - base_rad[:-widest]).max())
    difference_rad = np.sqrt(2.0) * MEDIAN_OF_THREE * noise_rad
    beyond = np.abs(turned) - POLICY.snaps.sensor_gain * base - POLICY.noise.outlier_sigmas * difference_rad
    middle = np.arange(len(turned)) + (apart + 2) // 2
    regular = np.abs(time_s[widest:] - time_s[:-widest] - widest * sample_s) < 0.5 * sample_s
    phase, found = trial.phase[middle], []
    for motion in dict.fromkeys(phase.tolist()):
        here = np.flatnonzero((phase == motion) & regular)
        for sensor, name in enumerate(names):
            over = beyond[here, sensor]
            if not np.any(over > 0.0):
                continue
            at = here[int(np.nanargmax(over))]
            found.append(
                Snap(
                    trial.file,
                    str(motion),
                    name,
                    float(time_s[middle[at]]),
                    deg(float(turned[at, sensor])),
                    deg(base),
                )
            )
    return found
