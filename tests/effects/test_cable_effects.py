"""The effects of cable drives that stand beside the recorded machine."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.library import built_in_effects, find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout
from tests.effects.common import SHORT

FOLDER = Path(__file__).parents[2] / "config/recordings/effects"
FOUND = find_effects([FOLDER])
NAMES = sorted(set(FOUND) - set(built_in_effects()))
TIME_S = np.linspace(0.0, 1.0, 201)
CABLE = NeedleModel("cable", Layout(0.4, ((0.0, 0.4),), (0.4,)), 62.5e-6, 0.0, (), 2e-3)


def made(name: str, **values: float) -> Effect:
    return FOUND[name](**values)


def test_they_are_all_here() -> None:
    assert NAMES == [
        "capstan_friction",
        "gear_ripple",
        "loose_load",
        "pulley_friction",
        "return_spring",
        "soft_cable",
        "winding_hysteresis",
    ]


@pytest.mark.parametrize("name", NAMES)
def test_off_leaves_the_model_bit_for_bit_and_typical_shows(name: str, coarse: NeedleModel) -> None:
    effect, plain = FOUND[name], coarse.predict(SHORT)
    off = effect(**{n: i.typical if i.shapes else i.off for n, i in effect.parameters().items()})
    same = coarse.with_effects(off).predict(SHORT)
    assert (same.torque_nm == plain.torque_nm).all()
    assert (same.hall_rad == plain.hall_rad).all()
    typical = coarse.with_effects(effect.at_strength(1.0)).predict(SHORT)
    moved = max(
        np.abs(typical.torque_nm - plain.torque_nm).max(), np.abs(typical.hall_rad - plain.hall_rad).max()
    )
    assert moved > 1e-6


@pytest.mark.parametrize("name", NAMES)
def test_their_relatives_are_effects(name: str) -> None:
    assert set(FOUND[name].relatives) <= set(FOUND)
    assert set(FOUND[name].limits) <= set(FOUND)


def test_capstan_friction_is_eulers() -> None:
    load_nm = np.full_like(TIME_S, -1e-4)
    pulled = CABLE.with_effects(made("capstan_friction", coefficient_per_100mm=0.15))
    seen = pulled.predict(Trial(TIME_S, 3.0 * TIME_S, tip_torque_nm=load_nm))
    assert seen.torque_nm[-1] == pytest.approx(1e-4 * math.exp(0.6), rel=1e-3)


def test_a_load_narrows_the_loop_of_a_loose_one() -> None:
    base_rad = 0.8 * np.sin(4.0 * math.pi * TIME_S)
    loose = CABLE.with_effects(made("loose_load", torque_nmm=0.05, play_deg=5.0))
    widths = []
    for load_nm in (0.0, 2e-4):
        tip_rad = loose.predict(
            Trial(TIME_S, base_rad, tip_torque_nm=np.full_like(TIME_S, load_nm))
        ).hall_rad[:, 0]
        widths.append(np.ptp((base_rad - tip_rad)[TIME_S > 0.5]))
    friction_rad = 2.0 * 5e-5 * 0.4 / 62.5e-6
    assert widths[0] == pytest.approx(friction_rad + math.radians(5.0), rel=1e-2)
    assert widths[1] == pytest.approx(friction_rad, rel=1e-2)


@pytest.mark.parametrize("place", [0.3, 0.755])
def test_a_pulley_twists_the_line_up_to_it_and_multiplies_the_load(place: float) -> None:
    base_rad = 2.0 * TIME_S
    rubbed = CABLE.with_effects(made("pulley_friction", torque_nmm=0.05, place=place))
    seen = rubbed.predict(Trial(TIME_S, base_rad))
    assert seen.torque_nm[-1] == pytest.approx(5e-5, rel=1e-6)
    assert base_rad[-1] - seen.hall_rad[-1, 0] == pytest.approx(5e-5 * place * 0.4 / 62.5e-6, rel=1e-3)
    wrapped = CABLE.with_effects(made("pulley_friction", per_torque=2.0 * math.tanh(0.3), place=place))
    pulled = wrapped.predict(Trial(TIME_S, base_rad, tip_torque_nm=np.full_like(TIME_S, -1e-4)))
    assert pulled.torque_nm[-1] == pytest.approx(1e-4 * math.exp(0.6), rel=0.03)


def test_a_soft_cable_has_two_stiffnesses() -> None:
    soft = CABLE.with_effects(made("soft_cable", twist_deg=10.0, stiffness_ratio=0.25))
    stiffness = 62.5e-6 / 0.4
    edge_rad = math.radians(5.0)
    load_nm = 4e-5 * np.sin(2.0 * math.pi * TIME_S)
    tip_rad = soft.predict(Trial(TIME_S, 0.0 * TIME_S, tip_torque_nm=load_nm)).hall_rad[:, 0]
    beyond = (
        np.sign(load_nm) * edge_rad + (load_nm - np.sign(load_nm) * 0.25 * stiffness * edge_rad) / stiffness
    )
    within = np.abs(load_nm) < 0.25 * stiffness * edge_rad
    assert 0 < within.sum() < within.size
    assert tip_rad == pytest.approx(np.where(within, load_nm / (0.25 * stiffness), beyond), abs=1e-9)


def test_wound_up_cable_forgets_a_reversal_exponentially() -> None:
    back_rad = math.radians(20.0) * np.interp(TIME_S, [0.0, 0.5, 1.0], [0.0, 1.0, 0.0])
    effect = made("winding_hysteresis", torque_nmm=0.02, length_deg=2.0)
    torque_nm = CABLE.with_effects(effect).predict(Trial(TIME_S, back_rad)).torque_nm
    behind = np.degrees(back_rad[100] - back_rad[100:])
    assert torque_nm[100] == pytest.approx(2e-5, rel=1e-3)
    assert torque_nm[100:] == pytest.approx(2e-5 * (2.0 * np.exp(-behind / 2.0) - 1.0), rel=1e-3, abs=1e-8)


def test_a_ripple_is_of_the_angle_alone() -> None:
    base_rad = 0.8 * np.sin(4.0 * math.pi * TIME_S)
    first = {"sine_deg": 0.2, "cosine_deg": -0.1, "per_turn": 14.0}
    second = {"second_sine_deg": -0.05, "second_cosine_deg": 0.08, "second_per_turn": 31.0}
    rippled = CABLE.with_effects(made("gear_ripple", **first, **second))
    left_deg = np.degrees(rippled.predict(Trial(TIME_S, base_rad)).hall_rad[:, 0] - base_rad)
    expected = 0.2 * np.sin(14.0 * base_rad) - 0.1 * np.cos(14.0 * base_rad)
    expected += -0.05 * np.sin(31.0 * base_rad) + 0.08 * np.cos(31.0 * base_rad)
    assert left_deg == pytest.approx(expected, abs=1e-6)


def test_a_return_spring_pulls_both_ways_alike() -> None:
    stiff = dataclasses.replace(CABLE, torsional_rigidity_nm2=5e-3)
    sprung = stiff.with_effects(made("return_spring", stiffness_nmm_per_rad_per_100mm=0.02))
    base_rad = 0.8 * np.sin(4.0 * math.pi * TIME_S)
    torque_nm = sprung.predict(Trial(TIME_S, base_rad)).torque_nm
    assert torque_nm == pytest.approx(0.08e-3 * base_rad, rel=5e-3, abs=1e-8)
    elsewhere = stiff.with_effects(
        made("return_spring", stiffness_nmm_per_rad_per_100mm=0.02, neutral_deg=-30.0)
    )
    torque_nm = elsewhere.predict(Trial(TIME_S, base_rad)).torque_nm
    wound_nm = 0.08e-3 * (base_rad + math.radians(30.0))
    # the first sample is the relaxed start
    assert torque_nm[1:] == pytest.approx(wound_nm[1:], rel=5e-3, abs=1e-8)
