import dataclasses
from functools import partial

import numpy as np
import pytest
from scipy.stats import chi2

from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.observations import hum
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial
from needle_rig.workbench.observations.contrasts import contrasts
from needle_rig.workbench.observations.hum import with_hum, with_hum_left
from needle_rig.workbench.observations.noise import Noise, measure_noise, oscillation, whitener
from needle_rig.workbench.observations.replicate_noise import with_correlation
from needle_rig.workbench.policy import POLICY
from tests.workbench.hidden import dataset
from tests.workbench.observations.test_replicate_noise import GROUP, drawn, wandering

GROUPS = [GROUP, [2], [3]]
HUM_HZ = 0.17


@pytest.fixture(scope="module")
def binned() -> tuple[BinnedTrial, ...]:
    return tuple(bin_trial(t) for t in dataset().trials)


@pytest.fixture(scope="module")
def white(binned: tuple[BinnedTrial, ...]) -> Noise:
    return measure_noise(dataset().trials, binned)


def humming(noise: Noise, hall_deg: float, torque_nmm: float) -> Noise:
    sizes = np.r_[nm(torque_nmm), np.full(noise.white.size - 1, rad(hall_deg))]
    return dataclasses.replace(noise, hum=sizes, hum_hz=HUM_HZ)


@pytest.mark.whole
def test_hum_has_its_frequency_and_no_less_than_its_size(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    true = humming(white, 0.12, 0.0004)
    ratios = []
    for seed in range(6):
        residuals = drawn(true, binned, seed)
        found = with_correlation(white, binned, residuals, GROUPS)
        assert found.hum_hz == pytest.approx(HUM_HZ, abs=0.005), seed
        assert found.correlated.max() < rad(0.05), seed
        ratios.append(found.hum / true.hum)
        if seed == 0:
            assert with_correlation(found, binned, residuals, GROUPS) is found
    assert np.mean(np.array(ratios) > 1.0) > 0.9
    assert np.median(ratios) < 3.0


@pytest.mark.parametrize("tau_s", [None, 2.0, 10.0])
def test_what_wanders_is_no_hum(binned: tuple[BinnedTrial, ...], white: Noise, tau_s: float | None) -> None:
    noise = white if tau_s is None else wandering(white, 0.15, tau_s, slice(1, None))
    for seed in range(4):
        assert not with_correlation(white, binned, drawn(noise, binned, seed), GROUPS).hum.any(), seed


@pytest.mark.parametrize("phase", [0, 1])
def test_what_replicates_share_is_no_hum(binned: tuple[BinnedTrial, ...], white: Noise, phase: int) -> None:
    residuals = drawn(white, binned, 3)
    waves = [
        np.outer(white.white, oscillation(b, np.arange(b.time_s.size), np.array([HUM_HZ]))[:, phase, 0])
        for b in binned
    ]
    alike = [r + w for r, w in zip(residuals, waves, strict=True)]
    assert not with_hum(white, binned, alike, GROUPS).hum.any()
    apart = [r + w * way for r, w, way in zip(residuals, waves, (1, -1, 0, 0, 1), strict=True)]
    assert with_hum(white, binned, apart, GROUPS).hum_hz == pytest.approx(HUM_HZ, abs=0.005)


def test_without_replicates_nothing_is_learnt(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    residuals = drawn(humming(white, 1.0, 0.003), binned, 1)
    assert with_hum(white, binned, residuals, [[i] for i in range(5)]) is white


def test_a_line_in_the_residuals_of_all_trials_is_seen_without_replicates(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    def found(noise: Noise, seed: int, first: int = 0) -> Noise:
        trials = [dataclasses.replace(b, mean=b.mean.copy()) for b in binned]
        for b in trials:
            b.mean[:first] = np.nan
        each = [whitener(white, b) for b in trials]
        residuals = [w(r) for w, r in zip(each, drawn(noise, binned, seed), strict=True)]
        return with_hum_left(white, trials, each, residuals)

    true = humming(white, 0.12, 0.0004)
    for seed in range(4):
        seen, alone = found(true, seed), found(true, seed, first=4)
        assert seen.hum_hz == pytest.approx(HUM_HZ, abs=0.005), seed
        assert np.all(seen.hum > 0.7 * true.hum), seed
        assert alone.hum_hz == pytest.approx(HUM_HZ, abs=0.01), seed
        assert not alone.hum[:4].any(), seed
        assert found(white, seed) is white, seed


@pytest.mark.parametrize(("periods", "told"), [(2.5, False), (3.1, True)])
def test_residuals_tell_a_line_from_what_wanders_from_three_periods_on(
    binned: tuple[BinnedTrial, ...], white: Noise, periods: float, told: bool
) -> None:
    hz = periods / float(np.median([np.ptp(b.time_s) for b in binned]))
    each = [whitener(white, b) for b in binned]
    residuals = []
    for b, whiten, way in zip(binned, each, (1.0, -1.0, 1.0, -1.0, 0.5), strict=True):
        wave = oscillation(b, np.arange(b.time_s.size), np.array([hz]))[:, 0, 0]
        residuals.append(whiten(np.outer(2.0 * way * white.white, wave)))
    found = with_hum_left(white, binned, each, residuals)
    assert (found.hum_hz == pytest.approx(hz, rel=0.04)) is told


def test_bins_average_it(binned: tuple[BinnedTrial, ...]) -> None:
    b = binned[0]
    hz = np.array([0.17, 1.3])
    inside = np.linspace(-0.5, 0.5, 2001)[None, :] * b.duration_s[:, None] + b.time_s[:, None]
    for f, frequency in enumerate(hz):
        phase = 2 * np.pi * frequency * inside
        averaged = np.stack([np.cos(phase).mean(1), np.sin(phase).mean(1)], axis=1)
        assert oscillation(b, np.arange(b.time_s.size), hz)[:, :, f] == pytest.approx(averaged, abs=1e-3)


def test_hum_is_taken_from_odds_of_a_thousand_over_all_frequencies(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    quiet = [np.full(b.mean.shape, np.nan) for b in binned]
    for i, way in zip(GROUP, (1.0, -1.0, 0.0), strict=True):
        quiet[i][1] = way * np.sin(2 * np.pi * HUM_HZ * binned[i].time_s)

    def found(size: float) -> Noise:
        return with_hum(white, binned, [size * q for q in quiet], [GROUP])

    low, high = rad(0.001), rad(1.0)
    assert found(high).hum.any()
    assert not found(low).hum.any()
    while high / low > 1.001:
        size = np.sqrt(low * high)
        low, high = (low, size) if found(size).hum.any() else (size, high)
    every: list[Array] = [high * q for q in quiet]
    each = [contrasts(white, binned, every, [GROUP], c) for c in range(5)]
    lines = [[partial(hum._Line.of_contrasts, group, binned) for group in channel] for channel in each]
    channels = hum._Channels(white.white, lines)
    span_s = float(np.median([np.ptp(binned[i].time_s) for i in GROUP]))
    told = each[1][0].lower.shape[0] / 2  # that so many bins tell apart
    assert told < 5.0 * span_s - 2.0
    tried_hz = (2.0 + 0.25 * np.arange(4 * told)) / span_s
    gain = channels.gain(tried_hz).max()
    assert 2.0 * gain == pytest.approx(chi2.isf(0.001 / told, 5), rel=0.02)
    assert POLICY.noise.hum_significance == 0.001
