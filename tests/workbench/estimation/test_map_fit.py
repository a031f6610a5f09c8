import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.workbench.estimation import multistart
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.multistart import over_forms
from needle_rig.workbench.estimation.parameters import free_parameters, make_effects, scaled_values_of
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.evidence import adjusted_p, predictive_gain
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import dataset, effect, few, fit, null_fit, try_effect

EVERY = find_effects()


@given(name=st.sampled_from(sorted(EVERY)), strength=st.floats(0.02, 1.5))
def test_scaled_values_and_values_are_inverse(name: str, strength: float) -> None:
    parameters = free_parameters(EVERY, [name], dataset().layout)
    scaled_values = np.array(
        [
            0.0 if a.info.shapes else np.clip(strength if a.bounds[1] > 0 else -strength, *a.bounds)
            for a in parameters
        ]
    )
    made = make_effects(EVERY, parameters, scaled_values)
    assert scaled_values_of(parameters, made) == pytest.approx(scaled_values, abs=1e-9)


@pytest.mark.parametrize("name", sorted(EVERY))
def test_off_is_the_origin(name: str) -> None:
    parameters = free_parameters(EVERY, [name], dataset().layout)
    made = make_effects(EVERY, parameters, np.zeros(len(parameters)))[0]
    assert made.is_off()
    for parameter in parameters:
        low, high = parameter.bounds
        assert low <= 0.0 <= high or parameter.info.shapes
        if not parameter.info.shapes:
            assert parameter.scaled_value(parameter.info.typical) == pytest.approx(1.0)
            assert 0 < parameter.smallest < 1.2


def test_the_null_model_finds_friction_and_the_noise() -> None:
    baseline = null_fit()
    friction = np.exp(baseline.current.vector.log_friction)
    assert friction * 100 == pytest.approx(0.0996, rel=0.03)
    assert abs(baseline.current.pull_rigidity) < 3
    assert baseline.validation.error == pytest.approx(1.0, abs=0.1)
    assert 0.7 < baseline.current.chi2 / baseline.problem.size < 1.15


def test_a_hidden_stiffness_is_found_within_its_error() -> None:
    baseline = null_fit(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45))
    found = try_effect(baseline.problem, baseline.current, "tissue_elasticity")
    parameter, at, error = (
        found.fit.parameters[0],
        found.fit.vector.scaled_values[0],
        found.fit.scaled_errors[0],
    )
    assert parameter.value(at) == pytest.approx(0.45, rel=0.01)
    assert abs(at - parameter.scaled_value(0.45)) < 4 * error
    assert adjusted_p(baseline.current, found.fit, 5) < 1e-6
    assert predictive_gain(baseline.validation, found.validation) > 0


def test_a_trend_of_friction_over_a_few_trials_is_no_evidence() -> None:
    parent = null_fit().current
    gain = 2.0 * parent.scatter_dof * math.log(2.0)
    seen = dataclasses.replace(parent, objective=parent.objective - gain, rank=1)
    halved = dataclasses.replace(parent.vector, trial_friction=parent.vector.trial_friction / 2.0)
    steadier = dataclasses.replace(seen, scatter=parent.scatter / 2.0, vector=halved)
    assert parent.scatter_dof == 9.0
    assert adjusted_p(parent, seen, 22) < 0.01
    # t² = (2² - 1) · 3 with the 3 degrees of freedom of five trials: p = 0.0577, halved for its one sign
    assert adjusted_p(parent, steadier, 22) == pytest.approx(1.0 - (1.0 - 0.0577 / 2) ** 22, rel=0.01)
    two = dataclasses.replace(parent, scatter_dof=POLICY.noise.scatter_dof + 2.0)
    assert adjusted_p(two, dataclasses.replace(two, objective=two.objective - 30.0, scatter=1e-4), 22) > 0.4


def test_a_child_is_never_worse_than_its_parent() -> None:
    baseline = null_fit()
    for name in few():
        found = try_effect(baseline.problem, baseline.current, name).fit
        assert found.objective < baseline.current.objective + 1.0


def test_one_command_alone_is_cross_validated_by_blocks_of_its_time() -> None:
    data = dataset()
    one = dataclasses.replace(data, trials=tuple(data.trials[i] for i in (0, 1, 4)))
    baseline = fit_baseline(one, None, few())
    assert cross_validate(baseline.problem, baseline.current).error == pytest.approx(1.0, abs=0.15)


def test_strengths_that_can_only_grow_one_way_have_one_sided_axes() -> None:
    one_sided = {
        "tissue_elasticity",
        "tissue_viscoelasticity",
        "viscous_slip",
        "chuck_backlash",
        "tip_friction",
    }
    for name in one_sided:
        strength = free_parameters(EVERY, [name], dataset().layout)[0]
        assert strength.one_sided
        assert strength.bounds[1] > 10
    assert not free_parameters(EVERY, ["torque_bias"], dataset().layout)[0].one_sided


@pytest.mark.parametrize("name", ["tip_friction", "guide_friction", "platform_friction"])
def test_a_trial_s_random_effect_scales_lumped_friction_too(name: str) -> None:
    """With 15 % scatter and no other noise, the right model finds each trial's factor and leaves nothing."""
    quiet = Noise(hall_deg=0.01, torque_nmm=0.00003, encoder_deg=0.001, friction_scatter=0.15)
    baseline = null_fit(EVERY[name].at_strength(1.0), noise=quiet, seed=3, library=(name,))
    found = try_effect(baseline.problem, baseline.current, name).fit
    factors = [
        1.0 + 0.15 * np.random.default_rng([3, i + 1]).standard_normal()
        for i in range(len(baseline.problem.trials))
    ]
    own = np.exp(found.vector.trial_friction)
    assert abs(np.log(own).mean()) < 0.005
    assert own / own.mean() == pytest.approx(np.array(factors) / np.mean(factors), rel=0.01)
    assert found.chi2 < 1.1 * baseline.problem.size


@pytest.mark.parametrize(
    ("names", "lumped"),
    [((), False), (("tissue_elasticity", "layered_friction"), False), (("tip_friction",), True)],
)
def test_only_lumped_friction_needs_a_derivative_of_its_own(names: tuple[str, ...], lumped: bool) -> None:
    problem = fit_baseline(dataset(), None, few(*names) if names else few()).problem
    assert problem.lumps_friction(problem.parameters(names)) is lumped


def test_derivatives_by_a_random_effect_are_those_of_its_simulation() -> None:
    data = dataset(effect("tip_friction", torque_nmm=0.03))
    baseline = fit_baseline(data, None, few("tip_friction"))
    problem = baseline.problem
    found = try_effect(problem, baseline.current, "tip_friction").fit
    step = 1e-6
    moved = [
        dataclasses.replace(found.vector, trial_friction=found.vector.trial_friction + way)
        for way in (-step, step)
    ]
    readings = [problem.predict(found.parameters, p) for p in moved]
    for t in range(len(problem.trials)):
        change = problem.whiteners[t](readings[1][t] - readings[0][t]) / (2 * step)
        assert np.linalg.norm(found.jacobians[t][:, -1] - change) < 2e-3 * np.linalg.norm(change)
    shared = np.concatenate([j[:, 0] for j in found.jacobians])
    own = np.concatenate([j[:, -1] for j in found.jacobians])
    assert np.linalg.norm(own - shared) > 0.1 * np.linalg.norm(own)


def test_commands_left_out_are_predicted_at_their_random_effects() -> None:
    """15 % scatter is far from linear: simulated again at each trial's own friction, the noise is met."""
    data = dataset(effect("tip_friction", torque_nmm=0.035), noise=Noise(friction_scatter=0.15), seed=8)
    baseline = fit_baseline(data, None, few("tip_friction"))
    found = try_effect(baseline.problem, baseline.current, "tip_friction")
    assert np.abs(found.fit.vector.trial_friction).max() > 0.1
    assert found.validation.error < 1.1


def left_out_and_fitted_again(problem: Problem, found: Fit) -> float:
    """The error by the long way: a fit to the other commands, then the own friction at its minimum of χ²."""
    chi2 = 0.0
    for group in problem.groups:
        kept = [t for t in range(len(problem.trials)) if t not in group]
        rest = dataclasses.replace(
            problem,
            trials=tuple(problem.trials[t] for t in kept),
            whiteners=tuple(problem.whiteners[t] for t in kept),
            nuisance=tuple(problem.nuisance[t] for t in kept),
        )
        own = found.vector.trial_friction[kept]
        again = fit(rest, found.effects, dataclasses.replace(found.vector, trial_friction=own))
        model = problem.model(again.parameters, again.vector)
        for t in group:

            def of(own: float, model: NeedleModel = model, again: Fit = again, t: int = t) -> float:
                with_own = model.with_effects(FrictionOfTrial(math.exp(own)))
                rows = problem.residuals(problem.readings([with_own], [t]), [t])[0]
                rows = rows - problem.nuisance[t] @ again.nuisance
                return float(rows @ rows + (own / found.scatter) ** 2)

            near = found.vector.trial_friction[t]
            grid = np.linspace(near - 0.1, near + 0.1, 41)
            least = grid[np.argmin([of(own) for own in grid])]
            around = (least - 0.005, least + 0.005)
            chi2 += minimize_scalar(of, bounds=around, method="bounded").fun
    return math.sqrt(chi2 / problem.size)


@pytest.mark.parametrize(
    ("hidden", "scatter", "seed"),
    [
        (effect("torque_bias", bias_nmm=0.012), 0.1, 8),
        (effect("friction_wear", loss_per_turn=0.3), 0.05, 9),
        (effect("chuck_backlash", play_deg=3.0), 0.05, 10),
    ],
)
def test_leaving_commands_out_is_what_fitting_the_others_gives(
    hidden: Effect, scatter: float, seed: int
) -> None:
    data = dataset(hidden, noise=Noise(friction_scatter=scatter), seed=seed)
    baseline = fit_baseline(data, None, few(hidden.name()))
    found = try_effect(baseline.problem, baseline.current, hidden.name())
    exact = left_out_and_fitted_again(baseline.problem, found.fit)
    assert exact == pytest.approx(1.0, abs=0.06)
    assert found.validation.error == pytest.approx(exact, rel=0.01)


def test_leaving_a_command_out_may_take_several_steps() -> None:
    """From a place where the other commands would not leave the parameters, one linear step is not enough."""
    data = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45))
    baseline = fit_baseline(data, None, few())
    problem, found = baseline.problem, try_effect(baseline.problem, baseline.current, "tissue_elasticity").fit
    away = dataclasses.replace(found.vector, scaled_values=0.6 * found.vector.scaled_values)
    there = fit(problem, found.effects, away, iterations=0)
    assert np.sqrt(there.chi2 / problem.size) > 3.0
    near = dataclasses.replace(there, objective=found.objective, scatter=found.scatter)
    assert cross_validate(problem, near).error == pytest.approx(
        cross_validate(problem, found).error, rel=0.02
    )


@pytest.mark.parametrize(
    "hidden",
    [effect("torque_bias", bias_nmm=0.012), effect("layered_friction", factor=(1.6, 0.8, 1.2, 1.2))],
)
def test_the_predictive_density_is_that_of_a_linear_model(hidden: Effect) -> None:
    """Near the minimum all is linear: the other commands' posterior, and the density it gives to the rest."""
    data = dataset(hidden, noise=Noise(friction_scatter=0.01))
    baseline = fit_baseline(data, None, few(hidden.name()))
    problem, found = baseline.problem, try_effect(baseline.problem, baseline.current, hidden.name()).fit
    p, trials, q = 2 + len(found.parameters), len(problem.trials), found.nuisance.size
    design = []
    for t in range(trials):
        own = np.zeros((found.jacobians[t].shape[0], trials))
        own[:, t] = found.jacobians[t][:, -1]
        design.append(np.hstack([found.jacobians[t][:, :p], problem.nuisance[t], own]))
    vector = found.vector
    away = np.zeros(p + q + trials)
    away[1] = found.pull_rigidity * problem.rigidity_prior
    away[2:] = np.r_[vector.scaled_values, found.nuisance, vector.trial_friction]
    tight = np.r_[0.0, problem.rigidity_prior**-2, [a.prior_sd**-2.0 for a in found.parameters], np.ones(q)]
    prior = np.diag(np.r_[tight, np.full(trials, found.scatter**-2)])
    if hidden.name() == "layered_friction":  # whose factors count against their mean
        prior[2:p, 2:p] += 1e8
    loss = 0.0
    for group in problem.groups:
        kept = [t for t in range(trials) if t not in group]
        inverse = np.linalg.inv(prior + sum(design[t].T @ design[t] for t in kept))
        push = sum(design[t].T @ found.residuals[t] for t in kept) - prior @ away
        left_out = np.vstack([design[t] for t in group])
        rows = np.concatenate([found.residuals[t] for t in group]) - left_out @ inverse @ push
        spread = np.eye(rows.size) + left_out @ inverse @ left_out.T
        loss += rows @ np.linalg.solve(spread, rows) + np.linalg.slogdet(spread)[1]
    assert cross_validate(problem, found).loss == pytest.approx(loss, abs=1.0)


@pytest.mark.whole
def test_wear_that_one_command_shows_predicts_better_than_scatter() -> None:
    data = dataset(effect("friction_wear", loss_per_turn=0.5))
    baseline = fit_baseline(data, None, few("friction_wear"))
    found = try_effect(baseline.problem, baseline.current, "friction_wear")
    assert found.fit.scatter < 0.5 * baseline.current.scatter
    assert predictive_gain(baseline.validation, found.validation) > 5.0


@pytest.mark.whole
def test_a_fit_goes_on_along_what_the_data_hardly_tell_apart() -> None:
    """The trials' own friction stands in for wear at the start: a valley a hundred of its widths long."""
    noise = Noise(hall_deg=0.04, torque_nmm=0.0002, friction_scatter=0.01)
    data = dataset(effect("friction_wear", loss_per_turn=0.06), noise=noise, seed=3)
    baseline = fit_baseline(data, None, few("friction_wear"))
    found = try_effect(baseline.problem, baseline.current, "friction_wear").fit
    assert baseline.current.objective - found.objective > 9.0
    assert found.vector.scaled_values[0] == pytest.approx(1.0, abs=0.1)


def test_what_friction_can_stand_for_is_as_uncertain_as_the_trials_mean() -> None:
    data = dataset(effect("tip_friction", torque_nmm=0.035), noise=Noise(friction_scatter=0.15), seed=8)
    baseline = fit_baseline(data, None, few("tip_friction"))
    found = try_effect(baseline.problem, baseline.current, "tip_friction").fit
    mean = found.scatter / np.sqrt(len(baseline.problem.trials))
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(mean, rel=0.3)
    assert found.scaled_errors[0] / found.vector.scaled_values[0] == pytest.approx(mean, rel=0.3)
    assert abs(found.parameters[0].value(found.vector.scaled_values[0]) - 0.035) < 0.035 * 3 * mean


def test_factors_of_sections_count_against_their_mean() -> None:
    """What all sections share is friction, to the last digit: only their ratios can be known, and are."""
    given = np.array([1.6, 0.8, 1.2, 1.2])
    baseline = fit_baseline(
        dataset(effect("layered_friction", factor=tuple(given))), None, few("layered_friction")
    )
    found = try_effect(baseline.problem, baseline.current, "layered_friction").fit
    assert found is not None
    factors = np.array(
        [a.value(float(x)) for a, x in zip(found.parameters, found.vector.scaled_values, strict=True)]
    )
    assert factors.mean() == pytest.approx(1.0, abs=1e-6)
    assert factors == pytest.approx(given / given.mean(), abs=0.02)
    errors = 0.5 * found.scaled_errors
    assert np.all(errors < 0.02)
    assert np.all(np.abs(factors - given / given.mean()) < 4 * errors)
    assert cross_validate(baseline.problem, found).error < 1.1


@pytest.mark.whole
def test_minima_that_fit_alike_widen_the_spread_and_one_met_twice_counts_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    baseline = null_fit(effect("stribeck", static_excess=0.3), library=("stribeck",))
    start = dataclasses.replace(
        baseline.current.vector, scaled_values=np.zeros(len(EVERY["stribeck"].parameters()))
    )
    found = fit(baseline.problem, ["stribeck"], start)
    assert found is not None

    def moved(by: float, worse: float) -> Fit:
        scaled_values = found.vector.scaled_values.copy()
        scaled_values[0] += by
        vector = dataclasses.replace(found.vector, scaled_values=scaled_values)
        return dataclasses.replace(found, vector=vector, objective=found.objective + worse)

    others = [moved(0.5, 0.0), moved(0.5, 0.9), moved(-0.7, 40.0)]
    monkeypatch.setattr(multistart, "_from_other_forms", lambda *_: others)
    spread = over_forms(baseline.problem, found).scaled_errors
    assert spread[0] == pytest.approx(np.hypot(found.scaled_errors[0], 0.5 / np.sqrt(2)), rel=0.02)
    assert spread[1:] == pytest.approx(found.scaled_errors[1:], rel=1e-6)


@pytest.mark.long
def test_other_forms_lead_out_of_a_minimum_that_is_not_the_lowest() -> None:
    baseline = null_fit(effect("stribeck", static_excess=0.3), library=("stribeck",))
    start = dataclasses.replace(baseline.current.vector, scaled_values=np.array([0.9, -0.6, -1.5, 0.0]))
    stuck = fit(baseline.problem, ["stribeck"], start)
    assert stuck is not None
    found = over_forms(baseline.problem, stuck)
    assert found.objective < stuck.objective - 10.0
    assert found.parameters[0].value(float(found.vector.scaled_values[0])) == pytest.approx(0.3, abs=0.01)
