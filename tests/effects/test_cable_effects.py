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


def test_they_are_the_three() -> None:
    assert NAMES == ["capstan_friction", "loose_load", "return_spring"]


@pytest.mark.parametrize("name", NAMES)
def test_off_leaves_the_model_bit_for_bit_and_typical_shows(name: str, coarse: NeedleModel) -> None:
    effect, plain = FOUND[name], coarse.predict(SHORT)
    off = effect(**{n: i.typical if i.shapes else i.off for n, i in effect.parameters().items()})
    same = coarse.with_effects(off).predict(SHORT)
    assert (same.torque_nm == plain.torque_nm).all()
    assert (same.hall_rad == plain.hall_rad).all()
    typical = coarse.with_effects(effect.at_strength(1.0)).predict(SHORT)
    assert np.abs(typical.torque_nm - plain.torque_nm).max() > 1e-6


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


def test_a_return_spring_pulls_both_ways_alike() -> None:
    stiff = dataclasses.replace(CABLE, torsional_rigidity_nm2=5e-3)
    sprung = stiff.with_effects(made("return_spring", stiffness_nmm_per_rad_per_100mm=0.02))
    base_rad = 0.8 * np.sin(4.0 * math.pi * TIME_S)
    torque_nm = sprung.predict(Trial(TIME_S, base_rad)).torque_nm
    assert torque_nm == pytest.approx(0.08e-3 * base_rad, rel=5e-3, abs=1e-8)
