"""Shapes of experiments as laboratories make them: what is recorded, at which rate, from which start."""

from __future__ import annotations

import dataclasses
import math
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from campaigns.run import Row
from campaigns.workbench.diagnosis_sets import (
    POOR,
    SETUPS,
    STANDARD,
    Limits,
    Made,
    Setup,
    hidden_at,
    limits_in,
    silent,
    simulated,
)
from campaigns.workbench.noise_kinds import noisy
from needle_rig.dataset import Dataset, DatasetTrial, TrialCommand, denoised_base, write_dataset
from needle_rig.dataset.description import read_description
from needle_rig.dataset.protocol import Protocol, compensation, staircase
from needle_rig.dataset.records import Start
from needle_rig.importing import Mapping as ImportMapping
from needle_rig.importing import dataset_of
from needle_rig.importing.mapping import BASE, TORQUE, ChannelPart, ClockPart, FilePart, TrialsPart
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.library import find_effects
from needle_rig.physics.rod import Layout
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.simulation.drive.base_drive import Motion, base_path
from needle_rig.units import rad
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.virtual.dataset import REST_S
from needle_rig.workbench.virtual.noise import Noise

Random = np.random.Generator
TIMES = 5.0
"""Its limit: the strength of what is hidden."""
RIG = load_parameters("rig_rigid").layout
NO_REPLICATES = Protocol(
    "no replicates",
    (
        compensation(45.0),
        compensation(-45.0),
        compensation(90.0),
        compensation(60.0, 10.0),
        compensation(30.0, 90.0, 8.0),
        staircase((15.0, 30.0, 45.0, 60.0, 45.0, 30.0, 15.0, 0.0, -15.0, -30.0, 0.0)),
    ),
)
ONE_COMMAND = Protocol("one command", (compensation(45.0),) * 3)
SHORT = Protocol(
    "short",
    (
        compensation(45.0),
        compensation(45.0),
        compensation(-45.0),
        staircase((30.0, 60.0, 20.0, -20.0, 10.0)),
        compensation(45.0),
        compensation(60.0, 90.0),
    ),
)
FAST_HZ, CAMERA_HZ = 2000.0, 10.0
RELAXING_DEG, RELAXING_SHRINK, RELAXED_DEG = 80.0, 0.85, 2.0
"""Turns to and fro after a trial of a long recording that relax the shaft: the first, each over the one
before it, and the last."""
RELAXING_DEG_S, RELAXING_SETTLE_S, REST_BETWEEN_S = 90.0, 0.2, 4.0
LATE_S = 0.2
"""Between the beginning of a recording whose shaft is wound and the motion that comes first in it."""


@dataclass(frozen=True)
class Shape:
    """How an experiment is made: what is simulated, what of it is read, how the recording begins."""

    protocol: Protocol = STANDARD
    rate_hz: float = 50.0
    layout: Callable[[Random], Layout] = field(default=lambda _: RIG)
    read: Callable[[DatasetTrial], DatasetTrial] = field(default=lambda trial: trial)
    """The trial with NaN where a channel has no sample."""
    long: bool = False
    """One recording of all trials, which the import cuts where the shaft rests relaxed."""
    begun: Callable[[Dataset, Random], Dataset] = field(default=lambda data, _: data)
    """What is done to the recording after the noise is in it."""


def _channels(torque: bool, first_hall: int, every: int = 1) -> Callable[[DatasetTrial], DatasetTrial]:
    """The torque or not, and the Hall sensors from `first_hall` on, each `every` samples."""

    def read(trial: DatasetTrial) -> DatasetTrial:
        hall = np.full_like(trial.hall_rad, np.nan)
        hall[::every, first_hall:] = trial.hall_rad[::every, first_hall:]
        moment = trial.torque_nm if torque else np.full_like(trial.torque_nm, np.nan)
        return dataclasses.replace(trial, torque_nm=moment, hall_rad=hall)

    return read


def _odd_places(random: Random) -> Layout:
    """Two sensors anywhere beyond the first tenth of the needle."""
    places = np.sort(random.uniform(0.1, 1.0, 2)) * RIG.needle_length_m
    return dataclasses.replace(RIG, sensor_positions_m=tuple(float(p) for p in np.round(places, 4)))


def _stepped(random: Random) -> Layout:
    """Two stretches of another diameter, 0.8 to 1.25 times the needle's: the fourth power in rigidity."""
    fine, thick = random.uniform(0.8, 0.95) ** 4, random.uniform(1.05, 1.25) ** 4
    length = RIG.needle_length_m
    return dataclasses.replace(
        RIG, segments=((0.0, 0.25 * length, thick), (0.55 * length, 0.75 * length, fine))
    )


def _wound(which: slice) -> Callable[[Dataset, Random], Dataset]:
    """The trials `which` recorded from their second or third motion on, all wound or all zeroed."""

    def begun(data: Dataset, random: Random) -> Dataset:
        start: Start = "zeroed" if random.random() < 0.5 else "wound"
        places = set(range(len(data.trials))[which])
        late = (
            begun_late(trial, int(random.integers(2, 4)), start) if place in places else trial
            for place, trial in enumerate(data.trials)
        )
        return dataclasses.replace(data, trials=tuple(late))

    return begun


def begun_late(trial: DatasetTrial, motion: int, start: Start) -> DatasetTrial:
    """The trial from shortly before its `motion`-th motion on; readings from there, if they are zeroed.

    Command and replicates stay: the rig was told the same.
    """
    names = list(dict.fromkeys(trial.phase.tolist()))
    begin_s = float(trial.trial.time_s[np.flatnonzero(trial.phase == names[motion])[0]]) - LATE_S
    first = int(np.searchsorted(trial.trial.time_s, begin_s))
    torque, hall = trial.torque_nm[first:].copy(), trial.hall_rad[first:].copy()
    if start == "zeroed":
        still = max(1, int(np.searchsorted(trial.trial.time_s, begin_s + 0.5 * LATE_S)) - first)
        torque, hall = torque - torque[:still].mean(), hall - hall[:still].mean(axis=0)
    other = (*trial.command.other, ("begins", names[motion]))
    return dataclasses.replace(
        trial,
        trial=dataclasses.replace(
            trial.trial,
            time_s=trial.trial.time_s[first:] - trial.trial.time_s[first],
            base_angle_rad=trial.trial.base_angle_rad[first:],
        ),
        base_measured_rad=trial.base_measured_rad[first:],
        torque_nm=torque,
        hall_rad=hall,
        phase=trial.phase[first:],
        command=dataclasses.replace(trial.command, other=other),
        start=start,
    )


SHAPES: Mapping[str, Shape] = {
    "standard series": Shape(),
    "long recording": Shape(SHORT, long=True),
    "torque alone": Shape(read=_channels(torque=True, first_hall=len(RIG.sensor_positions_m))),
    "tip alone": Shape(read=_channels(torque=False, first_hall=len(RIG.sensor_positions_m) - 1)),
    "camera at 10 Hz, torque at 2 kHz": Shape(
        SHORT, FAST_HZ, read=_channels(torque=True, first_hall=2, every=round(FAST_HZ / CAMERA_HZ))
    ),
    "two sensors anywhere": Shape(layout=_odd_places),
    "two trials wound": Shape(begun=_wound(slice(2, 7, 4))),
    "all trials wound": Shape(begun=_wound(slice(None))),
    "no replicates": Shape(NO_REPLICATES),
    "stepped shaft": Shape(layout=_stepped),
    "one command": Shape(ONE_COMMAND),
}


def recorded(shape: Shape, effects: tuple[Effect, ...], kind: str, noise: Noise, seed: int) -> Dataset:
    """The dataset of a shape with these effects hidden, in noise of this kind."""
    random = np.random.default_rng([seed, 17])
    setup = silent(Setup(noise, shape.layout(random), shape.protocol, shape.rate_hz))
    data = _whole(setup, effects, seed) if shape.long else simulated(setup, effects, seed)
    data = dataclasses.replace(data, trials=tuple(map(shape.read, data.trials)))
    data = noisy(data, kind, noise, seed)
    return shape.begun(_cut(data) if shape.long else data, random)


def made(task: Row, seed: int) -> Made | str:
    """The dataset of a task with `effects`, `noise`, `shape` and `block`, or why it cannot be asked."""
    library = dict(find_effects())
    shape, noise = SHAPES[task["shape"]], SETUPS[task["block"] % (POOR - 1)].noise
    hidden: tuple[Effect, ...] = ()
    truth: dict[str, dict[str, float]] = {}
    limits: dict[str, Limits] = {}
    for name in task["effects"]:
        turn = 1.0 if seed % 2 else -1.0
        baseline = fit_baseline(recorded(shape, (), task["noise"], noise, seed + 1), None, library)
        limit, _, counted = limits[name] = limits_in(baseline, name, turn)
        if not np.isfinite(limit):
            return "does not show"
        parameters = baseline.problem.parameters([name])
        if TIMES * counted > most_plausible(parameters):
            return "shows only beyond what is plausible"
        hidden, truth[name] = hidden_at(parameters, library, TIMES * counted, turn)
    return Made(recorded(shape, hidden, task["noise"], noise, seed), library, truth, limits)


def most_plausible(parameters: Sequence[FreeParameter]) -> float:
    """The largest strength, in typical sizes, at which every parameter is within its plausible range."""
    ranges = []
    for parameter in parameters:
        if not parameter.info.shapes:
            edges = [e for e in parameter.info.literature if e != parameter.info.off]
            ranges.append(max(abs(parameter.scaled_value(edge)) for edge in edges))
    return min(ranges)


def _whole(setup: Setup, effects: tuple[Effect, ...], seed: int) -> Dataset:
    """One recording of a series: after each trial the shaft is turned to and fro until it is nearly relaxed.

    Friction is that of one insertion.
    """
    series = simulated(setup, effects, seed)
    random = np.random.default_rng([seed, 18])
    error = setup.noise.rigidity_error * float(random.standard_normal())
    scatter = max(0.0, 1.0 + setup.noise.friction_scatter * float(random.standard_normal()))
    model = load_parameters("rig_rigid").with_effects(*effects, FrictionOfTrial(scatter))
    model = dataclasses.replace(
        model,
        layout=series.layout,
        torsional_rigidity_nm2=model.torsional_rigidity_nm2 * math.exp(error),
    )
    needle: SettledNeedle | None = None
    begin_s, travel_rad = 0.0, 0.0
    pieces: list[tuple[Array, Array, Array, Array]] = []
    for index, trial in enumerate(series.trials):
        path = _relaxed_after(trial.trial, setup.rate_hz)
        place = dataclasses.replace(path, start_s=begin_s, index=index, travel_before_rad=travel_rad)
        needle = (needle or SettledNeedle.relaxed(model, place=place)).moved(place)
        assert needle.solution is not None
        seen = model.observed(place, needle.solution)
        pieces.append((begin_s + path.time_s, path.base_angle_rad, seen.torque_nm, seen.hall_rad))
        begin_s += len(path.time_s) / setup.rate_hz
        travel_rad += float(np.abs(np.diff(path.base_angle_rad)).sum())
    time_s, base, torque, hall = (np.concatenate(part) for part in zip(*pieces, strict=True))
    measured = base + rad(setup.noise.encoder_deg) * random.standard_normal(len(base))
    denoised = denoised_base(time_s, measured)
    whole = DatasetTrial(
        trial=Trial(time_s, denoised.angle_rad),
        base_measured_rad=measured,
        base_residual_rad=denoised.residual_rad,
        torque_nm=torque,
        hall_rad=hall,
        phase=np.full(len(time_s), "whole"),
        command=TrialCommand("unknown"),
        file="trials/01.csv",
    )
    return dataclasses.replace(series, trials=(whole,))


def _relaxed_after(trial: Trial, rate_hz: float) -> Trial:
    """The trial's path, then turns about 0 that shrink, and a rest there."""
    at_rad, start_s, motions = float(trial.base_angle_rad[-1]), 0.0, []
    turn_deg = -math.copysign(RELAXING_DEG, at_rad)
    while True:
        goal_rad = rad(turn_deg) if abs(turn_deg) > RELAXED_DEG else 0.0
        motions.append(Motion("relax", start_s, at_rad, goal_rad, rad(RELAXING_DEG_S), RELAXING_SETTLE_S))
        at_rad, start_s = goal_rad, motions[-1].end_s
        if goal_rad == 0.0:
            break
        turn_deg *= -RELAXING_SHRINK
    after_s = np.arange(math.ceil((start_s + REST_BETWEEN_S) * rate_hz)) / rate_hz
    return Trial(
        np.r_[trial.time_s, trial.time_s[-1] + 1.0 / rate_hz + after_s],
        np.r_[trial.base_angle_rad, base_path(tuple(motions), after_s)],
    )


def _cut(data: Dataset) -> Dataset:
    """The recording imported from its file, cut at rests."""
    with tempfile.TemporaryDirectory() as name:
        folder = write_dataset(data, Path(name) / "data")
        rig = read_description(folder)[0].rig
        mapping = ImportMapping(
            name=data.name,
            clocks={"c": ClockPart(files=(FilePart(path=data.trials[0].file),), source="time_s", unit="s")},
            channels=(
                ChannelPart(role=BASE, clock="c", source="base_angle_deg", unit="deg"),
                ChannelPart(role=TORQUE, clock="c", source="base_torque_nmm", unit="N·mm"),
                *(ChannelPart(role=s, clock="c", source=f"{s}_deg", unit="deg") for s in data.sensor_names),
            ),
            trials=TrialsPart(at="rests"),
            rig=rig,
        )
        return dataset_of(mapping, folder)


assert REST_S > LATE_S
