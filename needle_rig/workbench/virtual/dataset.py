"""Simulated measurements with a known effect: datasets for practice and tests."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable

import numpy as np

from needle_rig.control.strategy import Task, Waypoint, make_strategy
from needle_rig.dataset import Dataset, DatasetTrial, Needle, TrialCommand, denoised_base
from needle_rig.dataset.protocol import Protocol
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.simulation.drive.base_drive import Motion, base_path, phases
from needle_rig.units import nm, rad
from needle_rig.workbench.virtual.noise import Noise
from needle_rig.workbench.virtual.settled_run import WINDOW_S, Turn, carried_out

REST_S = 0.5
"""Rest before the first motion."""
SLOWEST_HZ, FASTEST_HZ = 5.0, 10_000.0
"""Samples a second: fewer do not resolve motions, more hold nothing that a needle does."""
SAMPLES_LIMIT = 1_000_000
"""Of one trial: five hours at 50 a second, which take 1 GB and some seconds."""
DIAMETER_M = 0.39e-3
DENSITY_KG_M3 = 6450.0


def simulate_dataset(
    model: NeedleModel,
    protocol: Protocol,
    seed: int = 1,
    noise: Noise | None = None,
    *,
    name: str | None = None,
    rate_hz: float = 50.0,
    progress: Callable[[Iterable[TrialCommand], int], Iterable[TrialCommand]] = lambda trials, _: trials,
) -> Dataset:
    """A series of trials as a rig with the needle `model` would give them.

    Waypoints of compensations come from the torque that the simulated sensor shows after the first motion, as
    in a run (Reed 2008, (9)). The same seed gives the same numbers, whatever comes later in the series.
    `progress` hands on the trials, and counts them.
    Raises BadInput for rates that cannot resolve the motions.
    """
    noise = noise or Noise()
    if not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        raise BadInput(f"rate_hz is {rate_hz:g}; give {SLOWEST_HZ:g} to {FASTEST_HZ:g} samples a second")
    stated = _needle(model)
    error = noise.rigidity_error * float(np.random.default_rng([seed, 0]).standard_normal())
    true = dataclasses.replace(model, torsional_rigidity_nm2=model.torsional_rigidity_nm2 * math.exp(error))
    trials: list[DatasetTrial] = []
    start_s, travel_rad = 0.0, 0.0
    for index, command in enumerate(progress(protocol.trials, len(protocol.trials))):
        random = np.random.default_rng([seed, index + 1])
        scatter = max(0.0, 1.0 + noise.friction_scatter * float(random.standard_normal()))
        needle = true.with_effects(FrictionOfTrial(scatter))
        place = Trial(np.empty(0), np.empty(0), start_s, index, travel_rad)
        motions = planned_motions(
            needle, command, place, noise, random, stated.torsional_rigidity_nm2, rate_hz
        )
        trial = _measured(needle, motions, place, command, noise, random, rate_hz)
        trials.append(trial)
        travel_rad += float(np.abs(np.diff(trial.trial.base_angle_rad)).sum())
        start_s = round(start_s + motions[-1].end_s + protocol.pause_s, 1)
    names = tuple(f"hall_{k}" for k in range(1, len(model.layout.sensor_positions_m) + 1))
    return Dataset(name or model.name, model.layout, names, stated, tuple(trials))


def planned_motions(
    model: NeedleModel,
    command: TrialCommand,
    place: Trial,
    noise: Noise,
    random: np.random.Generator,
    stated_rigidity_nm2: float,
    rate_hz: float = 50.0,
) -> tuple[Motion, ...]:
    """The motions of one trial; a compensation asks reed2008 after each, as the brain does.

    Raises BadInput, SolverError.
    """
    speed = rad(command.speed_deg_s or 45.0)
    settle = command.settle_s if command.settle_s is not None else 3.0
    drive = LaggedDrive(place, rate_hz)
    if command.kind == "staircase" or command.steps_deg:
        for k, step_deg in enumerate(command.steps_deg, start=1):
            drive.add(Waypoint(rad(step_deg), f"step_{k}"), speed, settle)
        return drive.motions
    if command.target_deg is None:
        raise BadInput(f"a trial of kind {command.kind} has neither target_deg nor steps_deg; give one")
    task = Task(rad(command.target_deg), model.layout, stated_rigidity_nm2, speed, settle)
    needle = SettledNeedle.relaxed(model, place=place)
    carried_out(make_strategy("reed2008", {}), task, drive, needle, random, noise)
    return drive.motions


class LaggedDrive:
    """A drive with the lags of `simulation.base_drive`, sampled evenly; `place` is the trial's in its series.

    The sensors are read at the end of settling.
    """

    def __init__(self, place: Trial, rate_hz: float) -> None:
        self.motions: tuple[Motion, ...] = ()
        self._place, self._rate_hz = place, rate_hz
        self._last = 0

    def add(self, waypoint: Waypoint, speed_rad_s: float, settle_s: float) -> None:
        """Let one more motion follow."""
        start_s, from_rad = REST_S, 0.0
        if self.motions:
            start_s, from_rad = self.motions[-1].end_s, self.motions[-1].to_rad
        motion = Motion(waypoint.name, start_s, from_rad, waypoint.angle_rad, speed_rad_s, settle_s)
        self.motions = (*self.motions, motion)

    def rest(self) -> Turn:
        """Half a second in which the base stands at 0."""
        return self._read(0.0, REST_S)

    def turn(self, waypoint: Waypoint, speed_rad_s: float, settle_s: float) -> Turn:
        """Turn and settle. Raises BadInput when the trial gets too long."""
        self.add(waypoint, speed_rad_s, settle_s)
        return self._read(self.motions[-1].start_s, self.motions[-1].end_s)

    def _read(self, moved_s: float, end_s: float) -> Turn:
        whole = driven(self.motions, end_s, self._place, self._rate_hz)
        since, self._last = self._last, len(whole.time_s) - 1
        path = dataclasses.replace(
            whole, time_s=whole.time_s[since:], base_angle_rad=whole.base_angle_rad[since:]
        )
        first = int(np.searchsorted(path.time_s, end_s - WINDOW_S, side="right"))
        return Turn(path, slice(first, None), float(len(path.time_s) - first), moved_s, end_s)


def driven(motions: tuple[Motion, ...], end_s: float, place: Trial, rate_hz: float) -> Trial:
    """The trial at `place` in its series that these motions make, up to `end_s`; BadInput when it is long."""
    if end_s * rate_hz > SAMPLES_LIMIT:
        raise BadInput(
            f"trial {place.index + 1} lasts {end_s:g} s, more than {SAMPLES_LIMIT} samples at {rate_hz:g} a"
            " second; let it turn faster or settle for less time"
        )
    time_s = np.arange(max(2, math.ceil(end_s * rate_hz - 1e-9))) / rate_hz
    return dataclasses.replace(place, time_s=time_s, base_angle_rad=base_path(motions, time_s))


def _measured(
    model: NeedleModel,
    motions: tuple[Motion, ...],
    place: Trial,
    command: TrialCommand,
    noise: Noise,
    random: np.random.Generator,
    rate_hz: float,
) -> DatasetTrial:
    trial = driven(motions, motions[-1].end_s, place, rate_hz)
    reading = model.predict(trial)
    count = len(trial.time_s)
    base = trial.base_angle_rad + rad(noise.encoder_deg) * random.standard_normal(count)
    path = denoised_base(trial.time_s, base)
    return DatasetTrial(
        trial=dataclasses.replace(trial, base_angle_rad=path.angle_rad),
        base_measured_rad=base,
        base_residual_rad=path.residual_rad,
        torque_nm=reading.torque_nm + nm(noise.torque_nmm) * random.standard_normal(count),
        hall_rad=reading.hall_rad + rad(noise.hall_deg) * random.standard_normal(reading.hall_rad.shape),
        phase=phases(motions, trial.time_s),
        command=command,
        file=f"trials/{place.index + 1:02d}.csv",
    )


def _needle(model: NeedleModel) -> Needle:
    """Constants that give the model's rigidity for the paper's wire of 0.39 mm."""
    polar_m4 = math.pi * DIAMETER_M**4 / 32.0
    return Needle(DIAMETER_M, model.torsional_rigidity_nm2 / polar_m4, DENSITY_KG_M3)
