"""The trial that would best tell two effects apart, within the rig's limits."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import solve_triangular

from needle_rig.dataset import DatasetTrial, TrialCommand
from needle_rig.dataset.protocol import Protocol, compensation, staircase
from needle_rig.errors import BadInput, SolverError
from needle_rig.numerics import Array, lower_root
from needle_rig.physics.effect import Trial
from needle_rig.simulation.drive.base_drive import base_path, phases
from needle_rig.workbench.estimation.linear import LinearisedFit, prediction_covariance
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import Objective
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial
from needle_rig.workbench.selection.documents import NextTrial
from needle_rig.workbench.selection.values import spelt_sigmas
from needle_rig.workbench.virtual.dataset import planned_motions
from needle_rig.workbench.virtual.noise import NO_NOISE

Places = npt.NDArray[np.int64]

RATE_HZ = 50.0
REPLICATES = 3
FASTEST_DEG_S = 60.0
LARGEST_DEG = 360.0


@dataclass(frozen=True)
class Proposal:
    """A command, and by how many σ one trial of it would separate two models beyond what is known."""

    command: TrialCommand
    separation_sigma: float
    duration_s: float
    watch: str
    """Channel and motion in which the two differ most, with the difference."""

    @property
    def worth(self) -> float:
        """Separation squared gained a minute."""
        return self.separation_sigma**2 / (self.duration_s / 60.0)

    def sentence(self, first: str, second: str) -> str:
        """In words."""
        return (
            f"{described(self.command)} separates {first} from {second} by"
            f" {spelt_sigmas(self.separation_sigma)} a trial of {self.duration_s:.0f} s; watch {self.watch}."
        )


def commands(
    speed_limit_deg_s: float = FASTEST_DEG_S, angle_limit_deg: float = LARGEST_DEG
) -> list[TrialCommand]:
    """Commands to choose from: targets, speeds, dwells and reversals within the rig's limits."""
    fast = min(45.0, speed_limit_deg_s)
    slow = min(5.0, speed_limit_deg_s)
    found = [
        *(compensation(t, fast, 3.0) for t in (45.0, 90.0, -45.0)),
        compensation(45.0, fast, 0.5),
        compensation(45.0, fast, 20.0),
        compensation(45.0, slow, 3.0),
        staircase((90.0, 0.0, 90.0, 0.0, 45.0), fast, 2.0),
        staircase((90.0, 0.0, 90.0, 0.0, 45.0), fast, 0.5),
        staircase((90.0, 0.0, 90.0, 0.0), slow, 0.5),
        staircase((60.0, 50.0, 60.0, 30.0, 60.0, 0.0, 60.0), fast, 2.0),
        staircase((360.0, 0.0), min(30.0, speed_limit_deg_s), 2.0),
        staircase((60.0, 62.0, 64.0, 66.0), fast, 20.0),
        staircase((45.0, -45.0, 45.0, -45.0, 0.0), fast, 2.0),
    ]
    reach = {c: max(abs(c.target_deg or 0.0) * 1.8, *(abs(s) for s in c.steps_deg), 0.0) for c in found}
    return [c for c in found if reach[c] <= angle_limit_deg]


def described(command: TrialCommand) -> str:
    """A command in words."""
    pace = f"at {command.speed_deg_s:g}°/s, {command.settle_s:g} s dwell"
    if command.steps_deg:
        return "the base to " + ", ".join(f"{s:g}°" for s in command.steps_deg) + f" {pace}"
    return f"a compensation to {command.target_deg:g}° {pace}"


def proposals(
    problem: Problem,
    first: Fit,
    second: Fit,
    sensors: Sequence[str],
    among: Sequence[TrialCommand] | None = None,
) -> list[Proposal]:
    """Commands by what a minute of each would tell, best first, without those that cannot be simulated."""
    found = []
    for command in among or commands():
        try:
            proposal = _proposal(problem, first, second, sensors, command)
        except (SolverError, BadInput):
            continue
        found.append(proposal)
    return sorted(found, key=lambda p: -p.worth)


def planned(problem: Problem, truth: Fit, command: TrialCommand) -> tuple[BinnedTrial, float]:
    """One noise-free trial of `command` in bins, as `truth` gives it after the others; its duration."""
    model = problem.model(truth.parameters, dataclasses.replace(truth.vector, trial_friction=np.zeros(1)))
    last = problem.trials[-1].trial
    travel = last.travel_before_rad + float(np.abs(np.diff(last.base_angle_rad)).sum())
    place = Trial(
        np.empty(0), np.empty(0), last.start_s + float(last.time_s[-1]) + 30.0, len(problem.trials), travel
    )
    motions = planned_motions(
        model,
        command,
        place,
        NO_NOISE,
        np.random.default_rng(0),
        problem.base.torsional_rigidity_nm2,
        RATE_HZ,
    )
    time_s = np.arange(int(motions[-1].end_s * RATE_HZ)) / RATE_HZ
    trial = dataclasses.replace(place, time_s=time_s, base_angle_rad=base_path(motions, time_s))
    reading = model.predict(trial)
    given = DatasetTrial(
        trial=trial,
        base_measured_rad=trial.base_angle_rad,
        base_residual_rad=0.0,
        torque_nm=reading.torque_nm,
        hall_rad=reading.hall_rad,
        phase=phases(motions, time_s),
        command=command,
        file="planned",
    )
    return bin_trial(given), float(motions[-1].end_s)


def _proposal(
    problem: Problem, first: Fit, second: Fit, sensors: Sequence[str], command: TrialCommand
) -> Proposal:
    binned, duration_s = planned(problem, first, command)
    alone = problem.over([binned])
    objective = Objective(alone, second.parameters, second.vector.scaled_values)
    x = objective.packed(dataclasses.replace(second.vector, trial_friction=np.zeros(1)), np.zeros(0))
    residuals = objective.residuals(x)
    jacobians = None if residuals is None else objective.derivatives(x, residuals)
    if residuals is None or jacobians is None:
        raise SolverError(f"{problem.name}: {described(command)} cannot be solved")
    difference, whiten = residuals[0], alone.whiteners[0]
    columns = LinearisedFit.at(alone, second.parameters, x, residuals, jacobians, second.scatter**-2).columns
    unknown = prediction_covariance(second.covariance, second.scatter**2, columns)
    lower = lower_root(np.eye(difference.size) + unknown)
    whitened = solve_triangular(lower, difference, lower=True)
    left = np.asarray(solve_triangular(lower, whitened, lower=True, trans="T"), dtype=np.float64)
    separation = float(np.linalg.norm(whitened))
    return Proposal(
        command, separation, duration_s, _watch(binned, whiten.channel, left, whiten.use, sensors)
    )


def _watch(
    binned: BinnedTrial, channel: Places, left: Array, use: tuple[Places, ...], sensors: Sequence[str]
) -> str:
    """Where most of the separation lies."""
    names = ["the torque", *sensors]
    motion = binned.motion[np.concatenate(use)]
    moving = binned.moving[np.concatenate(use)]
    best, said = -1.0, names[0]
    for c, name in enumerate(names):
        for m, title in enumerate(binned.motions):
            for objective in (True, False):
                share = float((left[(channel == c) & (motion == m) & (moving == objective)] ** 2).sum())
                if share > best:
                    best = share
                    said = f"{name} {'during' if objective else 'settled after'} {title} (motion {m})"
    return said


def best_experiment(
    problem: Problem, first: Fit, second: Fit, name: str, rival: str, sensors: Sequence[str]
) -> NextTrial | None:
    """The best proposal as it stands in a diagnosis; None when nothing separates the two by 1σ."""
    ranked = proposals(problem, first, second, sensors)
    if not ranked or ranked[0].separation_sigma < 1.0:
        return None
    best = ranked[0]
    command = best.command
    return {
        "between": [name, rival],
        "kind": command.kind,
        "target_deg": command.target_deg,
        "steps_deg": list(command.steps_deg),
        "speed_deg_s": command.speed_deg_s,
        "settle_s": command.settle_s,
        "separation_sigma": round(best.separation_sigma, 2),
        "duration_s": round(best.duration_s, 1),
        "watch": best.watch,
        "sentence": best.sentence(name, rival),
    }


def expected_power(
    problem: Problem, first: Fit, second: Fit, command: TrialCommand, replicates: int
) -> float:
    """σ between the two after `replicates` trials of `command` on top of the data so far.

    Everything is simulated from `first` without noise, and the other model is fitted to all of it.
    """
    old = problem.with_means(problem.predict(first.parameters, first.vector)).trials
    binned, _ = planned(problem, first, command)
    places = [dataclasses.replace(binned.trial, index=binned.trial.index + k) for k in range(replicates)]
    joint = problem.over((*old, *(dataclasses.replace(binned, trial=place) for place in places)))
    trial_friction = np.r_[second.vector.trial_friction, np.zeros(replicates)]
    rival = fit(joint, second.effects, dataclasses.replace(second.vector, trial_friction=trial_friction))
    truth = fit(
        joint,
        first.effects,
        dataclasses.replace(
            first.vector, trial_friction=np.r_[first.vector.trial_friction, np.zeros(replicates)]
        ),
    )
    if rival is None or truth is None:
        return 0.0
    return float(np.sqrt(max(rival.objective - truth.objective, 0.0)))


def protocol_of(command: TrialCommand, first: str, second: str, replicates: int = REPLICATES) -> Protocol:
    """A protocol that repeats the command, so that its scatter is measured with it."""
    return Protocol(f"{first} or {second}", (command,) * replicates)
