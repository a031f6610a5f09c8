"""Against closed forms: rigid tissue, uniform friction, one section."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.physics import closed_form
from needle_rig.physics.rod import Layout
from needle_rig.physics.solver import solve
from tests.physics.rods import EXPERIMENT, JG, MODEL, path, rod

CLOSE_RAD = 1e-6
FREE, TISSUE = 0.175, 0.1
UPSILON = 0.0582e-2


def turned(*targets_rad: float, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Base torque and tip angle after turning the relaxed figure-3 rod through `targets_rad`."""
    base = np.array([0.0, *targets_rad])
    solution = solve(rod(friction=0.0582, layout=MODEL, **options), np.arange(len(base), dtype=float), base)
    return solution.torque_nm, solution.tip_rad


@given(st.floats(0.02, 0.99))
def test_a_first_turn_follows_the_virgin_curve(part: float) -> None:
    full = closed_form.virgin_base_angle_rad(UPSILON * TISSUE, FREE, UPSILON, JG)
    torque, tip = turned(part * full)
    exact = closed_form.virgin_torque_nm(part * full, FREE, TISSUE, UPSILON, JG)
    # in terms of angle: what the base would have to turn for the torque that was found
    assert closed_form.virgin_base_angle_rad(torque[1], FREE, UPSILON, JG) == pytest.approx(
        part * full, abs=CLOSE_RAD
    )
    assert torque[1] == pytest.approx(exact, abs=CLOSE_RAD * JG / FREE)
    assert abs(tip[1]) < 1e-9


@given(st.floats(0.3, 3.0), st.floats(0.02, 0.98))
def test_a_reversal_is_the_virgin_curve_twice_as_large(start_rad: float, part: float) -> None:
    wound = UPSILON * TISSUE
    full = closed_form.reversal_angle_rad(2 * wound, FREE, UPSILON, JG)
    torque, _ = turned(start_rad, start_rad - part * full)
    assert torque[1] == pytest.approx(wound, rel=1e-9)
    assert closed_form.reversal_angle_rad(wound - torque[2], FREE, UPSILON, JG) == pytest.approx(
        part * full, abs=CLOSE_RAD
    )


def test_lag_at_full_slip_is_equation_7_and_9() -> None:
    _, tip = turned(math.pi / 4)
    lag = closed_form.full_slip_lag_rad(FREE, TISSUE, UPSILON, JG)
    assert math.pi / 4 - tip[1] == pytest.approx(lag, abs=CLOSE_RAD)
    assert lag == pytest.approx(
        closed_form.lag_in_tissue_rad(TISSUE, UPSILON, JG)
        + closed_form.lag_in_free_length_rad(UPSILON * TISSUE, FREE, JG)
    )
    solution = solve(rod(), *path([45]))
    ninth = closed_form.sections_lag_rad(0.0996e-3, EXPERIMENT.tissue_sections_m, JG)
    assert math.pi / 4 - solution.tip_rad[-1] == pytest.approx(ninth, abs=CLOSE_RAD)
    assert ninth == pytest.approx(0.0996e-3 * 0.285 / JG)
    assert solution.torque_nm[-1] == pytest.approx(0.0996e-3, rel=1e-9)


def test_lag_at_zero_torque_is_a_ninth() -> None:
    lag = closed_form.full_slip_lag_rad(FREE, TISSUE, UPSILON, JG)
    back = closed_form.reversal_angle_rad(UPSILON * TISSUE, FREE, UPSILON, JG)
    torque, tip = turned(math.pi / 4, math.pi / 4 - back)
    relaxed = closed_form.relaxed_lag_rad(TISSUE, UPSILON, JG)
    assert torque[2] == pytest.approx(0.0, abs=CLOSE_RAD * JG / FREE)
    assert math.pi / 4 - back - tip[2] == pytest.approx(relaxed, abs=CLOSE_RAD)
    assert relaxed == pytest.approx(lag / 9)


def test_three_moves_leave_neither_lag_nor_torque() -> None:
    lag = closed_form.full_slip_lag_rad(FREE, TISSUE, UPSILON, JG)
    share = (FREE + 0.375 * TISSUE) / (FREE + 0.5 * TISSUE)
    target = math.pi / 4
    torque, tip = turned(target + lag, target + lag * (1 - 1.5 * share), target)
    assert tip[-1] == pytest.approx(target, abs=CLOSE_RAD)
    assert torque[-1] == pytest.approx(0.0, abs=CLOSE_RAD * JG / FREE)


@pytest.mark.parametrize("stiffness", [0.05, 0.28, 1.0, 5.0, math.inf])
def test_slope_after_a_reversal_in_elastic_tissue(stiffness: float) -> None:
    small = 1e-4
    torque, _ = turned(2.0, 2.0 - small, stiffness=stiffness)
    exact = closed_form.elastic_reversal_slope_nm_per_rad(FREE, TISSUE, stiffness * 1e-2, JG)
    # rigid tissue starts to slip at once, so its secant lies below the slope by about υ-dependent 1 %
    tolerance = 1e-4 if math.isfinite(stiffness) else 0.02
    assert (torque[1] - torque[2]) / small == pytest.approx(exact, rel=tolerance)


@pytest.mark.parametrize(("free_m", "viscous"), [(0.175, 2.8), (0.05, 0.5)])
def test_viscous_slip_relaxes_with_its_slowest_time_constant(free_m: float, viscous: float) -> None:
    layout = Layout(free_m + TISSUE, ((free_m, free_m + TISSUE),), (free_m + TISSUE,))
    constant = closed_form.slowest_relaxation_s(free_m, TISSUE, viscous * 1e-2, JG)
    time = np.linspace(0.0, 4 * constant, 400)
    base = np.minimum(time / time[1], 1.0)
    # without dry friction the tip ends at the base's angle, and lags by one exponential late on
    solution = solve(rod(friction=0.0, viscous=viscous, layout=layout), time, base, tolerance_rad=1e-6)
    lag = 1.0 - solution.tip_rad
    late = time > 1.5 * constant
    slope = np.polyfit(time[late], np.log(lag[late]), 1)[0]
    assert -1 / slope == pytest.approx(constant, rel=1e-3)
    if (free_m, viscous) == (0.175, 2.8):
        assert constant == pytest.approx(9.4, abs=0.05)
