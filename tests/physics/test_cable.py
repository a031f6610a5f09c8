"""Friction that grows with the torque carried, and play, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.physics.rod import Layout, Rod, build_rod
from needle_rig.physics.solver import solve

RIGIDITY_NM2, LENGTH_M = 62.5e-6, 0.4
RUBBED = Layout(LENGTH_M, ((0.0, LENGTH_M),), (LENGTH_M,))
TIME_S = np.linspace(0.0, 1.0, 201)


def cable(per_m: float, friction_n: float = 0.0, element_m: float = 1e-3) -> Rod:
    rod = build_rod(RUBBED, RIGIDITY_NM2, friction_n, element_m)
    return dataclasses.replace(rod, slip_per_torque=per_m * rod.tissue_length_m)


def play_operator(path: Array, width: float) -> Array:
    held, out = 0.0, []
    for value in path.tolist():
        held = min(max(held, value - width / 2.0), value + width / 2.0)
        out.append(held)
    return np.array(out)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_belt_carries_the_load_times_e_to_the_mu_x(sign: float) -> None:
    load_nm, per_m = 1e-4, 1.5
    base_rad = sign * np.interp(TIME_S, [0.0, 0.2, 1.0], [0.0, 0.0, 3.0])
    found = solve(cable(per_m), TIME_S, base_rad, np.full_like(TIME_S, -load_nm))
    pulled = load_nm * math.exp(sign * per_m * LENGTH_M)
    assert found.torque_nm[-1] == pytest.approx(pulled, rel=1e-3)


def test_with_coulomb_friction_beside_it() -> None:
    # dT/dx = −(υ + μ T)
    load_nm, per_m, friction_n = 1e-4, 1.5, 2e-4
    found = solve(cable(per_m, friction_n), TIME_S, 4.0 * TIME_S, np.full_like(TIME_S, -load_nm))
    grown = math.exp(per_m * LENGTH_M)
    pulled_nm = load_nm * grown + friction_n / per_m * (grown - 1.0)
    assert found.torque_nm[-1] == pytest.approx(pulled_nm, rel=1e-3)


def test_every_integrator_has_it() -> None:
    base_rad, tip_nm = 0.8 * np.sin(6.0 * TIME_S), np.full_like(TIME_S, -1e-4)
    dry = cable(1.0, 2e-4, 4e-3)
    exact = solve(dry, TIME_S, base_rad, tip_nm)
    tissue = dry.tissue_length_m > 0
    viscous = dataclasses.replace(dry, viscous_nms_per_rad=np.where(tissue, 1e-12, 0.0))
    excess = dataclasses.replace(dry, static_excess=np.where(tissue, 1e-9, 0.0))
    for rod in (viscous, excess):
        found = solve(rod, TIME_S, base_rad, tip_nm)
        assert found.torque_nm == pytest.approx(exact.torque_nm, abs=2e-6)


def loose(play_rad: float, friction_nm: float) -> Rod:
    rod = build_rod(Layout(LENGTH_M, (), (LENGTH_M,)), RIGIDITY_NM2, 0.0)
    slip, play = np.zeros_like(rod.position_m), np.zeros_like(rod.position_m)
    slip[-1], play[-2] = friction_nm, play_rad
    return dataclasses.replace(rod, slip_plus_nm=slip, slip_minus_nm=slip, play_rad=play)


def test_a_load_behind_a_play_follows_the_play_operator() -> None:
    base_rad, friction_nm, play_rad = 0.8 * np.sin(6.0 * TIME_S), 5e-5, 0.1
    found = solve(loose(play_rad, friction_nm), TIME_S, base_rad)
    width = play_rad + 2.0 * friction_nm * LENGTH_M / RIGIDITY_NM2
    assert found.tip_rad == pytest.approx(play_operator(base_rad, width), abs=1e-3 * play_rad)


def test_a_load_above_the_friction_closes_the_play() -> None:
    base_rad, friction_nm, play_rad = 0.8 * np.sin(6.0 * TIME_S), 5e-5, 0.1
    tip_nm = np.full_like(TIME_S, 2e-4)
    open_, closed = (solve(loose(p, friction_nm), TIME_S, base_rad, tip_nm) for p in (0.0, play_rad))
    # pushed to one side, but for the torque that it carries inside
    assert closed.tip_rad - open_.tip_rad == pytest.approx(0.5 * play_rad, abs=1e-3 * play_rad)
    assert closed.torque_nm == pytest.approx(open_.torque_nm, abs=1e-12)


def test_play_in_a_rod_with_friction_along_it_keeps_the_torques_in_balance() -> None:
    rod = build_rod(RUBBED, RIGIDITY_NM2, 1e-3, 4e-3)
    play, slip = np.zeros_like(rod.position_m), rod.slip_plus_nm.copy()
    play[-2], slip[-1] = 0.05, 3e-5
    both = dataclasses.replace(
        rod, play_rad=play, slip_plus_nm=slip, slip_minus_nm=slip, slip_per_torque=0.3 * rod.tissue_length_m
    )
    tip_nm = 5e-5 * np.cos(11.0 * TIME_S)
    found = solve(both, TIME_S, 2.0 * np.sin(7.0 * TIME_S), tip_nm, shaft=True)
    assert found.shaft_rad is not None
    twist = found.shaft_rad[:, -2] - found.shaft_rad[:, -1]
    carried = np.where(
        np.abs(twist) <= 0.025,
        1e-3 * twist,
        np.sign(twist) * (np.abs(twist) - 0.025 + 0.025e-3),
    )
    at_tip = rod.stiffness_nm_per_rad[-1] * carried + tip_nm
    assert np.all(np.abs(at_tip[1:]) <= 3e-5 + 1e-9)
