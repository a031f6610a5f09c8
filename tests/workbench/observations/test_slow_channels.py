"""A camera at 10 Hz beside a torque cell at 1 kHz: each channel counts at the samples that it has."""

import dataclasses
from collections.abc import Callable

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import bin_trial, driven_by_samples
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import Noise
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.outliers import set_aside
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import NO_NOISE

FAST_HZ, EVERY = 1000.0, 100
MODEL = load_parameters("rig_rigid")


@pytest.fixture(scope="module")
def silent() -> Dataset:
    protocol = Protocol("two", (compensation(45.0), compensation(-60.0)))
    data = simulate_dataset(MODEL, protocol, 1, NO_NOISE, rate_hz=FAST_HZ)
    trials = []
    for given in data.trials:
        hall = np.full_like(given.hall_rad, np.nan)
        hall[::EVERY, 2:] = given.hall_rad[::EVERY, 2:]
        trials.append(dataclasses.replace(given, hall_rad=hall))
    return dataclasses.replace(data, trials=tuple(trials))


def noisy(data: Dataset, torque: Callable[[int], Array]) -> Dataset:
    random = np.random.default_rng(4)
    trials = []
    for given in data.trials:
        hall = given.hall_rad + rad(0.25) * random.standard_normal(given.hall_rad.shape)
        moment = given.torque_nm + torque(given.torque_nm.size)
        trials.append(dataclasses.replace(given, torque_nm=moment, hall_rad=hall))
    return dataclasses.replace(data, trials=tuple(trials))


def measured(data: Dataset) -> Noise:
    return measure_noise(data.trials, [bin_trial(t) for t in data.trials])


@pytest.mark.parametrize("by_samples", [False, True])
def test_model_and_data_are_averaged_at_the_samples_of_a_slow_channel(
    silent: Dataset, by_samples: bool
) -> None:
    for given in silent.trials:
        binned = bin_trial(given)
        known = np.isfinite(binned.mean)
        assert known[0].all()
        assert not known[1:3].any()
        assert known[3:].sum() > 100
        assert binned.count[3].sum() == np.isfinite(given.hall_rad[:, 2]).sum()
        driven = driven_by_samples(binned, given) if by_samples else binned
        (reading,) = Simulator().readings([MODEL], [driven])
        off = np.abs(driven.mean - reading)[3:]
        # while the base turns at 45 deg/s, a bin's middle and its one sample are up to 1.6 deg apart
        assert np.nanmax(off) < rad(0.05)


def test_noise_of_a_slow_channel_is_that_of_its_samples(silent: Dataset) -> None:
    random = np.random.default_rng(5)
    noise = measured(noisy(silent, lambda n: nm(0.004) * random.standard_normal(n)))
    assert noise.white[3:] == pytest.approx(rad(0.25), rel=0.15)
    assert noise.white[0] == pytest.approx(nm(0.004), rel=0.1)
    assert not noise.term(Drift).sd.any()


def test_noise_of_tenths_of_a_second_is_seen_at_a_thousand_samples_a_second(silent: Dataset) -> None:
    random = np.random.default_rng(6)
    keep = np.exp(-1.0 / FAST_HZ / 0.2)

    def wanders(count: int) -> Array:
        slow = np.zeros(count)
        for i in range(1, count):
            slow[i] = keep * slow[i - 1] + np.sqrt(1.0 - keep**2) * random.standard_normal()
        return np.asarray(nm(0.004) * random.standard_normal(count) + nm(0.002) * slow)

    noise = measured(noisy(silent, wanders))
    assert noise.white[0] == pytest.approx(nm(0.004), rel=0.1)
    assert noise.term(Drift).sd[0] == pytest.approx(nm(0.002), rel=0.4)
    assert noise.term(Drift).form[0] == pytest.approx(0.2, abs=0.21)


def test_noise_that_is_averaged_over_milliseconds_counts_as_what_is_left_of_it_in_a_bin(
    silent: Dataset,
) -> None:
    random = np.random.default_rng(7)

    def averaged(count: int) -> Array:
        rough = random.standard_normal(count + 4)
        return np.asarray(nm(0.004) * np.convolve(rough, np.full(5, 5**-0.5), "valid"))

    assert measured(noisy(silent, averaged)).white[0] == pytest.approx(nm(0.004) * 5**0.5, rel=0.15)


def test_an_outlier_of_a_slow_channel_is_told_by_its_own_neighbours() -> None:
    random = np.random.default_rng(8)
    values = np.full(3000, np.nan)
    values[::100] = 0.25 * random.standard_normal(30)
    values[1500] = 20.0
    filled, valid, outlier = set_aside(values)
    assert np.flatnonzero(outlier).tolist() == [1500]
    assert valid.sum() == 29
    assert np.abs(filled).max() < 1.0
