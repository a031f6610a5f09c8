"""A row on either side of every threshold of the noise. Numbers are typed here on purpose."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from needle_rig.dataset.protocol import Protocol, staircase
from needle_rig.model import load_parameters
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.estimation.baseline import null_model
from needle_rig.workbench.estimation.run_in import (
    TURNS,
    Wound,
    _RunIn,
    _Shaft,
    _shaft_of,
    after_run_in,
    wound,
)
from needle_rig.workbench.observations.binning import (
    BinnedTrial,
    bin_trial,
    direction_of,
    motions_of,
)
from needle_rig.workbench.observations.measured_noise import _split, floors, measure_noise
from needle_rig.workbench.observations.noise import replicate_groups, variance
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.noise_terms.jitter import Jitter
from needle_rig.workbench.observations.noise_terms.motion_scatter import MotionScatter
from needle_rig.workbench.observations.noise_terms.offset import Offset, measured_offset
from needle_rig.workbench.observations.noise_terms.white import White
from needle_rig.workbench.observations.outliers import set_aside
from needle_rig.workbench.observations.shown_terms import with_motion_scatter
from needle_rig.workbench.virtual.dataset import simulate_dataset
from tests.workbench.hidden import dataset


@pytest.fixture(scope="module")
def binned() -> tuple[BinnedTrial, ...]:
    return tuple(bin_trial(t) for t in dataset().trials)


@pytest.mark.parametrize(("drift_deg", "stop"), [(0.08, 1), (0.17, 50)])
def test_a_base_within_an_eighth_of_a_degree_holds_still(drift_deg: float, stop: int) -> None:
    base_rad = rad(np.r_[5.0, np.full(49, drift_deg), np.zeros(150)])
    ((_, found, _),) = motions_of(base_rad, np.full(200, "hold"))
    assert found == stop


@pytest.mark.parametrize(
    ("move_rad", "direction"), [(0.007, 0.0), (-0.007, 0.0), (0.014, 1.0), (-0.014, -1.0)]
)
def test_a_motion_of_half_a_degree_has_no_direction(move_rad: float, direction: float) -> None:
    assert direction_of(np.array([move_rad])) == [direction]


@pytest.mark.parametrize(("held", "from_replicates"), [(0.085, True), (0.115, False)])
def test_a_base_that_holds_for_a_tenth_of_the_time_shows_noise_itself(
    held: float, from_replicates: bool
) -> None:
    # it turns to and fro with noise of 0.4°, then holds, with 0.1°; 0.4 of a hold is not settled yet
    time_s = np.arange(4000) / 50.0
    holds = np.arange(4000) >= 4000 * (1.0 - held / 0.6)
    base_rad = np.where(holds, 0.0, rad(30.0) * np.sin(2 * np.pi * time_s / 8.0))
    random, first = np.random.default_rng(2), dataset().trials[0]
    trials = []
    for _ in range(4):
        noise_rad = rad(np.where(holds, 0.1, 0.4))[:, None] * random.standard_normal((4000, 4))
        driven = dataclasses.replace(first.trial, time_s=time_s, base_angle_rad=base_rad)
        trials.append(
            dataclasses.replace(
                first,
                trial=driven,
                base_measured_rad=base_rad,
                phase=np.full(4000, "sweep"),
                torque_nm=noise_rad[:, 0],
                hall_rad=base_rad[:, None] + noise_rad,
            )
        )
    found = measure_noise(trials, [bin_trial(t) for t in trials])
    assert deg(found.white[1:]) == pytest.approx(0.4 if from_replicates else 0.1, rel=0.2)


@pytest.mark.parametrize(("sigmas", "outlier"), [(7.0, False), (11.0, True)])
def test_an_outlier_lies_far_from_its_neighbours(sigmas: float, outlier: bool) -> None:
    values = np.random.default_rng(1).standard_normal(400)
    values[200] = sigmas
    assert bool(set_aside(values)[2][200]) is outlier


def test_floors_are_what_the_solver_promises() -> None:
    # what twists 220 mm of the shipped needle by as much
    assert nmm(floors(3)[0]) == pytest.approx(62.56 * math.radians(0.03) / 220.0)
    assert deg(floors(3)[1]) == pytest.approx(0.03)


def test_what_is_assumed_before_any_replicate(binned: tuple[BinnedTrial, ...]) -> None:
    noise = measure_noise(dataset().trials, binned)
    assert (noise.term(Jitter).sd_s, noise.scatter, noise.scatter_dof) == (1e-3, 0.025, 4.0)


def _slow_noise(size: float) -> list[np.ndarray]:
    random = np.random.default_rng(5)
    pieces = []
    for _ in range(6):
        slow = np.zeros(160)
        for i in range(1, 160):
            slow[i] = 0.9 * slow[i - 1] + np.sqrt(0.19) * random.standard_normal()
        pieces.append(random.standard_normal(160) + size * slow)
    return pieces


@pytest.mark.parametrize(("size", "seen"), [(0.22, False), (0.33, True)])
def test_noise_is_correlated_only_at_high_odds(size: float, seen: bool) -> None:
    assert (_split(_slow_noise(size), 0.01)[1] > 0.0) is seen


def test_with_few_rests_the_offset_is_the_floor(binned: tuple[BinnedTrial, ...]) -> None:
    found = measured_offset(binned[:2], [White(np.ones(5))], np.full(5, 1.4))
    assert found.sd == pytest.approx(1.4)
    noise = measure_noise(dataset().trials[:2], binned[:2])
    assert noise.term(Offset).sd == pytest.approx(0.7 * floors(5))


@pytest.mark.parametrize(("times", "seen"), [(1.4, False), (2.8, True)])
def test_offsets_must_stand_out_of_the_scatter_of_the_rests(
    binned: tuple[BinnedTrial, ...], times: float, seen: bool
) -> None:
    rests = [b for b in binned if b.motion[0] == 0]
    each = []
    shifts = np.array([1.0, -1.0, -1.0, 1.0, 0.0])
    for k, b in enumerate(rests):
        rest = (b.motion == 0) & ~b.moving
        count = b.count[:, rest].sum(1)[:, None]
        variance = 1.0 / count
        excess = variance * (1.0 + times * np.sqrt(2.0 / 3.0))
        scale = np.sqrt(excess * 3.0 / (shifts**2).sum())
        each.append(dataclasses.replace(b, mean=np.broadcast_to(scale * shifts[k], b.mean.shape)))
    floor = np.full(5, 1e-9)
    found = measured_offset(each, [White(np.ones(5))], floor)
    assert bool(np.all(found.sd > 1e-6)) is seen


def test_the_floor_of_motions_is_worth_ten_differences(binned: tuple[BinnedTrial, ...]) -> None:
    noise = measure_noise(dataset().trials, binned)
    for silent in (
        White(np.full(5, 1e-12)),
        Offset(np.zeros(5)),
        Drift(np.zeros(5), np.ones(5)),
        Jitter(0.0),
    ):
        noise = noise.having(silent)
    groups = replicate_groups([b.command for b in binned])
    residuals = [np.full(b.mean.shape, float(k)) for k, b in enumerate(binned)]
    found = with_motion_scatter(noise, binned, residuals, groups)
    group = next(g for g in groups if len(g) > 1)
    motions = min(len(binned[i].motions) for i in group) - 1
    total = motions * (len(group) - 1) * np.var(group, ddof=1)
    dof = motions * (len(group) - 1)
    assert found.term(MotionScatter).sd[0] ** 2 == pytest.approx(total / (10.0 + dof), rel=1e-3)


@pytest.mark.parametrize(
    ("steps_deg", "runs_in"), [((60.0, -60.0, 60.0, -60.0), True), ((60.0, -60.0, 60.0), False)]
)
def test_a_run_in_leaves_half_of_the_readings(steps_deg: tuple[float, ...], runs_in: bool) -> None:
    protocol = Protocol("late", (staircase(steps_deg, 45.0, 1.0),))
    data = simulate_dataset(load_parameters("rig_rigid"), protocol, 5)
    trial = dataclasses.replace(data.trials[0], start="wound")
    found = after_run_in(dataclasses.replace(data, trials=(trial,)), null_model(data), friction_known=False)
    assert ("after a run-in" in found.notes[-1]) is runs_in
    assert ("too few for a run-in (limit 50%)" in found.notes[-1]) is not runs_in


def test_readings_within_half_a_sigma_of_both_extreme_starts_are_free_of_the_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    protocol = Protocol("late", (staircase((60.0, -60.0, 60.0), 45.0, 1.0),))
    data = simulate_dataset(load_parameters("rig_rigid"), protocol, 5)
    trial = dataclasses.replace(data.trials[0], start="wound")

    def free(sigmas: float) -> bool:
        ends = np.linspace(-sigmas, sigmas, len(TURNS))
        seen = np.array([turn * one_sigma for turn in (0.0, *ends)])
        monkeypatch.setattr(_Shaft, "_recorded", lambda *_: seen)
        judged, found = shaft.judged(Wound.of(trial))
        return not judged.start_found and isinstance(found, _RunIn) and found.share == 1.0

    noise = measure_noise(data.trials, [bin_trial(t) for t in data.trials])
    recorded = [Wound.of(t) for t in data.trials]
    shaft = _shaft_of(recorded, data, noise, null_model(data), friction_known=False)
    binned = bin_trial(wound(trial, shaft._finer(Wound.of(trial)), shaft.lag_rad))
    one_sigma = np.sqrt([variance(noise, binned, c) for c in range(len(binned.mean))])
    one_sigma = one_sigma[:, binned.time_s >= 0.0]
    assert free(0.45)
    assert not free(0.55)
