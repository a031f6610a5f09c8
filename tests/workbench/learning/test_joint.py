"""Friction of a plain joint: its numbers lie within their intervals, and what was not moved is not told."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import pytest
from scipy.optimize import curve_fit

from needle_rig.dataset.records import DatasetTrial, TrialCommand
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.workbench.learning.joint import JointFriction, joint_friction, seen, twist_is_seen
from tests.importing.machines import Joint, after_play, swings
from tests.workbench.hidden import dataset

SEEDS = 40


def trial(time_s: Array, angle: Array, torque: Array) -> DatasetTrial:
    return DatasetTrial(
        Trial(time_s, angle),
        angle,
        0.0,
        torque,
        np.zeros((len(time_s), 0)),
        np.full(len(time_s), ""),
        TrialCommand("unknown"),
        "made",
    )


def found(*trials: DatasetTrial) -> JointFriction:
    friction = joint_friction(seen(trials))
    assert friction is not None
    return friction


def moved(joint: Joint, seed: int) -> DatasetTrial:
    time_s, angle, rate = swings(phase=0.1 * seed)
    return trial(time_s, angle, joint.torque_nm(angle, rate, np.random.default_rng(seed)))


def missing(friction: JointFriction) -> set[str]:
    return {n.name for n in friction.numbers if n.value is None}


@pytest.mark.whole
@pytest.mark.parametrize("stribeck_nm", [0.0, 0.05])
def test_intervals_hold_the_truth_as_often_as_they_say(stribeck_nm: float) -> None:
    joint = Joint(stribeck_nm=stribeck_nm)
    truth = {
        "coulomb": joint.coulomb_nm,
        "viscous": joint.viscous_nms_per_rad,
        "offset": joint.offset_nm,
        "stribeck": joint.stribeck_nm,
        "stribeck_rate": joint.stribeck_rad_s,
    }
    met = dict.fromkeys(truth, 0)
    for seed in range(SEEDS):
        friction = found(moved(joint, seed))
        assert ("stribeck" in missing(friction)) == (stribeck_nm == 0.0)
        for number in friction.numbers:
            if number.value is not None and number.deviation is not None:
                met[number.name] += (
                    abs(number.value - truth[number.name]) <= friction.reach * number.deviation
                )
    # 95 % of 40 are met, less than 34 come once in 150
    assert all(count >= 34 for name, count in met.items() if stribeck_nm or "stribeck" not in name), met


@pytest.mark.whole
def test_bounds_hold_what_is_too_small_to_be_told() -> None:
    """An excess that no fit tells, no viscous friction, no offset."""
    joint = Joint(viscous_nms_per_rad=0.0, offset_nm=0.0, stribeck_nm=0.0005)
    truth = {"viscous": 0.0, "offset": 0.0, "stribeck": joint.stribeck_nm}
    told, below = dict.fromkeys(truth, 0), dict.fromkeys(truth, 0)
    for seed in range(SEEDS):
        friction = found(moved(joint, seed))
        assert friction["coulomb"].at_most is None
        for name, size in truth.items():
            bound = friction[name].at_most
            told[name] += bound is not None
            below[name] += bound is not None and size <= bound
            assert bound is None or bound < 0.1 * joint.coulomb_nm, name
    assert all(count >= 34 for count in told.values()), told
    assert all(told[name] - below[name] <= 2 for name in truth), below


def test_scipys_least_squares_on_the_same_channels_agrees() -> None:
    joint = Joint(0.8, 0.1, 0.02, 0.2, 0.15, noise_nm=0.01)
    one = moved(joint, 1)
    rate = np.gradient(one.trial.base_angle_rad, one.trial.time_s)
    behind = one.trial.base_angle_rad - after_play(one.trial.base_angle_rad, 2e-3)
    slips = behind * np.sign(rate) > 0.999e-3
    slips &= np.roll(slips, 1) & np.roll(slips, -1)  # no sample beside a reversal

    def law(w: Array, coulomb: float, viscous: float, offset: float, excess: float, fading: float) -> Array:
        bump = excess * np.exp(-((w / fading) ** 2))
        return np.asarray(offset + np.sign(w) * (coulomb + bump) + viscous * w)

    at, _ = curve_fit(law, rate[slips], one.torque_nm[slips], (0.5, 0.05, 0.0, 0.1, 0.2))
    friction = found(one)
    for name, scipys in zip(("coulomb", "viscous", "offset", "stribeck", "stribeck_rate"), at, strict=True):
        number = friction[name]
        assert number.value is not None
        assert number.deviation is not None
        assert abs(number.value - scipys) <= friction.reach * number.deviation, name


@pytest.mark.parametrize("play", [0.0, 0.01, 0.05, 0.15])
def test_a_play_and_its_reversals_are_left_aside(play: float) -> None:
    time_s, angle, _ = swings()
    far = after_play(angle, play)
    torque = Joint(0.8, 0.1, 0.02).torque_nm(far, np.gradient(far, time_s), np.random.default_rng(2))
    friction = found(trial(time_s, angle, torque))
    for name, true in (("coulomb", 0.8), ("viscous", 0.1), ("offset", 0.02)):
        assert friction[name].value == pytest.approx(true, abs=0.01), name


def test_inertia_is_told_where_it_shows() -> None:
    time_s, angle, rate = swings()
    rng = np.random.default_rng(6)
    torque = Joint().torque_nm(angle, rate, rng)
    assert all(n.name != "inertia" for n in found(trial(time_s, angle, torque)).numbers)
    heavy = found(trial(time_s, angle, torque + 0.03 * np.gradient(rate, time_s)))
    for name, true in (("inertia", 0.03), ("coulomb", 0.168), ("viscous", 0.05), ("offset", -0.05)):
        number = heavy[name]
        assert number.value is not None
        assert number.deviation is not None
        assert abs(number.value - true) <= 2.0 * heavy.reach * number.deviation, name


def test_one_way_alone_tells_nothing_apart() -> None:
    time_s = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(0)
    friction = found(trial(time_s, 0.5 * time_s, 0.2 + 0.01 * rng.standard_normal(len(time_s))))
    assert missing(friction) == {"coulomb", "viscous", "offset", "stribeck"}
    assert friction["coulomb"].missing == "turn the base both ways"
    assert friction["drag"].value == pytest.approx(0.2, abs=0.002)
    assert all(n.at_most is None for n in friction.numbers)


def test_one_way_at_several_rates_tells_viscous_friction() -> None:
    time_s = np.arange(0.0, 20.0, 0.01)
    rate = 1.5 + np.sin(time_s)
    angle = np.concatenate(([0.0], np.cumsum(rate)[:-1])) * 0.01
    noise = 0.001 * np.random.default_rng(0).standard_normal(len(time_s))
    friction = found(trial(time_s, angle, 0.2 + 0.05 * rate + noise))
    assert friction["viscous"].value == pytest.approx(0.05, abs=0.001)
    assert friction["drag"].value == pytest.approx(0.2, abs=0.002)


def test_drag_by_the_square_of_the_rate_is_no_stribeck_friction() -> None:
    time_s, angle, rate = swings()
    noise = 0.002 * np.random.default_rng(0).standard_normal(len(time_s))
    torque = Joint(0.1, 0.0, 0.0, noise_nm=0.0).torque_nm(angle, rate, np.random.default_rng(0))
    friction = found(trial(time_s, angle, torque + 0.05 * rate * np.abs(rate) + noise))
    assert "stribeck" in missing(friction)


def strokes(rates: Sequence[float]) -> tuple[Array, Array]:
    time_s = np.arange(0.0, 4.0 * len(rates), 0.01)
    rate = np.concatenate([np.full(400, w * s) for k, w in enumerate(rates) for s in [(-1) ** k]])
    return time_s, rate


def test_one_rate_both_ways_tells_no_viscous_friction() -> None:
    time_s, rate = strokes([0.5] * 6)
    angle = np.cumsum(rate) * 0.01
    torque = Joint(0.2, 0.1, 0.0).torque_nm(angle, rate, np.random.default_rng(0))
    friction = found(trial(time_s, angle, torque))
    assert missing(friction) == {"viscous", "stribeck"}
    assert friction["coulomb"].value == pytest.approx(0.25, abs=0.002)
    assert "factor of five" in friction["viscous"].missing
    # all of it at this rate may be viscous
    assert friction["viscous"].at_most == pytest.approx(0.25 / 0.5, rel=0.02)


def test_two_rates_tell_it_and_trials_count_together() -> None:
    trials = []
    for w in (0.2, 1.0):
        time_s, rate = strokes([w] * 4)
        angle = np.cumsum(rate) * 0.01
        trials.append(
            trial(time_s, angle, Joint(0.2, 0.1, 0.0).torque_nm(angle, rate, np.random.default_rng(3)))
        )
    assert found(*trials)["viscous"].value == pytest.approx(0.1, abs=0.002)


def test_a_noisy_encoder_gets_longer_blocks() -> None:
    time_s, angle, rate = swings()
    rng = np.random.default_rng(5)
    torque = Joint().torque_nm(angle, rate, rng)
    rough = angle + math.radians(0.1) * rng.standard_normal(len(angle))
    one = trial(time_s, rough, torque)
    assert len(seen([one]).rate_rad_s) < len(time_s)


def test_what_does_not_move_has_no_friction() -> None:
    time_s = np.arange(0.0, 5.0, 0.01)
    still = np.zeros_like(time_s)
    assert joint_friction(seen([trial(time_s, still, np.sin(time_s))])) is None
    assert joint_friction(seen([trial(time_s, np.sin(time_s), still)])) is None
    assert joint_friction(seen([trial(time_s, np.sin(time_s), np.full_like(time_s, np.nan))])) is None
    assert joint_friction(seen([])) is None


def test_a_needle_shows_its_twist() -> None:
    needle = dataset()
    assert twist_is_seen(needle, math.radians(3.0))
    assert not twist_is_seen(needle, math.radians(3000.0))
