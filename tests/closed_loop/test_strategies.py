"""Strategies against closed forms, on the plant and on scripted measurements."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest

from needle_rig.config.schema import RigConfig
from needle_rig.control.lag import lag_rad
from needle_rig.control.strategies.decay import Decay
from needle_rig.control.strategies.dither import Dither
from needle_rig.control.strategies.protocol import Protocol
from needle_rig.control.strategies.reed2008 import Reed2008
from needle_rig.control.strategies.reed2008_elastic import Reed2008Elastic
from needle_rig.control.strategies.relax import Relax
from needle_rig.control.strategies.tip_friction import TipFriction
from needle_rig.control.strategy import History, SettledMotion, Strategy, Task, find_strategies, make_strategy
from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT
from needle_rig.units import deg, nmm, rad
from tests.closed_loop.conftest import Align, simulation_of

ALL = {
    "base_equals_tip",
    "decay",
    "dither",
    "estimator",
    "none",
    "protocol",
    "reed2008",
    "reed2008_elastic",
    "relax",
    "single_lag",
    "tip_friction",
}
TASK = Task(
    target_rad=rad(45.0),
    layout=MODEL_LAYOUT,
    torsional_rigidity_nm2=62.56e-6,
    speed_rad_s=rad(45.0),
    settle_s=3.0,
    angle_limit_rad=rad(720.0),
    velocity_limit_rad_s=rad(60.0),
    acceleration_limit_rad_s2=rad(360.0),
)


def settled(index: int, base_deg: float, torque_nm: float, tip_deg: float = 0.0) -> SettledMotion:
    lag = lag_rad(torque_nm, MODEL_LAYOUT, 62.56e-6)
    base = rad(base_deg)
    halls = (rad(tip_deg),)
    return SettledMotion(index, "", 0.0, 0.0, base, base, torque_nm, halls, lag, base - halls[0])


def played(strategy: Strategy, torques_nm: Sequence[float], task: Task = TASK) -> list[tuple[float, str]]:
    """Waypoints in degrees and names, the base obeying and the torque as given."""
    history: History = (settled(0, 0.0, 0.0),)
    told = []
    for torque in torques_nm:
        waypoint = strategy.next(task, history)
        if waypoint is None:
            break
        told.append((deg(waypoint.angle_rad), waypoint.name))
        history = (*history, settled(len(history), told[-1][0], torque))
    else:
        assert strategy.next(task, history) is None
    return told


def test_every_strategy_is_found_by_its_file_and_says_what_it_does() -> None:
    found = find_strategies()
    assert set(found) >= ALL
    for name, strategy in found.items():
        assert strategy.name == name
        assert strategy.__doc__
        assert dataclasses.is_dataclass(strategy)


def test_the_paper_s_waypoints() -> None:
    torque = 0.1e-3
    lag = deg(lag_rad(torque, MODEL_LAYOUT, 62.56e-6))
    told = played(Reed2008(), [torque, torque, -torque, torque, 0.0])
    assert [name for _, name in told] == ["rotate", "overshoot", "back", "forward", "final"]
    expected = [45.0, 45.0 + lag, 45.0 - 0.75 * lag, 45.0 + 0.25 * lag, 45.0]
    assert [angle for angle, _ in told] == pytest.approx(expected)


@pytest.mark.parametrize("target", [45.0, -45.0])
def test_the_extra_turn_is_in_the_first_correction_alone_and_follows_the_target(target: float) -> None:
    task = dataclasses.replace(TASK, target_rad=rad(target))
    torques = [math.copysign(1e-4, target)] * 5
    plain = played(Reed2008(), torques, task)
    further = played(Reed2008Elastic(extra_deg=12.0), torques, task)
    change = [b - a for (a, _), (b, _) in zip(plain, further, strict=True)]
    assert change == pytest.approx([0.0, math.copysign(12.0, target), 0.0, 0.0, 0.0])


def test_a_learned_extra_turn_adds_what_was_left_to_what_was_used() -> None:
    task = dataclasses.replace(TASK, lag_left_rad=rad(5.0), extra_before_deg=12.0)
    assert Reed2008Elastic().extra_used_deg(task) == pytest.approx(17.0)
    assert Reed2008Elastic(extra_deg=3.0).extra_used_deg(task) == 3.0
    over = dataclasses.replace(TASK, lag_left_rad=rad(-20.0), extra_before_deg=12.0)
    assert Reed2008Elastic().extra_used_deg(over) == 0.0


def test_friction_at_the_tip_asks_for_22_percent_more_in_the_model_geometry() -> None:
    correction = played(TipFriction(), [1e-4, 0.0])[1][0] - 45.0
    assert correction / deg(lag_rad(1e-4, MODEL_LAYOUT, 62.56e-6)) == pytest.approx(275 / 225)


def test_decay_falls_about_the_target_by_its_ratio() -> None:
    told = played(Decay(rotations=3, ratio=0.5), [1e-4, 0.0, 0.0, 0.0, 0.0])
    lag = deg(lag_rad(1e-4, MODEL_LAYOUT, 62.56e-6))
    offsets = [angle - 45.0 for angle, _ in told]
    assert offsets == pytest.approx([0.0, lag, -0.5 * lag, 0.25 * lag, 0.0])


def test_relax_follows_the_torque_s_slope_and_stops_when_none_is_left() -> None:
    told = played(Relax(torque_nmm=0.002), [1e-4, 0.4e-4, 1e-6])
    (_, _), (second, _), (third, _) = told
    assert third - second == pytest.approx((second - 45.0) * 0.4 / 0.6)
    assert len(played(Relax(corrections=2), [1e-4, 1e-4, 1e-4])) == 3


def test_a_protocol_runs_its_steps_with_their_speeds_and_dwells() -> None:
    protocol = Protocol(steps_deg=[10, -20], speed_deg_s=[5, 50], dwell_s=0.5)
    first = protocol.next(TASK, (settled(0, 0.0, 0.0),))
    assert first is not None
    assert first.speed_rad_s is not None
    assert (deg(first.angle_rad), deg(first.speed_rad_s), first.settle_s) == pytest.approx((10, 5, 0.5))
    assert [name for _, name in played(protocol, [0.0, 0.0])] == ["step_1", "step_2"]
    assert protocol.expected_motions() == 2


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Protocol(), "steps_deg is empty"),
        (lambda: Protocol(steps_deg=(1.0, math.nan)), "steps_deg of step 2 is nan"),
        (lambda: Protocol(steps_deg=(1.0,), dwell_s=(1.0, 2.0)), "dwell_s has 2 values for 1 steps"),
        (lambda: Protocol(steps_deg=(1.0,), speed_deg_s=-1.0), "speed_deg_s of step 1 is -1.0"),
        (lambda: Protocol(steps_deg=(1.0, 800.0)).check(TASK), "step 2 is 800°, outside ±720°"),
        (
            lambda: Protocol(steps_deg=(1.0,), speed_deg_s=70).check(TASK),
            "in step 1 the speed 70°/s is outside",
        ),
        (lambda: Protocol(steps_deg=(1.0,), dwell_s=0.05).check(TASK), "in step 1 the settling time 0.05 s"),
        (lambda: Decay(rotations=0), "rotations must be a whole number from 1 to 100"),
        (lambda: Decay(rotations=2.5), "rotations must be a whole number"),  # type: ignore[arg-type]
        (
            lambda: make_strategy("decay", {"ratio": "much"}),
            "option ratio is 'much'; give a number",
        ),
        (lambda: make_strategy("decay", {"ratio": [1, 2]}), "has a value of the wrong kind; give numbers"),
        (lambda: Decay(ratio=1.0), "ratio between 0 and 1"),
        (lambda: Relax(torque_nmm=0.0), "torque_nmm must be above 0"),
        (lambda: Dither(amplitude_deg=0.0), "amplitude_deg must be"),
        (lambda: Dither(20.0, 1.0).check(TASK), "20° at 1 Hz needs 126°/s"),
        (lambda: Reed2008Elastic(extra_deg=-1.0), "extra_deg is -1.0"),
        (lambda: Reed2008Elastic(extra_deg=math.nan), "extra_deg is nan"),
    ],
)
def test_options_that_cannot_be_used_are_refused(make: Callable[[], object], text: str) -> None:
    with pytest.raises(BadInput, match=text):
        make()


@pytest.mark.parametrize("friction", ["figure_3", "rig_rigid"])
def test_in_rigid_tissue_reed2008_ends_with_the_tip_at_the_target_for_any_friction(
    align: Align, friction: str
) -> None:
    run = align(friction, layout=MODEL_LAYOUT, noise=False, settle_s=0.5)
    # what is left is the encoder's step and the base loop's error
    assert abs(deg(run.shafts_rad[-1][-1]) - 45.0) < 0.1
    assert abs(nmm(run.outcome.torque_nm)) < 0.02 * nmm(run.settled[0].torque_nm)


def test_relaxing_keeps_a_ninth_of_the_lag_and_does_not_move_the_tip(align: Align) -> None:
    run = align("figure_3", "relax", layout=MODEL_LAYOUT, noise=False, settle_s=0.5)
    assert deg(run.settled[0].tip_lag_rad) == pytest.approx(12.0, abs=0.1)
    assert deg(run.outcome.tip_lag_rad) == pytest.approx(12.0 / 9.0, abs=0.1)
    assert deg(run.shafts_rad[-1][-1]) == pytest.approx(33.0, abs=0.1)


def test_turning_the_base_to_the_tip_s_angle_changes_the_sign_of_the_torque(align: Align) -> None:
    run = align("figure_3", "base_equals_tip", layout=MODEL_LAYOUT, noise=False, settle_s=0.5)
    assert abs(deg(run.outcome.tip_lag_rad)) < 0.1
    assert nmm(run.outcome.torque_nm) < -0.001


def test_a_single_correction_brings_the_tip_and_leaves_the_shaft_wound(align: Align) -> None:
    run = align("rig_rigid", "single_lag", noise=False, settle_s=0.5)
    assert deg(run.shafts_rad[-1][-1]) == pytest.approx(45.0, abs=0.1)
    assert deg(run.outcome.tip_lag_rad) == pytest.approx(26.0, abs=0.1)


def test_the_two_front_optimum_takes_one_move_fewer_than_the_paper(align: Align) -> None:
    """Rigid, uniform: θ_d + lag, θ_d + lag · (1 − 1.5 (l_in + 0.375 L)/(l_in + 0.5 L)), θ_d.

    Fronts at 3/4 and 1/4 of the tissue: torque ±υL/4 there, so the worst place is the middle, off by
    ∫τ/JG = υL²/(16 JG).
    """
    entry, length = 0.175, 0.100
    friction_nm = 0.0582e-3
    lag = deg(lag_rad(friction_nm, MODEL_LAYOUT, 62.56e-6))
    back = lag * (1.0 - 1.5 * (entry + 0.375 * length) / (entry + 0.5 * length))
    steps = [45.0, 45.0 + lag, 45.0 + back, 45.0]
    run = align(
        "figure_3",
        "protocol",
        options={"steps_deg": steps, "dwell_s": 0.5},
        layout=MODEL_LAYOUT,
        noise=False,
    )
    shaft = deg(np.asarray(run.shafts_rad[-1]))
    assert abs(shaft[-1] - 45.0) < 0.1
    assert abs(nmm(run.outcome.torque_nm)) < 0.001
    assert abs(run.settled[-1].hall_rad[0] - rad(45.0)) < rad(0.1)
    assert len(run.settled) == make_strategy("reed2008", {}).expected_motions() - 1
    middle = deg(friction_nm * length / (16.0 * 62.56e-6))
    assert abs(shaft - 45.0).max() == pytest.approx(middle, abs=0.1)
    assert 0.2 < middle < 0.4


def test_dither_lowers_the_torque_a_little_and_helps_the_tip_little(align: Align) -> None:
    plain = align("rig_rigid", "none", noise=False, settle_s=0.5)
    dithered = align("rig_rigid", "dither", noise=False, settle_s=0.5)
    assert 0.0 < deg(plain.outcome.tip_lag_rad - dithered.outcome.tip_lag_rad) < 3.0
    assert dithered.outcome.torque_nm < plain.outcome.torque_nm
    assert deg(dithered.outcome.base_angle_rad) == pytest.approx(45.0, abs=0.1)


def test_the_layout_of_the_experiment_is_known() -> None:
    task = dataclasses.replace(TASK, layout=EXPERIMENT_LAYOUT)
    waypoint = TipFriction().next(task, (settled(0, 0, 0), settled(1, 45, 1e-4)))
    assert waypoint is not None
    assert waypoint.angle_rad == pytest.approx(rad(45.0) + 1e-4 * 0.397 / 62.56e-6)


@pytest.mark.parametrize(
    ("parameters", "target_deg"), [("rig_rigid", 45.0), ("rig_elastic", 45.0), ("rig_elastic", -90.0)]
)
def test_the_estimator_brings_the_tip_without_seeing_it(
    align: Align, parameters: str, target_deg: float
) -> None:
    run = align(parameters, "estimator", target_deg=target_deg)
    assert abs(deg(run.shafts_rad[-1][-1]) - target_deg) < 1.0
    assert len(run.settled) <= 5


def test_the_estimator_s_shaft_is_the_plant_s_within_its_own_uncertainty(config: RigConfig) -> None:
    from needle_rig.control.brain import Brain
    from needle_rig.control.reports import Request
    from needle_rig.control.strategies.estimator import Estimator
    from needle_rig.model import load_parameters
    from needle_rig.simulation.plant import Plant
    from needle_rig.simulation.run import run_virtual

    plant = Plant(load_parameters("rig_elastic"), simulation_of(config))
    steps = [45.0, 72.0, 25.0]
    run = run_virtual(Brain(config), plant, Request(rad(45.0), "protocol", {"steps_deg": steps}))
    task = dataclasses.replace(TASK, layout=EXPERIMENT_LAYOUT)
    rest = dataclasses.replace(
        run.settled[0], index=0, name="rest", base_angle_rad=0.0, torque_nm=0.0, time_s=0.5
    )
    history = (rest, *run.settled)
    estimate = Estimator().estimate(task, history)
    off = np.abs(estimate.shaft_rad - plant.shaft_rad())
    assert np.all(off <= 4.0 * estimate.shaft_sd_rad + rad(0.3))
    assert deg(estimate.shaft_sd_rad[-1]) < 3.0
    values = estimate.model.values()
    assert values["friction_nmm_per_100mm"] == pytest.approx(0.1058, rel=0.03)
    assert values["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"] == pytest.approx(0.278, rel=0.15)


def test_sigma_points_have_the_mean_and_covariance_they_were_made_from() -> None:
    from needle_rig.control.strategies.estimator import _sigma_points

    mean, covariance = np.array([0.3, -1.0]), np.array([[0.2, 0.1], [0.1, 0.5]])
    points, weights = _sigma_points(mean, covariance)
    assert weights @ points == pytest.approx(mean)
    off = points - mean
    assert np.allclose((weights[:, None] * off).T @ off, covariance)


def test_the_estimator_starts_from_the_rig_s_model_where_there_is_one(config: RigConfig) -> None:
    from needle_rig.control.brain import Brain
    from needle_rig.control.reports import Request
    from needle_rig.model import load_parameters
    from needle_rig.simulation.plant import Plant
    from needle_rig.simulation.run import run_virtual

    model = load_parameters("rig_elastic")
    plant = Plant(model, simulation_of(config))
    run = run_virtual(Brain(config, model), plant, Request(rad(45.0), "estimator"))
    assert abs(deg(plant.shaft_rad()[-1]) - 45.0) < 0.6
    assert len(run.settled) <= 3
