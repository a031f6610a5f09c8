"""A needle moved piece by piece is the needle moved in one go, and says where its shaft is."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.effects.bearing_drag import BearingDrag
from needle_rig.physics.effects.chuck_backlash import ChuckBacklash
from needle_rig.physics.effects.torque_bias import TorqueBias
from needle_rig.physics.effects.torque_low_pass import TorqueLowPass
from needle_rig.physics.effects.viscous_slip import ViscousSlip
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import nm, rad

TIME_S = np.arange(0.0, 6.0, 0.05)
BASE_RAD = np.interp(TIME_S, [0.0, 1.0, 2.0, 4.0, 5.0], rad(np.array([0.0, 70.0, 70.0, -40.0, -40.0])))
CUTS = (0, 45, 46, 90, len(TIME_S))


def in_pieces(model: NeedleModel) -> list[SettledNeedle]:
    """The needle after each piece of the path; every piece begins where the one before it ended."""
    needles = [SettledNeedle.relaxed(model)]
    for start, stop in pairwise(CUTS):
        piece = slice(max(start - 1, 0), stop)
        needles.append(needles[-1].moved(Trial(TIME_S[piece], BASE_RAD[piece])))
    return needles[1:]


@pytest.mark.parametrize("effect", [None, ChuckBacklash(6.0)])
def test_pieces_of_a_path_end_where_the_whole_does_to_the_bit(effect: ChuckBacklash | None) -> None:
    model = load_parameters("rig_elastic")
    model = model if effect is None else model.with_effects(effect)
    whole = model.truth(Trial(TIME_S, BASE_RAD), shaft=True)
    assert whole.shaft_rad is not None
    for needle, stop in zip(in_pieces(model), CUTS[1:], strict=True):
        assert np.array_equal(needle.angle_rad, whole.shaft_rad[stop - 1])
        assert needle.torque_nm == whole.torque_nm[stop - 1]
        assert needle.tip_rad == whole.tip_rad[stop - 1]
        assert np.array_equal(needle.hall_rad, whole.sensor_rad[stop - 1])
        assert needle.base_rad == BASE_RAD[stop - 1]


def test_of_a_needle_that_depends_on_rate_they_end_there_within_the_solver_s_tolerance() -> None:
    model = load_parameters("rig_rigid").with_effects(ViscousSlip.at_strength(1.0))
    whole = model.truth(Trial(TIME_S, BASE_RAD))
    last = in_pieces(model)[-1]
    assert np.abs(last.angle_rad - whole.state.angle_rad).max() < 5.0 * model.tolerance_rad
    assert last.torque_nm == pytest.approx(whole.torque_nm[-1], abs=nm(0.001))


def test_a_reading_is_the_mean_over_its_window_of_what_the_sensors_show() -> None:
    model = load_parameters("rig_elastic").with_effects(TorqueBias(0.01))
    trial = Trial(TIME_S, BASE_RAD)
    shown = model.predict(trial)
    base_rad, torque_nm, hall_rad = SettledNeedle.relaxed(model).moved(trial).reading(slice(10, 30))
    assert base_rad == pytest.approx(BASE_RAD[10:30].mean())
    assert torque_nm == pytest.approx(shown.torque_nm[10:30].mean())
    assert hall_rad == pytest.approx(shown.hall_rad[10:30].mean(axis=0))


def test_the_torque_inside_the_needle_falls_from_the_base_s_to_nothing_at_the_tip() -> None:
    needle = in_pieces(load_parameters("rig_elastic"))[0]
    assert needle.torque_nm > nm(0.05)
    assert needle.internal_torque_nm[0] == pytest.approx(needle.torque_nm, rel=1e-9)
    assert needle.internal_torque_nm[-1] == pytest.approx(0.0, abs=1e-12)
    assert needle.tip_lag_rad == needle.base_rad - needle.angle_rad[-1]
    assert needle.position_m[needle.tissue][0] == needle.model.layout.tissue_sections_m[0][0]


def test_a_needle_starts_where_its_base_stands_without_twist() -> None:
    needle = SettledNeedle.relaxed(load_parameters("rig_rigid"), rad(-30.0))
    assert needle.angle_rad == pytest.approx(rad(-30.0))
    moved = needle.moved(Trial(np.array([0.0, 1.0]), rad(np.array([-30.0, -30.0]))))
    assert moved.torque_nm == 0.0


@pytest.mark.parametrize("effect", [BearingDrag(0.02), TorqueLowPass(800.0)])
def test_what_a_sensor_remembers_is_taken_along_to_the_next_piece(effect: Effect) -> None:
    model = load_parameters("rig_elastic").with_effects(effect)
    whole = model.predict(Trial(TIME_S, BASE_RAD))
    for needle, stop in zip(in_pieces(model), CUTS[1:], strict=True):
        _, torque_nm, _ = needle.reading(slice(-1, None))
        assert torque_nm == pytest.approx(whole.torque_nm[stop - 1], abs=1e-12)
