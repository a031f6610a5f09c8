"""Trials whose shaft was not relaxed when the recording began: from where on that no longer matters.

Dry friction keeps order: of two shafts on one path of the base, that which begins farther round at every
place stays so (order preservation of Prandtl-Ishlinskii operators: Visintin 1994, III.2). Every start that
friction can hold lies between the two in which each node has slipped to it, from above and from below.
Readings that are the same from both are free of the start: a run-in leaves out the others. Where too few are
free, the start is fitted as one turn from a relaxed shaft. What other turns would change, of a shaft with the
friction found and of one held harder, has the covariance of an ensemble and counts as uncertainty.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from needle_rig.dataset import Dataset, DatasetTrial
from needle_rig.dataset.records import Start
from needle_rig.numerics import Array
from needle_rig.physics.needle_model import BASE_PARAMETERS, FRICTION, NeedleModel
from needle_rig.physics.rod import build_rod
from needle_rig.units import deg, per_length_n, rad
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial, bins_of_samples
from needle_rig.workbench.observations.earlier_path import PHASE, with_path_before
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import Noise, Whitener, variance, whitener
from needle_rig.workbench.policy import POLICY

LAGS_DEG = (5.0, 12.0, 25.0, 50.0, 100.0, 200.0)
"""Lags of a tip whose whole shaft slips, of which friction is guessed; a level finer follows."""
FINER = (0.6, 0.8, 1.0, 1.25, 1.6)
TURNS = (-2.0, -1.0, -0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 1.0, 2.0)
"""Turns from a relaxed shaft to the start that are tried, in lags of the tip: the whole shaft slips in the
outermost, whatever the friction."""
BETTER = 1.0
"""χ² by which a smaller turn must fit better. With the friction that is guessed all beyond one lag do alike;
with more, which a fit may find, the whole shaft slips in the outermost alone."""
FEW_TURNS = (-2.0, -0.5, 0.5, 2.0)
"""Those of them that friction is guessed with,"""
GUESSED_FROM = 2
"""from the trials whose base turns farthest."""
EXACT = 0.01
"""To which the turn is found, in lags: a quarter of a degree where friction lets the tip lag 25°."""
BEYOND = 1.5
"""Of the guessed friction, which the extreme starts have: effects that are not in the model yet hold a shaft
harder. An elastic tissue of 0.35 N·mm/rad per 100 mm lets the tip lag 1.6 times as far before all slips."""
SEEN_RAD = 10.0
"""Turn and lag with which a path before a trial is divided into motions: of the smallest, 0.2 rad, too."""
REVERSALS, SHRINK = 20, 0.8
"""Turns to and fro that relax a shaft, the last a hundredth of the first; the slower they shrink, the less is
left."""
WORDS = {
    "wound": "an unknown twist",
    "zeroed": "an unknown twist, from which torque and angles are counted",
}


def after_run_in(dataset: Dataset, model: NeedleModel, *, friction_known: bool) -> Dataset:
    """The dataset; trials with an unknown start as far as they can be judged, with notes.

    The path of such a trial gets turns before it that wind the shaft as it was found to be. `model` has the
    dataset's geometry; its friction is guessed where it is not known. Raises SolverError, BadInput.
    """
    if all(t.start == "relaxed" for t in dataset.trials):
        return dataset
    recorded = [Wound.of(t) for t in dataset.trials]
    # with a path before it an unknown twist is no rest, whose scatter would count as noise
    noise = measure_noise([r.seen for r in recorded], [r.binned for r in recorded], dataset.torque_scale)
    shaft = _shaft_of(recorded, dataset, noise, model, friction_known)
    trials: list[DatasetTrial] = []
    notes: list[str] = []
    run_ins: dict[Start, list[_RunIn]] = {}
    for each in recorded:
        if each.given.start == "relaxed":
            trials.append(each.given)
            continue
        trial, found = shaft.judged(each)
        trials.append(trial)
        if isinstance(found, _RunIn):
            run_ins.setdefault(each.given.start, []).append(found)
        else:
            notes.append(found)
    notes += [_note(start, each) for start, each in run_ins.items()]
    return dataclasses.replace(dataset, trials=tuple(trials), notes=(*dataset.notes, *notes))


def wound(trial: DatasetTrial, turn_rad: float, lag_rad: float) -> DatasetTrial:
    """The trial with a path before it that relaxes the shaft and turns it by `turn_rad` to the start."""
    base_rad = float(trial.trial.base_angle_rad[0])
    relaxed_rad = base_rad - turn_rad
    ends = [relaxed_rad + 2.0 * lag_rad * (-SHRINK) ** k for k in range(REVERSALS)]
    return with_path_before(trial, [*ends, relaxed_rad])


@dataclass(frozen=True, eq=False)
class Wound:
    """A trial in bins, after any turn from a relaxed shaft: that moves the base before it alone.

    One that begins relaxed stays as it is.
    """

    given: DatasetTrial
    seen: DatasetTrial
    """After turns large enough to be motions of their own: its bins are those after any turn."""
    binned: BinnedTrial
    of_turn: Array
    """Change of the base angle at each grid point (m,) by a turn of 1 rad,"""
    of_lag: Array
    """and by a lag of 1 rad."""

    @classmethod
    def of(cls, given: DatasetTrial) -> Wound:
        """A trial of a dataset."""
        if given.start == "relaxed":
            binned = bin_trial(given)
            return cls(given, given, binned, *np.zeros((2, binned.trial.time_s.size)))
        seen = wound(given, SEEN_RAD, SEEN_RAD)
        binned = bin_trial(seen)
        grid_s = binned.trial.time_s

        def base_rad(turn_rad: float, lag_rad: float) -> Array:
            trial = wound(given, turn_rad, lag_rad).trial
            return np.interp(grid_s, trial.time_s, trial.base_angle_rad)

        none = base_rad(0.0, 0.0)
        before = grid_s < given.trial.time_s[0]
        path = np.where(before, none, binned.trial.base_angle_rad)
        of_turn, of_lag = (np.where(before, base_rad(*by) - none, 0.0) for by in ((1.0, 0.0), (0.0, 1.0)))
        begun = dataclasses.replace(binned, trial=dataclasses.replace(binned.trial, base_angle_rad=path))
        return cls(given, seen, begun, of_turn, of_lag)

    def after(self, turn_rad: float, lag_rad: float) -> BinnedTrial:
        """After a turn to its start, of a shaft whose tip lags by this much when all of it slips."""
        trial = self.binned.trial
        path = trial.base_angle_rad + turn_rad * self.of_turn + lag_rad * self.of_lag
        return dataclasses.replace(self.binned, trial=dataclasses.replace(trial, base_angle_rad=path))


@dataclass(frozen=True)
class _RunIn:
    """What is judged of a trial after its run-in."""

    file: str
    share: float
    """Of its readings."""
    since_s: Mapping[str, float]
    """By channel; inf where none is judged."""


def _note(start: Start, run_ins: Sequence[_RunIn]) -> str:
    """What trials that are judged after a run-in have left."""
    first, *others = run_ins
    whose = f"{first.file} begins" if not others else f"{first.file} and {len(others)} more begin"
    share = _from_to([100.0 * r.share for r in run_ins], "{:.0f}", "%")
    since = []
    for name in dict.fromkeys(name for r in run_ins for name in r.since_s):
        at_s = [r.since_s[name] for r in run_ins if name in r.since_s]
        told = [each for each in at_s if math.isfinite(each)]
        if told:
            since.append(f"{name} from {_from_to(told, '{:.3g}', ' s')}")
        if len(told) < len(at_s):
            since.append(f"{name} never" + (f" in {len(at_s) - len(told)}" if told else ""))
    return (
        f"{whose} with {WORDS[start]}; after a run-in {share} of the readings do not depend on that and are"
        f" judged: {', '.join(since)}"
    )


def _from_to(values: Sequence[float], spelt: str, unit: str) -> str:
    low, high = (spelt.format(end) for end in (min(values), max(values)))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"


def _shaft_of(
    recorded: Sequence[Wound], dataset: Dataset, noise: Noise, given: NeedleModel, friction_known: bool
) -> _Shaft:
    """The shaft of the model's friction where that is known; else of the friction that fits the trials best,
    each from the start that fits it best."""
    rod = build_rod(dataset.layout, given.torsional_rigidity_nm2, 1.0, given.element_length_m)
    beyond_nm = np.cumsum(rod.slip_plus_nm[::-1])[::-1][1:]
    lag_of_newton = max(float((beyond_nm / rod.stiffness_nm_per_rad).sum()), 1e-12)

    most_n = per_length_n(BASE_PARAMETERS[FRICTION].scaled(given.torque_scale).upper) / BEYOND

    whiten = functools.cache(functools.partial(_whitener, noise, given))

    def of(lag_rad: float) -> _Shaft:
        lag_rad = min(lag_rad, most_n * lag_of_newton)
        model = dataclasses.replace(given, friction_n=lag_rad / lag_of_newton)
        return _Shaft(model, lag_rad, noise, tuple(dataset.sensor_names), whiten)

    if friction_known:
        return of(given.friction_n * lag_of_newton)
    travelled_rad = [float(np.abs(np.diff(r.given.trial.base_angle_rad)).sum()) for r in recorded]
    told = [recorded[k] for k in np.argsort(-np.array(travelled_rad), kind="stable")[:GUESSED_FROM]]

    def misfit(lag_rad: float) -> float:
        return sum(of(lag_rad).start(t, FEW_TURNS)[1] for t in told)

    level = min((rad(lag) for lag in LAGS_DEG), key=misfit)
    return of(min((level * f for f in FINER), key=misfit))


def _whitener(noise: Noise, model: NeedleModel, given: Wound) -> Whitener:
    """Of a trial after any turn; what is counted from the start may be off by any lag."""
    binned = given.binned
    if given.given.start == "zeroed":
        channels, bins = binned.mean.shape
        # of any shaft that is tried: a width of its own would favour the loosest
        most_rad = rad(LAGS_DEG[-1])
        most_nm = most_rad * model.torsional_rigidity_nm2 / model.layout.needle_length_m
        offsets = np.diag([most_nm, *[most_rad] * (channels - 1)])
        binned = dataclasses.replace(binned, from_start=np.repeat(offsets[:, None, :], bins, axis=1))
    return whitener(noise, binned)


@dataclass(frozen=True)
class _Shaft:
    """A needle, how far its tip lags when all of it slips, and the noise of the readings."""

    model: NeedleModel
    lag_rad: float
    noise: Noise
    sensor_names: tuple[str, ...]
    whitener: Callable[[Wound], Whitener]
    """Of a trial after any turn, whatever the friction."""
    simulator: Simulator = field(default_factory=Simulator)

    def start(self, given: Wound, turns: Sequence[float] = TURNS) -> tuple[float, float]:
        """(turn from a relaxed shaft to the start that fits best of some, χ² with it)."""
        tried_rad = [0.0] if given.given.start == "relaxed" else [turn * self.lag_rad for turn in turns]
        chi2 = self._chi2(given, self.whitener(given), tried_rad)
        likely = [
            turn_rad for turn_rad, each in zip(tried_rad, chi2, strict=True) if each <= min(chi2) + BETTER
        ]
        best_rad = max(likely, key=abs)
        return best_rad, chi2[tried_rad.index(best_rad)]

    def _finer(self, given: Wound) -> float:
        """The turn that fits best, between those beside the best of `start`."""
        best_rad, least = self.start(given)
        place = int(np.argmin(np.abs(np.array(TURNS) * self.lag_rad - best_rad)))
        if place in (0, len(TURNS) - 1):
            return best_rad
        ends = (TURNS[place - 1] * self.lag_rad, TURNS[place + 1] * self.lag_rad)
        whiten = self.whitener(given)
        found = minimize_scalar(
            lambda turn_rad: self._chi2(given, whiten, [float(turn_rad)])[0],
            bounds=ends,
            method="bounded",
            options={"xatol": EXACT * self.lag_rad},
        )
        return float(found.x) if found.fun < least else best_rad

    def judged(self, recorded: Wound) -> tuple[DatasetTrial, _RunIn | str]:
        """The trial without readings that depend on its start, and what is judged then; or with these
        uncertain, and a sentence on the start that was fitted."""
        given = recorded.given
        turn_rad = self._finer(recorded)
        trial = wound(given, turn_rad, self.lag_rad)
        binned = recorded.binned
        before = ((0, 0), (0, 0), (int((binned.time_s < given.trial.time_s[0]).sum()), 0))
        turns_rad = [turn * self.lag_rad for turn in TURNS]
        seen = self._recorded(recorded, [turn_rad, *turns_rad], 1.0)
        others = np.pad(seen, before)
        beyond_rad = [turn_rad, *(BEYOND * turn for turn in turns_rad)]
        harder = np.pad(self._recorded(recorded, beyond_rad, BEYOND), before)
        half = 0.5 * (harder[-1] - harder[1])
        away = np.concatenate([others[1:] - others[0], harder[1:] - harder[0]])
        free = np.zeros(half.shape, dtype=np.bool_)
        for c in range(len(half)):
            free[c] = np.abs(half[c]) < POLICY.noise.start_sigmas * np.sqrt(variance(self.noise, binned, c))
        known = np.isfinite(binned.mean)
        share = float(free[known].mean())
        of_sample = bins_of_samples(recorded.seen)
        changes = list(away / math.sqrt(len(away)))
        if given.start == "zeroed":
            first = of_sample[np.flatnonzero(trial.phase != PHASE)[0]]
            changes += [np.where(place[:, None], half[:, [first]], 0.0) for place in np.eye(len(half))]
            # about what the start that was found shows: zero itself would be far off in every trial alike
            torque_nm, *hall_rad = seen[0, :, 0]
            trial = dataclasses.replace(
                trial, torque_nm=trial.torque_nm + torque_nm, hall_rad=trial.hall_rad + hall_rad
            )
        changed = np.array([np.broadcast_to(c, half.shape)[:, of_sample] for c in changes])
        trial = dataclasses.replace(trial, start_change=changed)
        if share < POLICY.noise.start_free_share:
            limit = f"{POLICY.noise.start_free_share:.0%}"
            return dataclasses.replace(trial, start_found=True), (
                f"{given.file} begins with {WORDS[given.start]}; {share:.0%} of the readings do not depend on"
                f" it, too few for a run-in (limit {limit}): the start is fitted as a turn of"
                f" {deg(turn_rad):.0f}° from a relaxed shaft, and what another start would change counts as"
                " uncertainty"
            )
        keep = free[:, of_sample]
        trial = dataclasses.replace(
            trial,
            torque_nm=np.where(keep[0], trial.torque_nm, np.nan),
            hall_rad=np.where(keep[1:].T, trial.hall_rad, np.nan),
            start_found=given.start == "zeroed",
        )
        return trial, self._run_in(given.file, binned, free & known, known, share)

    def _recorded(self, given: Wound, turns_rad: Sequence[float], harder: float) -> Array:
        """Means of the recorded bins (turns, C, K) from each start, of a shaft that is held `harder`."""
        model = dataclasses.replace(self.model, friction_n=harder * self.model.friction_n)
        starts = [given.after(turn_rad, harder * self.lag_rad) for turn_rad in turns_rad]
        readings = self.simulator.readings([model] * len(starts), starts)
        begin_s = float(given.given.trial.time_s[0])
        return np.array([r[:, b.time_s >= begin_s] for r, b in zip(readings, starts, strict=True)])

    def _run_in(
        self,
        file: str,
        binned: BinnedTrial,
        judged: npt.NDArray[np.bool_],
        known: npt.NDArray[np.bool_],
        share: float,
    ) -> _RunIn:
        since_s = {
            name: float(binned.time_s[of_channel].min(initial=np.inf))
            for name, of_channel, measured in zip(("torque", *self.sensor_names), judged, known, strict=True)
            if measured.any()
        }
        return _RunIn(file, share, since_s)

    def _chi2(self, given: Wound, whiten: Whitener, turns_rad: Sequence[float]) -> list[float]:
        """χ² of a trial after each turn."""
        starts = [given.after(turn_rad, self.lag_rad) for turn_rad in turns_rad]
        readings = self.simulator.readings([self.model] * len(starts), starts)
        return [float((whiten(given.binned.mean - reading) ** 2).sum()) for reading in readings]
