import dataclasses

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.units import nm, rad
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial, motions_of
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import Noise, covariance, replicate_groups, variance, whitener
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.noise_terms.offset import Offset
from needle_rig.workbench.observations.noise_terms.term import Bins
from needle_rig.workbench.observations.outliers import set_aside
from tests.workbench.foreign_friction import Measured
from tests.workbench.foreign_friction import dataset as swept
from tests.workbench.hidden import dataset


def measured(data: Dataset) -> tuple[Noise, tuple[BinnedTrial, ...]]:
    binned = tuple(bin_trial(t) for t in data.trials)
    return measure_noise(data.trials, binned), binned


def test_white_noise_is_what_was_put_in() -> None:
    noise, _ = measured(dataset())
    assert noise.white[0] == pytest.approx(nm(0.0008), rel=0.06)
    assert noise.white[1:] == pytest.approx(rad(0.25), rel=0.06)
    assert not noise.term(Drift).sd.any()
    assert noise.replicates == 2


@pytest.mark.parametrize("replicates", [1, 3])
@pytest.mark.parametrize("motion", ["chirp", "slow ramps", "to and fro"])
def test_without_holds_white_noise_is_what_was_put_in(motion: str, replicates: int) -> None:
    """Friction that scatters by 2 % is no noise of the sensors, nor is ten times the solver's accuracy."""
    put_in = Measured(hall_deg=0.1, torque_nmm=0.0005, replicates=replicates)
    noise, _ = measured(swept(_ours, motion, 4, measured=put_in))
    assert noise.white[0] == pytest.approx(nm(0.0005), rel=0.12)
    assert noise.white[1:] == pytest.approx(rad(0.1), rel=0.12)


def _ours(time_s: Array, held_rad: Array, factor: float, _: float) -> tuple[Array, Array]:
    needle = load_parameters("rig_rigid").with_effects(FrictionOfTrial(factor))
    read = needle.predict(Trial(time_s, held_rad))
    return read.torque_nm, read.hall_rad


def test_correlated_noise_is_seen_as_correlated() -> None:
    data = dataset()
    random = np.random.default_rng(3)
    trials = []
    for given in data.trials:
        step = np.median(np.diff(given.trial.time_s))
        keep = np.exp(-step / 0.2)
        slow: Array = np.zeros(given.hall_rad.shape)
        for i in range(1, len(slow)):
            slow[i] = keep * slow[i - 1] + np.sqrt(1 - keep**2) * rad(0.4) * random.standard_normal(
                slow.shape[1]
            )
        trials.append(dataclasses.replace(given, hall_rad=given.hall_rad + slow))
    noise, _ = measured(dataclasses.replace(data, trials=tuple(trials)))
    drift = noise.term(Drift)
    assert drift.sd[1:] == pytest.approx(rad(0.4), rel=0.3)
    assert drift.form[1:] == pytest.approx(0.2, abs=0.21)
    assert drift.sd[0] == 0.0


def test_offsets_from_trial_to_trial_are_seen_at_rest() -> None:
    data = dataset()
    shifts = rad(np.array([1.0, -1.0, 0.5, 1.5, -2.0]))
    trials = tuple(
        dataclasses.replace(t, hall_rad=t.hall_rad + shift)
        for t, shift in zip(data.trials, shifts, strict=True)
    )
    noise, _ = measured(dataclasses.replace(data, trials=trials))
    offset_rad = noise.term(Offset).sd[1:]
    assert np.all(offset_rad > rad(0.5))
    assert np.all(offset_rad < rad(3.0))


def test_outliers_and_holes_do_not_move_bin_means() -> None:
    data = dataset()
    clean = bin_trial(data.trials[0])
    hall = data.trials[0].hall_rad.copy()
    hall[::37, 0] += rad(40.0)
    hall[10:14, 1] = np.nan
    spoiled = bin_trial(dataclasses.replace(data.trials[0], hall_rad=hall))
    assert spoiled.outliers[1] >= 20
    assert spoiled.missing[2] == 4
    assert np.nanmax(np.abs(spoiled.mean[1] - clean.mean[1])) < rad(0.25)


def test_a_slow_ramp_has_no_outliers() -> None:
    random = np.random.default_rng(0)
    values = np.linspace(0, 90, 2000) + 0.25 * random.standard_normal(2000)
    _, _, outlier = set_aside(values)
    assert outlier.sum() <= 2


def test_whitened_noise_is_white() -> None:
    noise, binned = measured(dataset())
    use = Bins.of(binned[0], 2).use
    lower = np.linalg.cholesky(covariance(noise, Bins.of(binned[0], 2)))
    random = np.random.default_rng(1)
    draws = np.zeros((binned[0].mean.shape[0], binned[0].mean.shape[1], 400))
    draws[2][use] = lower @ random.standard_normal((use.size, 400))
    whiten = whitener(noise, binned[0])
    white = whiten(draws)[whiten.channel == 2]
    assert np.allclose(np.cov(white), np.eye(use.size), atol=0.35)
    assert np.mean(white**2) == pytest.approx(1.0, abs=0.02)


def test_a_long_trial_is_whitened_in_blocks_as_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Noise that drifts over half a block; the rest of the terms as measured."""
    noise, (binned, *_) = measured(dataset())
    channels = len(binned.mean)
    noise = noise.having(Drift(np.full(channels, 3e-3), np.full(channels, 0.6)))
    whole = whitener(noise, binned)
    monkeypatch.setattr("needle_rig.workbench.observations.noise.BLOCK", 24)
    blocks = whitener(noise, binned)
    assert len(blocks.channels[2].blocks) > 3
    means = binned.mean
    assert whole.raw(whole(means)) == pytest.approx(means, rel=1e-9, nan_ok=True)
    assert blocks.raw(blocks(means)) == pytest.approx(means, rel=1e-9, nan_ok=True)
    assert blocks.log_det == pytest.approx(whole.log_det, abs=0.02 * len(blocks.channel))
    for c, (one, many) in enumerate(zip(whole.channels, blocks.channels, strict=True)):
        matrix = covariance(noise, Bins.of(binned, c))
        assert one.of_averages(np.eye(one.use.size)) == pytest.approx(np.linalg.cholesky(matrix), abs=1e-12)
        assert variance(noise, binned, c)[many.use] == pytest.approx(np.diag(matrix), rel=1e-12)
        white = many(np.asarray(np.linalg.cholesky(matrix), dtype=np.float64))
        assert np.mean(white**2) * one.use.size == pytest.approx(1.0, abs=1e-9)  # a unit of variance each
        assert np.abs(white @ white.T - np.eye(one.use.size)).max() < 0.2
        average = np.full((1, many.use.size), 1.0 / many.use.size)
        told = float((many.of_averages(average) ** 2).sum())
        assert told == pytest.approx((average @ matrix @ average.T).item(), rel=0.1)


def test_replicates_are_trials_of_one_command() -> None:
    data = dataset()
    assert replicate_groups([t.command for t in data.trials]) == [[0, 1, 4], [2], [3]]


def test_strokes_without_a_hold_between_them_are_motions_of_their_own() -> None:
    corners_deg = np.array([0.0, 60.0, -50.0, 40.0, 39.5, 40.0, -30.0, 0.0])
    path = rad(np.interp(np.arange(701) / 100.0, np.arange(8.0), corners_deg))
    path = np.r_[path, np.full(100, path[-1])]
    parts = motions_of(path, np.full(path.size, "whole"))
    assert [first for first, _, _ in parts] == pytest.approx([0, 100, 200, 300, 600], abs=2)
    assert [end - stop for _, stop, end in parts[:-1]] == [0, 0, 0, 0]
    assert parts[-1][1] == pytest.approx(700, abs=2)
    held = motions_of(rad(np.linspace(0.0, 45.0, 200)), np.full(200, "rotate"))
    assert len(held) == 1


def test_a_motion_to_and_fro_is_driven_through_its_turning_points() -> None:
    given = dataset().trials[0]
    time_s = np.arange(1000) / 50.0
    sine = rad(40.0) * np.sin(2 * np.pi * time_s / 2.0)
    zero = np.zeros(1000)
    trial = dataclasses.replace(
        given,
        trial=dataclasses.replace(given.trial, time_s=time_s, base_angle_rad=sine),
        torque_nm=zero,
        hall_rad=np.zeros((1000, 4)),
        phase=np.full(1000, "sweep"),
    )
    driven = bin_trial(trial).trial
    away = np.abs(np.interp(time_s, driven.time_s, driven.base_angle_rad) - sine)
    assert away.max() < rad(0.3)
