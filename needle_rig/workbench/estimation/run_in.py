"""Trials whose shaft was not relaxed when the recording began: where their start no longer matters, or what it was.

Dry friction keeps order: of two shafts on one path of the base, that which begins farther round at every place stays
so (order preservation of Prandtl-Ishlinskii operators: Visintin 1994, III.2). Every start that friction can hold
lies between the two in which each node has slipped to the start from above, and from below. Readings that are the
same from both are free of the start: a *run-in* leaves out the others. Where too few are free, the start is fitted
as one turn from a relaxed shaft, and what the two extremes differ by is uncertainty of the readings.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import build_rod
from needle_rig.units import deg, rad
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial, sample_weights
from needle_rig.workbench.observations.noise import Noise, covariance, measure_noise, whitener
from needle_rig.workbench.policy import POLICY

LAGS_DEG = (5.0, 12.0, 25.0, 50.0, 100.0, 200.0)
"""Lags of a tip whose whole shaft slips, of which friction is guessed; a level finer follows."""
FINER = (0.6, 0.8, 1.0, 1.25, 1.6)
TURNS = (-1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0)
"""Turns from a relaxed shaft to the start that are tried, in lags of the tip."""
BEYOND = 1.25
"""Of the guessed friction, which the extreme starts have, and of the turn that makes the whole shaft slip: effects
that are not in the model yet hold a shaft harder."""
REVERSALS, SHRINK = 9, 0.6
"""Turns to and fro that relax a shaft: the last is a hundredth of the first."""
TURN_SAMPLES, TURN_S = 12, 2.0
REST_S = 1.0
UNIFORM = 1.0 / math.sqrt(3.0)
"""Standard deviation of what lies anywhere between −1 and 1."""
PHASE = "run-in"
WORDS = {
    "wound": "begins with an unknown twist",
    "zeroed": "begins with an unknown twist, from which torque and angles are counted",
}


def after_run_in(dataset: Dataset, null: NeedleModel) -> Dataset:
    """The dataset; trials with an unknown start as far as they can be judged, each with a sentence.

    The path of such a trial gets turns before it that wind the shaft as it was found to be. `null` is rigid tissue in
    the dataset's geometry; its friction is guessed. Raises SolverError, BadInput.
    """
    if all(t.start == "relaxed" for t in dataset.trials):
        return dataset
    noise = measure_noise(dataset.trials, [bin_trial(t) for t in dataset.trials])
    shaft = _guessed(dataset, noise, null)
    trials, notes = [], []
    for given in dataset.trials:
        if given.start == "relaxed":
            trials.append(given)
            continue
        trial, note = shaft.judged(given)
        trials.append(trial)
        notes.append(note)
    return dataclasses.replace(dataset, trials=tuple(trials), notes=(*dataset.notes, *notes))


def wound(trial: DatasetTrial, turn_rad: float, lag_rad: float) -> DatasetTrial:
    """The trial with a path before it that relaxes the shaft and turns it by `turn_rad` to the start."""
    base_rad = float(trial.trial.base_angle_rad[0])
    relaxed_rad = base_rad - turn_rad
    ends = [relaxed_rad + 2.0 * lag_rad * (-SHRINK) ** k for k in range(REVERSALS)]
    corners = np.array([0.0, *ends, relaxed_rad, base_rad])
    place = np.arange(TURN_SAMPLES * (len(corners) - 1)) / TURN_SAMPLES
    path = np.r_[np.interp(place, np.arange(len(corners)), corners), base_rad, base_rad]
    begin_s = float(trial.trial.time_s[0])
    time_s = begin_s - REST_S - TURN_S * (len(corners) - 1 - np.r_[place, len(corners) - 1.0])
    time_s = np.r_[time_s, begin_s - 0.5 * REST_S]
    count = len(path)
    unseen = np.full((count, trial.hall_rad.shape[1]), np.nan)
    drive, change = trial.trial, trial.start_change
    return dataclasses.replace(
        trial,
        trial=dataclasses.replace(
            drive, time_s=np.r_[time_s, drive.time_s], base_angle_rad=np.r_[path, drive.base_angle_rad]
        ),
        base_measured_rad=np.r_[path, trial.base_measured_rad],
        torque_nm=np.r_[np.full(count, np.nan), trial.torque_nm],
        hall_rad=np.vstack([unseen, trial.hall_rad]),
        phase=np.concatenate([np.full(count, PHASE), trial.phase]),
        start_change=None if change is None else np.pad(change, ((0, 0), (0, 0), (count, 0))),
    )


def _guessed(dataset: Dataset, noise: Noise, null: NeedleModel) -> _Shaft:
    """The shaft of the friction that fits the trials best, each from the start that fits it best."""
    rod = build_rod(dataset.layout, null.torsional_rigidity_nm2, 1.0, null.element_length_m)
    beyond_nm = np.cumsum(rod.slip_plus_nm[::-1])[::-1][1:]
    lag_of_newton = max(float((beyond_nm / rod.stiffness_nm_per_rad).sum()), 1e-12)

    def of(lag_rad: float) -> _Shaft:
        model = dataclasses.replace(null, friction_n=lag_rad / lag_of_newton)
        return _Shaft(model, lag_rad, noise, tuple(dataset.sensor_names))

    def misfit(lag_rad: float) -> float:
        return sum(of(lag_rad).start(t)[1] for t in dataset.trials)

    level = min((rad(lag) for lag in LAGS_DEG), key=misfit)
    return of(min((level * f for f in FINER), key=misfit))


@dataclass(frozen=True)
class _Shaft:
    """A needle in rigid tissue, how far its tip lags when all of it slips, and the noise of what it is held against."""

    model: NeedleModel
    lag_rad: float
    noise: Noise
    sensor_names: tuple[str, ...]
    simulator: Simulator = field(default_factory=Simulator)

    def start(self, given: DatasetTrial) -> tuple[float, float]:
        """(turn from a relaxed shaft to the start that fits best, χ² with it)."""
        if given.start == "relaxed":
            return 0.0, self._chi2(bin_trial(given))
        tried = {turn * self.lag_rad: self._chi2(self._from(given, turn * self.lag_rad)) for turn in TURNS}
        best = min(tried, key=lambda turn: tried[turn])
        return best, tried[best]

    def judged(self, given: DatasetTrial) -> tuple[DatasetTrial, str]:
        """The trial with readings that depend on its start left out, or with these uncertain; and what was done."""
        turn_rad, _ = self.start(given)
        trial = wound(given, turn_rad, self.lag_rad)
        binned = bin_trial(trial)
        most_rad = BEYOND * self.lag_rad
        held = dataclasses.replace(self.model, friction_n=BEYOND * self.model.friction_n)
        extremes = [bin_trial(wound(given, way * BEYOND * most_rad, BEYOND * most_rad)) for way in (1.0, -1.0)]
        below, above = self.simulator.readings([held, held], extremes)
        half = 0.5 * np.abs(above - below)
        every_bin = [covariance(self.noise, binned, c) for c in range(len(half))]
        free = np.zeros(half.shape, dtype=np.bool_)
        for c, (use, matrix) in enumerate(every_bin):
            free[c, use] = half[c, use] < POLICY.noise.start_sigmas * np.sqrt(np.diag(matrix))
        known = np.isfinite(binned.mean)
        share = float(free[known].mean())
        of_sample = sample_weights(trial).tocsc().indices
        change = 0.5 * (below - above)
        first = int(np.flatnonzero(trial.phase != PHASE)[0])
        offsets = UNIFORM * np.abs(change[:, of_sample[first]])
        changes = []
        if given.start == "zeroed":
            changes = [
                np.where(np.arange(len(half)) == c, offsets[c], 0.0)[:, None] * np.ones(len(of_sample))
                for c in range(len(half))
            ]
        if share >= POLICY.noise.start_free_share:
            keep = free[:, of_sample]
            trial = dataclasses.replace(
                trial,
                torque_nm=np.where(keep[0], trial.torque_nm, np.nan),
                hall_rad=np.where(keep[1:].T, trial.hall_rad, np.nan),
            )
            note = f"{given.file}: {WORDS[given.start]}; {self._run_in(binned, free, known, share)}"
        else:
            changes.append(UNIFORM * change[:, of_sample])
            note = (
                f"{given.file}: {WORDS[given.start]}; {share:.0%} of the readings do not depend on the start, too few"
                f" (limit {POLICY.noise.start_free_share:.0%}): the start is fitted as a turn of {deg(turn_rad):.0f}°"
                " from a relaxed shaft, and what any other start would change counts as uncertainty"
            )
        return dataclasses.replace(trial, start_change=np.array(changes) if changes else None), note

    def _run_in(
        self, binned: BinnedTrial, free: npt.NDArray[np.bool_], known: npt.NDArray[np.bool_], share: float
    ) -> str:
        since = []
        for name, is_free, is_known in zip(("torque", *self.sensor_names), free, known, strict=True):
            judged = np.flatnonzero(is_free & is_known)
            if judged.size:
                since.append(f"{name} from {binned.time_s[judged[0]]:.3g} s")
            elif is_known.any():
                since.append(f"{name} never")
        return f"after a run-in {share:.0%} of the readings do not depend on that and are judged: {', '.join(since)}"

    def _from(self, given: DatasetTrial, turn_rad: float) -> BinnedTrial:
        """In bins, with `turn_rad` before it; what is counted from the start may be off by any lag."""
        binned = bin_trial(wound(given, turn_rad, self.lag_rad))
        if given.start != "zeroed":
            return binned
        channels, bins = binned.mean.shape
        most = np.r_[self.lag_rad * self.model.torsional_rigidity_nm2 / self.model.layout.needle_length_m, self.lag_rad]
        offsets = np.eye(channels) * np.where(np.arange(channels) == 0, *most)
        return dataclasses.replace(binned, from_start=np.repeat(offsets[:, None, :], bins, axis=1))

    def _chi2(self, binned: BinnedTrial) -> float:
        (reading,) = self.simulator.readings([self.model], [binned])
        return float((whitener(self.noise, binned)(binned.mean - reading) ** 2).sum())
