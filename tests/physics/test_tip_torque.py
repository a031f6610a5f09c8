"""A torque on the tip that is prescribed, against closed forms."""

import dataclasses
import math

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout, build_rod
from needle_rig.physics.solver import solve, solve_batch

RIGIDITY_NM2, LENGTH_M, FRICTION_N = 62.5e-6, 0.4, 1e-3
FREE = Layout(LENGTH_M, (), (LENGTH_M,))
RUBBED = Layout(LENGTH_M, ((0.0, LENGTH_M),), (LENGTH_M,))
TIME_S = np.linspace(0.0, 1.0, 101)


def test_without_friction_the_twist_is_t_l_over_gj() -> None:
    tip_nm = 1e-4 * np.sin(2.0 * math.pi * TIME_S)
    base_rad = 0.7 * TIME_S
    found = solve(build_rod(FREE, RIGIDITY_NM2, 0.0), TIME_S, base_rad, tip_nm)
    assert found.tip_rad - base_rad == pytest.approx(tip_nm * LENGTH_M / RIGIDITY_NM2, abs=1e-12)
    assert found.torque_nm == pytest.approx(-tip_nm, abs=1e-16)


def test_with_friction_the_twist_reaches_t_over_friction_far_and_the_base_feels_the_rest() -> None:
    tip_nm = 5e-4 * TIME_S
    found = solve(build_rod(RUBBED, RIGIDITY_NM2, FRICTION_N, 1e-4), TIME_S, 0.0 * TIME_S, tip_nm)
    most_nm = FRICTION_N * LENGTH_M
    part = tip_nm <= most_nm
    twist_rad = tip_nm**2 / (2.0 * RIGIDITY_NM2 * FRICTION_N)
    assert found.tip_rad[part] == pytest.approx(twist_rad[part], abs=1e-6)
    slips_rad = (tip_nm - 0.5 * most_nm) * LENGTH_M / RIGIDITY_NM2
    assert found.tip_rad[~part] == pytest.approx(slips_rad[~part], abs=1e-6)
    assert found.torque_nm == pytest.approx(-np.maximum(tip_nm - most_nm, 0.0), abs=1e-12)


def test_taken_away_it_leaves_half_of_the_twist_behind() -> None:
    # Masing: unloading follows the first loading, twice as large
    tip_nm = 2e-4 * np.interp(TIME_S, [0.0, 0.5, 1.0], [0.0, 1.0, 0.0])
    found = solve(build_rod(RUBBED, RIGIDITY_NM2, FRICTION_N, 1e-4), TIME_S, 0.0 * TIME_S, tip_nm)
    assert found.tip_rad[-1] == pytest.approx(0.5 * found.tip_rad.max(), rel=2e-3)


@pytest.mark.parametrize("rate", ["none", "viscous", "excess"])
def test_every_integrator_follows_it_while_the_base_stands(rate: str) -> None:
    rod = build_rod(RUBBED, RIGIDITY_NM2, FRICTION_N, 4e-3)
    if rate == "viscous":
        rod = dataclasses.replace(rod, viscous_nms_per_rad=np.where(rod.tissue_length_m > 0, 1e-12, 0.0))
    if rate == "excess":
        rod = dataclasses.replace(rod, static_excess=np.where(rod.tissue_length_m > 0, 1e-9, 0.0))
    tip_nm = 2e-4 * np.sin(2.0 * math.pi * TIME_S)
    found = solve(rod, TIME_S, 0.0 * TIME_S, tip_nm)
    exact = solve(build_rod(RUBBED, RIGIDITY_NM2, FRICTION_N, 4e-3), TIME_S, 0.0 * TIME_S, tip_nm)
    assert found.tip_rad == pytest.approx(exact.tip_rad, abs=2e-4)


def test_a_state_goes_on_under_the_same_load() -> None:
    rod = build_rod(RUBBED, RIGIDITY_NM2, FRICTION_N, 4e-3)
    base_rad, tip_nm = 0.3 * np.sin(3.0 * TIME_S), 2e-4 * np.sin(9.0 * TIME_S)
    whole = solve(rod, TIME_S, base_rad, tip_nm)
    first = solve(rod, TIME_S[:50], base_rad[:50], tip_nm[:50])
    rest = solve(rod, TIME_S[49:], base_rad[49:], tip_nm[49:], state=first.state)
    assert rest.tip_rad == pytest.approx(whole.tip_rad[49:], abs=1e-9)


def test_the_model_takes_it_from_the_trial_and_a_batch_from_its_inputs() -> None:
    tip_nm = 1e-4 * TIME_S
    model = NeedleModel("m", FREE, RIGIDITY_NM2, 0.0)
    seen = model.predict(Trial(TIME_S, 0.0 * TIME_S, tip_torque_nm=tip_nm))
    assert seen.torque_nm == pytest.approx(-tip_nm)
    (batch,) = solve_batch([build_rod(FREE, RIGIDITY_NM2, 0.0)], [(TIME_S, 0.0 * TIME_S, tip_nm)])
    assert batch.torque_nm == pytest.approx(-tip_nm)


def test_what_cannot_act_is_refused() -> None:
    clamped = build_rod(dataclasses.replace(FREE, tip_clamped=True), RIGIDITY_NM2, 0.0)
    with pytest.raises(BadInput, match="clamped"):
        solve(clamped, TIME_S, 0.0 * TIME_S, TIME_S)
    with pytest.raises(BadInput, match="torques on the tip"):
        solve(build_rod(FREE, RIGIDITY_NM2, 0.0), TIME_S, 0.0 * TIME_S, TIME_S[1:])
    with pytest.raises(BadInput, match="tip torque is nan at sample 0"):
        solve(build_rod(FREE, RIGIDITY_NM2, 0.0), TIME_S, 0.0 * TIME_S, np.full(101, math.nan))
