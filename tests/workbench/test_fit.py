import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.physics.library import find_effects
from needle_rig.workbench.coordinates import coordinates, make_effects, positions_of
from needle_rig.workbench.fit import STEP
from needle_rig.workbench.held_out import held_out
from needle_rig.workbench.prepare import prepare
from needle_rig.workbench.search import chance, held_gain, try_effect
from needle_rig.workbench.simulate import Noise
from tests.workbench.hidden import dataset, effect, few

EVERY = find_effects()


@given(name=st.sampled_from(sorted(EVERY)), strength=st.floats(0.02, 1.5))
def test_positions_and_values_are_inverse(name, strength):
    axes = coordinates(EVERY, [name], dataset().layout)
    positions = np.array(
        [
            0.0 if a.info.shapes else np.clip(strength if a.bounds[1] > 0 else -strength, *a.bounds)
            for a in axes
        ]
    )
    made = make_effects(EVERY, axes, positions)
    assert positions_of(axes, made) == pytest.approx(positions, abs=1e-9)


@pytest.mark.parametrize("name", sorted(EVERY))
def test_off_is_the_origin(name):
    axes = coordinates(EVERY, [name], dataset().layout)
    made = make_effects(EVERY, axes, np.zeros(len(axes)))[0]
    assert made.is_off()
    for axis in axes:
        low, high = axis.bounds
        assert low <= 0.0 <= high or axis.info.shapes
        if not axis.info.shapes:
            assert axis.position(axis.info.typical) == pytest.approx(1.0)
            assert 0 < axis.smallest < 1.2


def test_the_null_model_finds_friction_and_the_noise():
    prepared = prepare(dataset(), None, few())
    friction = np.exp(prepared.present.point.log_friction)
    assert friction * 100 == pytest.approx(0.0996, rel=0.03)
    assert abs(prepared.present.pull_rigidity) < 3
    assert prepared.held.error == pytest.approx(1.0, abs=0.1)
    assert 0.7 < prepared.present.chi2 / prepared.problem.size < 1.15


def test_a_hidden_stiffness_is_found_within_its_error():
    prepared = prepare(
        dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)), None, few()
    )
    found = try_effect(prepared.problem, prepared.present, "tissue_elasticity")
    axis, at, error = found.fit.axes[0], found.fit.point.positions[0], found.fit.position_error[0]
    assert axis.value(at) == pytest.approx(0.45, rel=0.01)
    assert abs(at - axis.position(0.45)) < 4 * error
    assert chance(prepared.present, found.fit, 5) < 1e-6
    assert held_gain(prepared.held, found.held) > 0


def test_a_trend_of_friction_over_a_few_trials_is_no_evidence():
    parent = prepare(dataset(), None, few()).present
    gain = 2.0 * parent.scatter_dof * math.log(2.0)
    seen = dataclasses.replace(parent, objective=parent.objective - gain, rank=1)
    steadier = dataclasses.replace(seen, scatter=parent.scatter / 2.0)
    assert parent.scatter_dof == 9.0
    assert chance(parent, seen, 22) < 0.01
    # t² = (2² - 1) · 7 with 7 degrees of freedom: p = 0.00254, halved for want of a second sign
    assert chance(parent, steadier, 22) == pytest.approx(22 * 0.00254 / 2, rel=0.05)


def test_a_child_is_never_worse_than_its_parent():
    prepared = prepare(dataset(), None, few())
    for name in few():
        found = try_effect(prepared.problem, prepared.present, name).fit
        assert found.objective < prepared.present.objective + 1.0


def test_held_out_prediction_needs_a_second_command():
    data = dataset()
    one = dataclasses.replace(data, trials=tuple(data.trials[i] for i in (0, 1, 4)))
    prepared = prepare(one, None, few())
    assert held_out(prepared.problem, prepared.present).error == float("inf")


def test_strengths_that_can_only_grow_one_way_have_one_sided_axes():
    one_sided = {
        "tissue_elasticity",
        "tissue_viscoelasticity",
        "viscous_slip",
        "chuck_backlash",
        "tip_friction",
    }
    for name in one_sided:
        strength = coordinates(EVERY, [name], dataset().layout)[0]
        assert strength.one_sided
        assert strength.bounds[1] > 10
    assert not coordinates(EVERY, ["torque_bias"], dataset().layout)[0].one_sided


@pytest.mark.parametrize("name", ["tip_friction", "guide_friction", "platform_friction"])
def test_a_trial_s_own_friction_scales_lumped_friction_too(name):
    """With 15 % scatter and no other noise, the right model finds each trial's factor and leaves nothing."""
    quiet = Noise(hall_deg=0.01, torque_nmm=0.00003, encoder_deg=0.001, friction_scatter=0.15)
    prepared = prepare(dataset(EVERY[name].at_strength(1.0), noise=quiet, seed=3), None, few(name))
    found = try_effect(prepared.problem, prepared.present, name).fit
    factors = [
        1.0 + 0.15 * np.random.default_rng([3, i + 1]).standard_normal()
        for i in range(len(prepared.problem.trials))
    ]
    own = np.exp(found.point.trial_friction)
    assert abs(np.log(own).mean()) < 0.005
    assert own / own.mean() == pytest.approx(np.array(factors) / np.mean(factors), rel=0.01)
    assert found.chi2 < 1.1 * prepared.problem.size


@pytest.mark.parametrize(
    ("names", "lumped"),
    [((), False), (("tissue_elasticity", "layered_friction"), False), (("tip_friction",), True)],
)
def test_only_lumped_friction_needs_a_derivative_of_its_own(names, lumped):
    problem = prepare(dataset(), None, few(*names) if names else few()).problem
    assert problem.lumps_friction(problem.axes(names)) is lumped


def test_derivatives_by_a_trial_s_own_friction_are_those_of_its_simulation():
    data = dataset(effect("tip_friction", torque_nmm=0.03))
    prepared = prepare(data, None, few("tip_friction"))
    problem = prepared.problem
    found = try_effect(problem, prepared.present, "tip_friction").fit
    every = list(range(len(problem.trials)))
    moved = dataclasses.replace(found.point, trial_friction=found.point.trial_friction + STEP)
    readings = [
        problem.readings([problem.model(found.axes, p, t) for t in every], every)
        for p in (found.point, moved)
    ]
    for t in every:
        change = problem.whiteners[t](readings[1][t] - readings[0][t]) / STEP
        assert found.jacobians[t][:, -1] == pytest.approx(change, rel=1e-6, abs=1e-6)
    shared = np.concatenate([j[:, 0] for j in found.jacobians])
    own = np.concatenate([j[:, -1] for j in found.jacobians])
    assert np.linalg.norm(own - shared) > 0.1 * np.linalg.norm(own)


def test_commands_left_out_are_foretold_at_their_own_friction():
    """15 % scatter is far from linear: simulated again at each trial's own friction, the noise is met."""
    data = dataset(effect("tip_friction", torque_nmm=0.035), noise=Noise(friction_scatter=0.15), seed=8)
    prepared = prepare(data, None, few("tip_friction"))
    found = try_effect(prepared.problem, prepared.present, "tip_friction")
    assert np.abs(found.fit.point.trial_friction).max() > 0.1
    assert found.held.error < 1.1


def test_a_fit_goes_on_along_what_the_data_hardly_tell_apart():
    """The trials' own friction stands in for wear at the start: a valley a hundred of its widths long."""
    noise = Noise(hall_deg=0.04, torque_nmm=0.0002, friction_scatter=0.01)
    data = dataset(effect("friction_wear", loss_per_turn=0.06), noise=noise, seed=3)
    prepared = prepare(data, None, few("friction_wear"))
    found = try_effect(prepared.problem, prepared.present, "friction_wear").fit
    assert prepared.present.objective - found.objective > 9.0
    assert found.point.positions[0] == pytest.approx(1.0, abs=0.1)


def test_what_friction_can_stand_for_is_as_uncertain_as_the_trials_mean():
    data = dataset(effect("tip_friction", torque_nmm=0.035), noise=Noise(friction_scatter=0.15), seed=8)
    prepared = prepare(data, None, few("tip_friction"))
    found = try_effect(prepared.problem, prepared.present, "tip_friction").fit
    mean = found.scatter / np.sqrt(len(prepared.problem.trials))
    assert np.sqrt(found.covariance[0, 0]) == pytest.approx(mean, rel=0.3)
    assert found.position_error[0] / found.point.positions[0] == pytest.approx(mean, rel=0.3)
    assert abs(found.axes[0].value(found.point.positions[0]) - 0.035) < 0.035 * 3 * mean
