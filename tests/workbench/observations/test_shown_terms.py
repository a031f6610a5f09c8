import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2

from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.observations import shown_terms
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial
from needle_rig.workbench.observations.contrasts import places_alike
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import Noise, covariance
from needle_rig.workbench.observations.noise_terms.drift import Drift
from needle_rig.workbench.observations.noise_terms.interference import Interference
from needle_rig.workbench.observations.noise_terms.term import Bins, ShownTerm
from needle_rig.workbench.observations.noise_terms.white import White
from needle_rig.workbench.observations.shown_terms import with_residual_term, with_shown_terms
from tests.workbench.hidden import dataset

ALL = slice(1, None)
"""Hall sensors."""
GROUP = [0, 1, 4]
"""Trials of one command in the dataset."""
GROUPS = [GROUP, [2], [3]]
ALONE = [[0], [1], [2], [3], [4]]
INTERFERENCE_HZ = 0.17


@pytest.fixture(scope="module")
def binned() -> tuple[BinnedTrial, ...]:
    return tuple(bin_trial(t) for t in dataset().trials)


@pytest.fixture(scope="module")
def white(binned: tuple[BinnedTrial, ...]) -> Noise:
    return measure_noise(dataset().trials, binned)


def drawn(noise: Noise, binned: Sequence[BinnedTrial], seed: int) -> list[Array]:
    """Bin means of noise alone."""
    random = np.random.default_rng(seed)
    found = []
    for b in binned:
        values = np.full(b.mean.shape, np.nan)
        for c in range(len(values)):
            bins = Bins.of(b, c)
            root = np.linalg.cholesky(covariance(noise, bins) + 1e-30 * np.eye(bins.use.size))
            values[c, bins.use] = root @ random.standard_normal(bins.use.size)
        found.append(values)
    return found


def having(noise: Noise, *terms: ShownTerm) -> Noise:
    """`noise` with shown terms."""
    return dataclasses.replace(noise, shown=(*noise.shown, *terms))


def drift(size_deg: float, tau_s: float, sensors: slice = ALL, torque_nmm: float = 0.0) -> Drift:
    """A drift of some Hall sensors."""
    sd = np.zeros(5)
    sd[sensors], sd[0] = rad(size_deg), nm(torque_nmm)
    return Drift(sd, np.full(5, tau_s))


def interference(hall_deg: float, torque_nmm: float) -> Interference:
    """Of all channels."""
    return Interference(np.r_[nm(torque_nmm), np.full(4, rad(hall_deg))], np.full(5, INTERFERENCE_HZ))


@pytest.mark.parametrize("tau_s", [0.5, 2.0, 10.0])
def test_a_drift_over_seconds_has_its_size_and_its_time(
    binned: tuple[BinnedTrial, ...], white: Noise, tau_s: float
) -> None:
    sizes, times = [], []
    for seed in range(5):
        residuals = drawn(having(white, drift(0.15, tau_s)), binned, seed)
        (found,) = with_shown_terms(white, binned, residuals, GROUPS).shown
        assert isinstance(found, Drift)
        sizes.append(found.sd[ALL])
        times.append(found.form[0])
    assert np.median(sizes) == pytest.approx(rad(0.15), rel=0.3)
    assert tau_s / 2.5 < np.median(times) < 2.5 * tau_s


def test_a_sensor_that_drifts_alone_is_told_from_the_others(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    for seed in range(5):
        residuals = drawn(having(white, drift(0.4, 2.0, slice(2, 3))), binned, 50 + seed)
        (found,) = with_shown_terms(white, binned, residuals, GROUPS).shown
        assert rad(0.3) < found.sd[2] < rad(0.8)
        assert np.delete(found.sd / white.white, 2).max() < 0.3


def test_a_sensor_of_another_size_has_the_time_of_the_others(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    true = having(
        white, dataclasses.replace(drift(0.15, 5.0), sd=rad(np.array([0.0, 0.15, 0.6, 0.15, 0.15])))
    )
    larger = []
    for seed in range(5):
        found = with_shown_terms(white, binned, drawn(true, binned, 20 + seed), GROUPS).shown[0]
        larger.append(found.sd[2] / np.median(found.sd[[1, 3, 4]]))
    assert 2.0 < np.median(larger) < 8.0


def test_terms_that_are_known_are_found_to_be_as_they_are(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    for term in (drift(0.15, 5.0), interference(0.12, 0.0004)):
        residuals = drawn(having(white, term), binned, 3)
        found = with_shown_terms(white, binned, residuals, GROUPS)
        assert found.shown
        refitted = [1.001 * each for each in residuals]
        assert with_shown_terms(found, binned, refitted, GROUPS) is found


@pytest.mark.whole
def test_every_channel_drifts_as_much_as_it_may(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    """The torque has one channel to show it in: 0.15 of the white part over 10 s would not be found alone."""
    covered = []
    for seed in range(10):
        true = drift(0.15, 10.0)
        true.sd[0] = 0.15 * white.white[0]
        residuals = drawn(having(white, true), binned, 40 + seed)
        (found,) = with_shown_terms(white, binned, residuals, GROUPS).shown
        covered.append(found.sd**2 / found.form > true.sd**2 / true.form)
    assert np.mean(covered, axis=0).min() >= 0.7
    assert np.mean(covered) >= 0.85


@pytest.mark.whole
def test_white_noise_stays_white(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    for seed in range(20):
        residuals = drawn(white, binned, 100 + seed)
        assert with_shown_terms(white, binned, residuals, GROUPS) is white, seed
        assert with_residual_term(white, binned, residuals, ALONE) is white, seed


@pytest.mark.parametrize(("share", "is_noise"), [(2.7, True), (3.3, False)])
def test_where_replicates_share_three_times_what_they_differ_by_the_model_is_wrong(
    binned: tuple[BinnedTrial, ...], white: Noise, share: float, is_noise: bool
) -> None:
    drifting = having(white, drift(0.3, 2.0))
    residuals, error = drawn(drifting, binned, 7), drawn(drifting, binned, 8)[GROUP[0]]
    alike = places_alike([binned[i] for i in GROUP])

    def wrong_by(size: float) -> list[Array]:
        found = [r.copy() for r in residuals]
        for i, places in zip(GROUP, alike, strict=True):
            found[i][:, places] += size * error[:, alike[0]]
        return found

    def misfit(size: float) -> float:
        return shown_terms._misfit(shown_terms._contrasts(white, binned, wrong_by(size), [GROUP]))

    size = brentq(lambda s: misfit(s) - share, 0.0, 30.0)
    noise = with_shown_terms(white, binned, wrong_by(size), [GROUP])
    assert (noise is not white) == is_noise


def test_without_replicates_contrasts_teach_nothing(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    for term in (drift(0.5, 2.0), interference(1.0, 0.003)):
        residuals = drawn(having(white, term), binned, 1)
        assert with_shown_terms(white, binned, residuals, ALONE) is white


@pytest.mark.whole
@pytest.mark.parametrize("kind", [Drift, Interference])
def test_a_term_is_taken_from_odds_of_a_thousand_over_all_its_forms(
    binned: tuple[BinnedTrial, ...], white: Noise, kind: type[Drift] | type[Interference]
) -> None:
    wave = drawn(having(white, drift(1.0, 2.0)), binned, 4)[GROUP[0]][1]
    alike = places_alike([binned[i] for i in GROUP])
    quiet = [np.full(b.mean.shape, np.nan) for b in binned]
    for i, way, places in zip(GROUP, (1.0, -1.0, 0.0), alike, strict=True):
        oscillates = np.sin(2 * np.pi * INTERFERENCE_HZ * binned[i].time_s)
        quiet[i][1] = way * oscillates
        if kind is Drift:
            quiet[i][1, places] = way * wave[alike[0]] / np.nanstd(wave)

    def found(size: float) -> Noise:
        return with_shown_terms(white, binned, [size * q for q in quiet], [GROUP])

    low, high = rad(0.001), rad(1.0)
    assert found(low) is white
    assert isinstance(found(high).shown[0], kind)
    while high / low > 1.001:
        size = np.sqrt(low * high)
        low, high = (low, size) if found(size).shown else (size, high)
    channels = shown_terms._contrasts(white, binned, [high * q for q in quiet], [GROUP])
    bins = [each.bins for groups in channels for each in groups]
    forms = kind.forms(float(np.median([np.ptp(b.time_s) for b in bins])), max(b.use.size for b in bins))
    gain = shown_terms._gain(shown_terms._gains(kind, white.white, channels, forms.values)).max()
    assert chi2.sf(2.0 * gain, 1) / 2.0 * forms.distinct == pytest.approx(0.001, rel=0.5)


@pytest.mark.parametrize("channels", [1, 2, 5])
def test_chance_of_several_sizes_is_a_mixture(channels: int) -> None:
    random = np.random.default_rng(0)
    drawn = (np.maximum(random.standard_normal((200_000, channels)), 0.0) ** 2).sum(1)
    for p in (0.1, 0.01):
        assert np.mean(drawn > 2.0 * shown_terms._by_chance(channels, p)) == pytest.approx(p, rel=0.1)


@pytest.mark.whole
def test_replicates_support_no_noise_that_they_share(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    """A missing effect, the same in each trial, is no noise, nor is what a wrong model leaves of them."""
    alike = [rad(0.3) * np.vstack([0.0 * b.time_s, *[np.sin(b.time_s)] * 4]) for b in binned]
    for seed in range(5):
        own = drawn(white, binned, 80 + seed)
        given = [a + o for a, o in zip(alike, own, strict=True)]
        assert with_residual_term(white, binned, given, GROUPS) is white
        assert with_residual_term(white, binned, given, ALONE) is not white
    drifted = drawn(having(white, drift(0.15, 2.0)), binned, 74)
    assert with_residual_term(white, binned, drifted, GROUPS) is not white
    wrong = [20.0 * a + w for a, w in zip(alike, drifted, strict=True)]
    assert with_residual_term(white, binned, wrong, GROUPS) is white


@pytest.mark.whole
def test_interference_has_its_frequency_and_no_less_than_its_size(
    binned: tuple[BinnedTrial, ...], white: Noise
) -> None:
    true = interference(0.12, 0.0004)
    for given in (GROUPS, ALONE):
        ratios = []
        for seed in range(6):
            residuals = drawn(having(white, true), binned, seed)
            ask = with_shown_terms if given is GROUPS else with_residual_term
            (found,) = ask(white, binned, residuals, given).shown
            assert isinstance(found, Interference), seed
            assert found.form == pytest.approx(INTERFERENCE_HZ, abs=0.005), seed
            ratios.append(found.sd / true.sd)
        # of four degrees of freedom the 95 % are 92: three standard deviations of 30 draws below
        assert np.mean(np.array(ratios) > 1.0) > 0.92 - 3.0 * np.sqrt(0.92 * 0.08 / 30)
        assert np.median(ratios) < 3.0


@pytest.mark.parametrize(
    "tau_s", [pytest.param(0.5, marks=pytest.mark.whole), 2.0, pytest.param(10.0, marks=pytest.mark.whole)]
)
def test_what_drifts_is_no_interference(binned: tuple[BinnedTrial, ...], white: Noise, tau_s: float) -> None:
    for seed in range(4):
        residuals = drawn(having(white, drift(0.15, tau_s)), binned, seed)
        for found in (
            with_shown_terms(white, binned, residuals, GROUPS),
            with_residual_term(white, binned, residuals, ALONE),
        ):
            assert {type(term) for term in found.shown} == {Drift}, seed


@pytest.mark.parametrize("phase", [0, 1])
def test_what_replicates_share_is_no_interference(
    binned: tuple[BinnedTrial, ...], white: Noise, phase: int
) -> None:
    residuals = drawn(white, binned, 3)
    waves = []
    for b in binned:
        every = Bins(b, 0, np.arange(b.time_s.size))
        wave = Interference.factor(every, np.array([INTERFERENCE_HZ]))[:, phase, 0]
        waves.append(np.outer(white.white, wave))
    alike = [r + w for r, w in zip(residuals, waves, strict=True)]
    assert with_shown_terms(white, binned, alike, GROUPS) is white
    apart = [r + w * way for r, w, way in zip(residuals, waves, (1, -1, 0, 0, 1), strict=True)]
    (found,) = with_shown_terms(white, binned, apart, GROUPS).shown
    assert found.form == pytest.approx(INTERFERENCE_HZ, abs=0.005)


def test_a_dead_channel_has_no_size(binned: tuple[BinnedTrial, ...], white: Noise) -> None:
    dead = [dataclasses.replace(b, mean=b.mean.copy()) for b in binned]
    residuals = drawn(having(white, interference(0.12, 0.0004)), binned, 0)
    for b, left in zip(dead, residuals, strict=True):
        b.mean[:4], left[:4] = np.nan, np.nan
    (found,) = with_residual_term(white, dead, residuals, ALONE).shown
    assert found.form == pytest.approx(INTERFERENCE_HZ, abs=0.01)
    assert not found.sd[:4].any()


def test_bins_average_an_oscillation(binned: tuple[BinnedTrial, ...]) -> None:
    bins = Bins.of(binned[0], 0)
    hz = np.array([0.17, 1.3])
    inside = np.linspace(-0.5, 0.5, 2001)[None, :] * bins.duration_s[:, None] + bins.time_s[:, None]
    for f, frequency in enumerate(hz):
        phase = 2 * np.pi * frequency * inside
        averaged = np.stack([np.cos(phase).mean(1), np.sin(phase).mean(1)], axis=1)
        assert Interference.factor(bins, hz)[:, :, f] == pytest.approx(averaged, abs=1e-3)


@pytest.mark.parametrize("term", [drift(0.15, 2.0, torque_nmm=0.001), interference(0.12, 0.0004)])
def test_a_factor_is_that_of_the_covariance(binned: tuple[BinnedTrial, ...], term: ShownTerm) -> None:
    for channel in (0, 3):
        bins = Bins.of(binned[0], channel)
        factor = term.factor(bins, term.form[:1])[:, :, 0]
        assert term.covariance(bins) == pytest.approx(term.sd[channel] ** 2 * factor @ factor.T, rel=1e-6)


def test_a_term_takes_the_place_of_that_of_its_kind(white: Noise) -> None:
    louder = white.having(White(2.0 * white.white))
    assert louder.white == pytest.approx(2.0 * white.white)
    assert [type(t) for t in louder.terms] == [type(t) for t in white.terms]
