import dataclasses
import functools

import numpy as np
import pytest

from campaigns.workbench.diagnosis_sets import SETUPS
from campaigns.workbench.messy_shapes import SHAPES, recorded
from needle_rig.dataset import Dataset
from needle_rig.model import load_parameters
from needle_rig.workbench.estimation import discretisation_error
from needle_rig.workbench.estimation.baseline import Baseline, as_baseline, fit_baseline
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.discretisation_error import (
    by_every_sample,
    driven_at,
    whitened_error,
    with_discretisation_error,
)
from needle_rig.workbench.estimation.parameters import scaled_values_of
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.selection import shown_noise
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.evidence import within_discretisation_error
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import PROTOCOL, dataset, effect, few, fit


def test_the_discretisation_error_is_a_nuisance_of_every_fit() -> None:
    data = dataset(seed=21)
    baseline = fit_baseline(data, None, few())
    problem, found = baseline.problem, baseline.current
    error = np.concatenate([n[:, 0] for n in problem.nuisance])
    assert 0.05 < np.linalg.norm(error) < 10.0
    assert found.nuisance.shape == (1,)
    # data that hold this error twice over raise its coefficient, and no misfit
    shifted = []
    for b, w, n in zip(problem.trials, problem.whiteners, problem.nuisance, strict=True):
        mean = b.mean.copy()
        for c, channel in enumerate(w.channels):
            mean[c, channel.use] += 20.0 * channel.raw(n[w.channel == c, 0]) / np.linalg.norm(error)
        shifted.append(dataclasses.replace(b, mean=mean))
    moved = dataclasses.replace(problem, trials=tuple(shifted))
    again = fit(moved, (), found.vector)
    assert again.nuisance[0] > found.nuisance[0] + 0.5


def test_a_gain_within_three_times_the_discretisation_error_is_refused() -> None:
    data = dataset(seed=22)
    baseline = fit_baseline(data, None, few())
    problem, parent = baseline.problem, baseline.current

    def child(times: float) -> Fit:
        rows = tuple(r - times * n[:, 0] for r, n in zip(parent.residuals, problem.nuisance, strict=True))
        return dataclasses.replace(parent, residuals=rows)

    assert within_discretisation_error(problem, parent, child(2.9))
    assert within_discretisation_error(problem, parent, child(-1.0))
    assert not within_discretisation_error(problem, parent, child(3.1))
    freed = dataclasses.replace(child(1.0), pull_rigidity=parent.pull_rigidity + 12.0)
    assert not within_discretisation_error(problem, parent, freed)
    own = parent.vector.trial_friction + 0.1 * np.linspace(-1.0, 1.0, len(problem.trials))
    steadied = dataclasses.replace(child(1.0), vector=dataclasses.replace(parent.vector, trial_friction=own))
    assert not within_discretisation_error(problem, parent, steadied)


def test_a_finer_solver_leaves_less_discretisation_error() -> None:
    data = dataset(seed=23)
    problem = fit_baseline(data, None, few()).problem
    found = fit(problem, (), fit_baseline(data, None, few()).current.vector)
    sizes = []
    for length_m in (4e-3, 0.5e-3):
        used = dataclasses.replace(
            problem,
            base=dataclasses.replace(problem.base, element_length_m=length_m),
        )
        error = whitened_error(used, found, data.trials, 0.25e-3)
        sizes.append(float(np.linalg.norm(np.concatenate([e[:, 0] for e in error]))))
    assert sizes[1] < sizes[0]


def ageing() -> tuple[Dataset, Baseline, Fit]:
    """(dataset, baseline, fit of the hidden effect on coarse paths)."""
    hidden = effect("stiction_ageing", growth_per_decade=0.4, rest_time_s=1.0)
    data = dataset(hidden, seed=25)
    baseline = fit_baseline(data, None, few("stiction_ageing"))
    at = scaled_values_of(baseline.problem.parameters(["stiction_ageing"]), [hidden])
    coarse = fit(
        baseline.problem, ["stiction_ageing"], dataclasses.replace(baseline.current.vector, scaled_values=at)
    )
    assert coarse is not None
    return data, baseline, coarse


@pytest.mark.long
def test_a_path_too_coarse_for_friction_that_ages_is_driven_by_every_sample() -> None:
    """Blocks of the base's path shift the instants of slip: no straight nuisance follows that."""
    data, baseline, coarse = ageing()
    errors = whitened_error(baseline.problem, coarse, data.trials, baseline.fine_m)
    before = [np.linalg.norm(e) for e in errors]
    assert np.linalg.norm(before) > 5.0
    problem, found, validation = as_baseline(baseline, baseline.problem, coarse, None)
    assert [b.trial.time_s.size for b in problem.trials] == [t.trial.time_s.size for t in data.trials]
    assert sum(np.linalg.norm(n[:, 0]) for n in problem.nuisance) < 0.3 * sum(before)
    assert validation.error < 1.05
    growth = found.parameters[0].value(float(found.vector.scaled_values[0]))
    assert growth == pytest.approx(0.4, abs=0.08)


@pytest.mark.long
def test_a_comparison_drives_an_adopted_model_as_finely() -> None:
    data, baseline, coarse = ageing()
    problem, found, validation = as_baseline(baseline, baseline.problem, coarse, None)
    length_m = load_parameters("rig_rigid").element_length_m
    model = dataclasses.replace(problem.model(found.parameters, found.vector), element_length_m=length_m)
    assert fit_baseline(data, model, few()).validation.error == pytest.approx(validation.error, abs=0.02)


@functools.lru_cache
def slipping(encoder_deg: float) -> tuple[Dataset, Problem, Fit]:
    """(data, problem, fit at the true values) of friction that weakens as soon as it slips."""
    hidden = effect("stribeck", static_excess=0.3)
    noise = Noise(hall_deg=0.12, torque_nmm=0.0004, encoder_deg=encoder_deg, friction_scatter=0.01)
    data = dataset(hidden, seed=42, noise=noise)
    baseline = fit_baseline(data, None, few("stribeck"))
    at = scaled_values_of(baseline.problem.parameters(["stribeck"]), [hidden])
    found = fit(
        baseline.problem, ["stribeck"], dataclasses.replace(baseline.current.vector, scaled_values=at)
    )
    return data, baseline.problem, found


@pytest.mark.whole
def test_what_the_encoder_s_noise_does_to_stick_slip_is_noise_of_the_comparison() -> None:
    """A path off by 0.01° slips a sample sooner or later: true values would leave more than the noise."""
    data, problem, found = slipping(encoder_deg=0.02)
    wider, again = by_every_sample(problem, found, data.trials)
    sensors_alone = tuple(dataclasses.replace(b, from_encoder=None) for b in wider.trials)
    narrow = dataclasses.replace(wider, trials=sensors_alone, whiteners=())
    assert cross_validate(narrow, fit(narrow, ["stribeck"], again.vector)).error > 1.03
    by_chance = (2 * problem.size) ** -0.5
    assert cross_validate(wider, again).error < 1.0 + by_chance
    wide, less = (np.linalg.norm(p.whiteners[0].channels[1].blocks[0].inverse) for p in (wider, narrow))
    assert 0.0 < wide < less


@pytest.mark.whole
def test_an_effect_of_the_acceleration_is_not_driven_by_the_encoder_s_noise() -> None:
    """Between samples half a millisecond apart 0.02° are thousands of rad/s²."""
    hidden = effect("chuck_inertia", inertia_gcm2=27.5)
    model = load_parameters("rig_rigid").with_effects(hidden)
    noise = Noise(hall_deg=0.25, torque_nmm=0.0025, encoder_deg=0.02, friction_scatter=0.02)
    data = simulate_dataset(model, PROTOCOL, 44, noise, rate_hz=2000.0)
    baseline = fit_baseline(data, None, few("chuck_inertia"))
    at = scaled_values_of(baseline.problem.parameters(["chuck_inertia"]), [hidden])
    start = dataclasses.replace(baseline.current.vector, scaled_values=at)
    found = fit(baseline.problem, ["chuck_inertia"], start)
    error = whitened_error(baseline.problem, found, data.trials, baseline.fine_m)
    assert np.linalg.norm(np.vstack(error)) > 100.0
    problem, again = with_discretisation_error(baseline.problem, found, data.trials, baseline.fine_m)
    assert all(own is kept for own, kept in zip(problem.trials, baseline.problem.trials, strict=True))
    assert again.chi2 < 1.3 * problem.size
    assert again.parameters[0].value(float(again.vector.scaled_values[0])) == pytest.approx(27.5, rel=0.05)


@pytest.mark.whole
@pytest.mark.parametrize("finer", [True, False])
def test_the_discretisation_error_of_an_acceleration_is_no_second_effect(
    finer: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its shape is not that at the search's start: a delay takes up what the nuisance leaves."""
    if not finer:
        monkeypatch.setattr(shown_noise, "with_samples_at", lambda baseline, *_: baseline)
    hidden = effect("chuck_inertia", inertia_gcm2=27.5)
    data = recorded(SHAPES["one command"], (hidden,), "averaged", SETUPS[2].noise, 771_018)
    said: list[str] = []
    found = diagnose(data, few("chuck_inertia", "clock_offset"), say=said.append)
    assert (found.effects == ("chuck_inertia",)) == finer
    assert any("driven by every sample" in each for each in said) == finer


@pytest.mark.slow
def test_a_path_too_coarse_for_stick_slip_is_driven_by_every_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    data, problem, found = slipping(encoder_deg=0.02)
    met: list[Fit] = []

    def over_profiles(_: object, found: Fit) -> Fit:
        met.append(found)
        return found

    monkeypatch.setattr(discretisation_error, "over_profiles", over_profiles)
    fine_m = load_parameters("rig_rigid").element_length_m
    before = np.linalg.norm(np.vstack(whitened_error(problem, found, data.trials, fine_m)))
    assert before > 5.0
    after, again = with_discretisation_error(problem, found, data.trials, fine_m)
    assert [b.trial.time_s.size for b in after.trials] == [t.trial.time_s.size for t in data.trials]
    assert np.linalg.norm(np.vstack([n[:, :1] for n in after.nuisance])) < 0.5 * before
    far = dataclasses.replace(found, objective=3.0 * problem.size)
    assert with_discretisation_error(problem, far, data.trials, fine_m)[0].trials == problem.trials
    # the encoder's noise moves the minimum further than derivatives between two slips tell
    wider = again.scaled_errors / met[0].scaled_errors
    assert np.all(wider[:2] > 1.5)
    assert np.all(wider > 1.1)
    # the true exponent stands at its bound
    off = np.abs(again.vector.scaled_values - [1.0, 0.0, 0.0, 0.0])
    assert np.all(off[:3] < 3.0 * again.scaled_errors[:3])


@pytest.mark.whole
@pytest.mark.parametrize(("above", "driven"), [(200.0, True), (600.0, False)])
def test_a_path_of_samples_that_fits_worse_only_widens_the_spread(
    monkeypatch: pytest.MonkeyPatch, above: float, driven: bool
) -> None:
    """At 2 kHz the encoder's noise passes for rates, with which friction falls."""
    data, problem, found = slipping(encoder_deg=0.02)
    assert 5.0 * np.sqrt(2.0 * problem.size) == pytest.approx(343.0, abs=10.0)
    moved = found.vector.scaled_values + np.array([0.2, 0.0, 0.0, 0.0])
    other = dataclasses.replace(
        found,
        vector=dataclasses.replace(found.vector, scaled_values=moved),
        objective=found.objective + above,
    )
    by_samples = dataclasses.replace(problem, name="driven")
    monkeypatch.setattr(discretisation_error, "by_every_sample", lambda *_: (by_samples, other))
    monkeypatch.setattr(discretisation_error, "over_profiles", lambda _, found: found)
    monkeypatch.setattr(discretisation_error, "_between_imputations", lambda *_: np.zeros((6, 6)))
    fine_m = load_parameters("rig_rigid").element_length_m
    after, again = with_discretisation_error(problem, found, data.trials, fine_m)
    assert (after.name == "driven") == driven
    assert (driven_at(problem, found, data.trials, fine_m, 0.0) is not None) == driven
    if not driven:
        at_least = abs(again.vector.scaled_values[0] - moved[0])
        assert again.scaled_errors[0] == pytest.approx(np.hypot(at_least, found.scaled_errors[0]), rel=0.1)


@pytest.mark.whole
def test_an_encoder_without_noise_adds_none() -> None:
    data, problem, found = slipping(encoder_deg=0.0)
    wider, _ = by_every_sample(problem, found, data.trials)
    assert all(b.from_encoder is not None and not b.from_encoder.any() for b in wider.trials)


@pytest.mark.whole
def test_directions_of_other_nuisances_outlast_a_change_of_the_noise() -> None:
    data, problem, found = slipping(encoder_deg=0.02)
    raw = [np.cos(3.0 * b.base_rad) + np.zeros_like(b.mean) for b in problem.trials]
    kept = tuple(
        np.column_stack([n, w(r)]) for n, w, r in zip(problem.nuisance, problem.whiteners, raw, strict=True)
    )
    found = dataclasses.replace(found, nuisance=np.append(found.nuisance, 0.0))
    wider, _ = by_every_sample(dataclasses.replace(problem, nuisance=kept), found, data.trials)
    for whitener, nuisance, given in zip(wider.whiteners, wider.nuisance, raw, strict=True):
        assert nuisance[:, 1] == pytest.approx(whitener(given))


@pytest.mark.whole
@pytest.mark.parametrize("seed", [31, 32])
def test_a_sloppy_solver_is_not_an_effect(seed: int) -> None:
    """Data from cells and tolerances eight times coarser hold a numerical error, and no effect."""
    model = load_parameters("rig_rigid")
    sloppy = dataclasses.replace(
        model, element_length_m=8 * model.element_length_m, tolerance_rad=8 * model.tolerance_rad
    )
    found = diagnose(simulate_dataset(sloppy, PROTOCOL, seed, Noise(), name="sloppy"), few())
    assert found.verdict == "none"
