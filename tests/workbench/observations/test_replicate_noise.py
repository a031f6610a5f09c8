import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import brentq

from needle_rig.numerics import Array
from needle_rig.units import rad
from needle_rig.workbench.observations import replicate_noise
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial
from needle_rig.workbench.observations.contrasts import contrasts, places_alike
from needle_rig.workbench.observations.noise import Noise, covariance, measure_noise
from needle_rig.workbench.observations.replicate_noise import replicates_favour, with_correlation
from tests.workbench.hidden import dataset

ALL = slice(1, None)
"""Hall sensors."""
GROUP = [0, 1, 4]
"""Trials of one command in the dataset."""


@pytest.fixture(scope="module")
def binned() -> tuple[BinnedTrial, ...]:
    return tuple(bin_trial(t) for t in dataset().trials)


@pytest.fixture(scope="module")
def white(binned: tuple[BinnedTrial, ...]) -> Noise:
    return measure_noise(dataset().trials, binned)


def drawn(noise: Noise, binned: tuple[BinnedTrial, ...], seed: int) -> list[Array]:
    """Bin means of noise alone."""
    random = np.random.default_rng(seed)
    found = []
    for b in binned:
        values = np.full(b.mean.shape, np.nan)
        for c in range(len(values)):
            use, matrix = covariance(noise, b, c)
            values[c, use] = np.linalg.cholesky(matrix) @ random.standard_normal(use.size)
        found.append(values)
    return found


def channel_of(
    noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array], c: int
) -> replicate_noise._Channel:
    """What the replicates say of one channel."""
    return replicate_noise._channel(noise, binned, contrasts(noise, binned, residuals, [GROUP], c), c)


def wandering(noise: Noise, size_deg: float, tau_s: float, sensors: slice) -> Noise:
    """`noise` with a wandering part in these channels."""
    correlated, correlation_s = noise.correlated.copy(), noise.correlation_s.copy()
    correlated[sensors], correlation_s[sensors] = rad(size_deg), tau_s
    return dataclasses.replace(noise, correlated=correlated, correlation_s=correlation_s)


@pytest.mark.parametrize("tau_s", [0.5, 2.0, 10.0])
def test_noise_that_wanders_over_seconds_has_its_size_and_its_time(
    binned: tuple[BinnedTrial, ...], white: Noise, tau_s: float
) -> None:
    sizes, times = [], []
    for seed in range(5):
        residuals = drawn(wandering(white, 0.15, tau_s, ALL), binned, seed)
        found = with_correlation(white, binned, residuals, [GROUP, [2], [3]])
        sizes.append(found.correlated[ALL])
        times.append(found.correlation_s[ALL])
    assert np.median(sizes) == pytest.approx(rad(0.15), rel=0.25)
    assert tau_s / 2.5 < np.median(times) < 2.5 * tau_s


def test_a_sensor_that_wanders_alone_is_told_from_the_others(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    for seed in range(5):
        residuals = drawn(wandering(white, 0.4, 2.0, slice(2, 3)), binned, 50 + seed)
        found = with_correlation(white, binned, residuals, [GROUP, [2], [3]])
        assert rad(0.3) < found.correlated[2] < rad(0.8)
        assert not np.delete(found.correlated, 2).any()


def test_a_sensor_of_another_size_keeps_the_time_of_the_others(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    """Of one sensor alone the time is known badly, and noise of too short a time passes for an effect."""
    larger = []
    for seed in range(5):
        true = wandering(wandering(white, 0.15, 5.0, ALL), 0.6, 5.0, slice(2, 3))
        found = with_correlation(white, binned, drawn(true, binned, 20 + seed), [GROUP, [2], [3]])
        assert np.unique(found.correlation_s[ALL]).size == 1, seed
        larger.append(found.correlated[2] / np.median(found.correlated[[1, 3, 4]]))
    assert 2.0 < np.median(larger) < 8.0


def test_a_sensor_of_another_time_has_its_own(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    times = []
    for seed in range(5):
        true = wandering(wandering(white, 0.3, 10.0, ALL), 0.6, 0.5, slice(2, 3))
        found = with_correlation(white, binned, drawn(true, binned, 30 + seed), [GROUP, [2], [3]])
        times.append(found.correlation_s[ALL])
    own, others = np.median(times, axis=0)[1], np.median(np.delete(times, 1, axis=1))
    assert own <= 1.0 < 5.0 <= others


@pytest.mark.whole
def test_noise_that_is_known_is_found_to_be_as_it_is(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    """A sensor to which a time of its own is nearly due is not measured anew, search after search."""
    others = drawn(wandering(white, 0.3, 10.0, ALL), binned, 30)
    quicker = drawn(wandering(white, 0.6, 0.5, slice(2, 3)), binned, 31)

    def residuals(share: float) -> list[Array]:
        found = [each.copy() for each in others]
        for each, quick in zip(found, quicker, strict=True):
            each[2] = (1.0 - share) * each[2] + share * quick[2]
        return found

    def time_is_due(share: float) -> float:
        channel = channel_of(white, binned, residuals(share), 2)
        own, at_theirs = (replicate_noise._likeliest([channel], *times) for times in ((), ((5.0,),)))
        return 2.0 * (own.log_likelihood - at_theirs.log_likelihood) - 0.93 * 13.8

    given = residuals(brentq(time_is_due, 0.0, 1.0, xtol=1e-4))
    found = with_correlation(white, binned, given, [GROUP, [2], [3]])
    assert (found.correlation_s[ALL] == 5.0).all()
    refitted = [1.001 * each for each in given]
    assert with_correlation(found, binned, refitted, [GROUP, [2], [3]]) is found


@pytest.mark.whole
def test_the_torque_wanders_as_much_as_it_may_where_most_halls_do(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    """It has one channel to show it in: 0.15 of the white part over 10 s is not found there, and is there."""
    covered = []
    for seed in range(10):
        true = wandering(white, 0.15, 10.0, ALL)
        true.correlated[0], true.correlation_s[0] = 0.15 * white.white[0], 10.0
        residuals = drawn(true, binned, 40 + seed)
        found = with_correlation(white, binned, residuals, [GROUP, [2], [3]])
        assert found.correlation_s[0] == np.median(found.correlation_s[ALL]), seed
        rate, true_rate = (each.correlated[0] ** 2 / each.correlation_s[0] for each in (found, true))
        covered.append(rate > true_rate)
        fewer = wandering(wandering(true, 0.6, 10.0, ALL), 0.0, 0.4, slice(3, 5))
        found = with_correlation(white, binned, drawn(fewer, binned, 60 + seed), [GROUP, [2], [3]])
        assert not found.correlated[0], seed
    assert np.mean(covered) >= 0.9


@pytest.mark.whole
def test_white_noise_stays_white(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    for seed in range(20):
        found = with_correlation(white, binned, drawn(white, binned, 100 + seed), [GROUP, [2], [3]])
        assert not found.correlated.any(), seed


@pytest.mark.parametrize(("share", "is_noise"), [(2.7, True), (3.3, False)])
def test_where_replicates_share_three_times_what_they_differ_by_the_model_is_wrong(
    binned: tuple[BinnedTrial, ...], white: Noise, share: float, is_noise: bool
) -> None:
    residuals = drawn(wandering(white, 0.3, 2.0, ALL), binned, 7)
    error = drawn(wandering(white, 0.3, 2.0, ALL), binned, 8)[GROUP[0]]
    alike = places_alike([binned[i] for i in GROUP])

    def wrong_by(size: float) -> list[Array]:
        found = [r.copy() for r in residuals]
        for i, places in zip(GROUP, alike, strict=True):
            found[i][:, places] += size * error[:, alike[0]]
        return found

    def misfit(size: float) -> float:
        found = wrong_by(size)
        return replicate_noise._misfit([channel_of(white, binned, found, c) for c in range(5)])

    size = brentq(lambda s: misfit(s) - share, 0.0, 30.0)
    noise = with_correlation(white, binned, wrong_by(size), [GROUP])
    assert noise.correlated[ALL].all() == is_noise
    assert (noise is white) == (not is_noise)


def test_without_replicates_nothing_is_learnt(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    residuals = drawn(wandering(white, 0.5, 2.0, ALL), binned, 1)
    assert with_correlation(white, binned, residuals, [[i] for i in range(5)]) is white


def test_correlation_is_taken_from_a_gain_with_odds_of_a_thousand(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    wave = drawn(wandering(white, 1.0, 2.0, ALL), binned, 4)[GROUP[0]][1]
    alike = places_alike([binned[i] for i in GROUP])
    quiet = [np.full(b.mean.shape, np.nan) for b in binned]
    for i, way, places in zip(GROUP, (1.0, -1.0, 0.0), alike, strict=True):
        quiet[i][1, places] = way * wave[alike[0]] / np.nanstd(wave)

    def found(size: float) -> Noise:
        return with_correlation(white, binned, [size * q for q in quiet], [GROUP])

    low, high = rad(0.001), rad(1.0)
    assert found(high).correlated[1] > 0.0 == found(low).correlated[1]
    while high / low > 1.001:
        size = np.sqrt(low * high)
        low, high = (low, size) if found(size).correlated[1] > 0.0 else (size, high)
    channel = channel_of(white, binned, [high * q for q in quiet], 1)
    likeliest = replicate_noise._likeliest([channel])
    assert 2.0 * (likeliest.log_likelihood - channel.present) == pytest.approx(13.8, rel=0.02)


def gain(
    other: Noise, noise: Noise, binned: Sequence[BinnedTrial], residuals: Sequence[Array]
) -> tuple[bool, float]:
    """Whether replicates support `other`, and twice their gain of log-likelihood, channel by channel."""
    total = 0.0
    for c in range(noise.white.size):
        channel = channel_of(noise, binned, residuals, c)
        size, tau_s = other.correlated[c] / channel.white, other.correlation_s[c]
        total += 2.0 * (channel.log_likelihood(size, tau_s) - channel.present)
    return replicates_favour(other, noise, binned, residuals, [GROUP, [2], [3]]), total


@pytest.mark.whole
def test_replicates_bear_out_noise_from_a_gain_of_one_in_twenty(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    other = wandering(white, 0.1, 5.0, slice(2, 3))
    quiet, wander = drawn(white, binned, 71), drawn(wandering(white, 0.3, 5.0, slice(2, 3)), binned, 72)

    def mixed(share: float) -> list[Array]:
        return [(1.0 - share) * q + share * w for q, w in zip(quiet, wander, strict=True)]

    at = brentq(lambda share: gain(other, white, binned, mixed(share))[1] - 2.7, 0.0, 1.0)
    for share, favour in ((at - 0.002, False), (at + 0.002, True)):
        said, twice = gain(other, white, binned, mixed(share))
        assert said is favour
        assert twice == pytest.approx(2.7, abs=0.5)


def test_replicates_bear_out_no_noise_that_they_share(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    """A missing effect, the same in each trial, is no noise, nor is what a wrong model leaves of them."""
    other = wandering(white, 0.15, 2.0, ALL)
    alike = [rad(0.15) * np.vstack([0.0 * b.time_s, *[np.sin(b.time_s)] * 4]) for b in binned]
    for seed in range(5):
        own = drawn(white, binned, 80 + seed)
        assert not gain(other, white, binned, [a + o for a, o in zip(alike, own, strict=True)])[0]
    wandered = drawn(other, binned, 74)
    assert gain(other, white, binned, wandered)[0]
    wrong = [20.0 * a + w for a, w in zip(alike, wandered, strict=True)]
    assert not gain(other, white, binned, wrong)[0]
    assert not replicates_favour(other, white, binned, wandered, [[0], [1], [2]])
