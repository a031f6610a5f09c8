"""Forward differences: exact where the function is straight, inside the bounds, of one absolute step."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from needle_rig.numerics import Array, forward_jacobian, rounded

SLOPES = np.array([[1.0, -2.0], [0.5, 3.0], [0.0, 4.0]])


def asked(f: Callable[[Array], Array], x: Array, step: float, *bounds: Array | float) -> tuple[Array, Array]:
    """The Jacobian, and the points at which `f` was asked."""
    points = []

    def watched(at: Array) -> Array:
        points.append(at.copy())
        return f(at)

    return forward_jacobian(watched, x, f(x), step, *bounds), np.array(points)


def test_a_straight_function_has_its_slopes_whatever_the_step() -> None:
    x = np.array([0.3, -7.0])
    for step in (1e-3, 1.0, 50.0):
        found, _ = asked(lambda at: SLOPES @ at, x, step)
        assert found.shape == (3, 2)
        assert found == pytest.approx(SLOPES)


def test_the_step_is_absolute_and_forward() -> None:
    x = np.array([1000.0, 1e-6])
    _, points = asked(lambda at: at, x, 0.25)
    assert points - x == pytest.approx(0.25 * np.eye(2))


def test_x_itself_is_left_as_it_is() -> None:
    x = np.array([1.0, 2.0])
    asked(np.sin, x, 0.1)
    assert x.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("low", "high", "goes_to"),
    [(-5.0, 5.0, 1.5), (-5.0, 1.2, 0.5), (0.9, 1.2, 1.2), (0.7, 1.1, 0.7)],
    ids=["forward", "backward", "to the upper bound", "to the lower bound"],
)
def test_no_point_is_asked_outside_the_bounds(low: float, high: float, goes_to: float) -> None:
    found, points = asked(lambda at: 3.0 * at, np.array([1.0]), 0.5, low, high)
    assert points == pytest.approx(np.array([[goes_to]]))
    assert found == pytest.approx(np.array([[3.0]]))


def test_every_parameter_has_its_own_bounds() -> None:
    _, points = asked(lambda at: at, np.zeros(2), 1.0, np.array([-9.0, -9.0]), np.array([9.0, 0.5]))
    assert points == pytest.approx(np.array([[1.0, 0.0], [0.0, -1.0]]))


@pytest.mark.parametrize("value", [None, math.nan, math.inf, -math.inf])
def test_what_json_has_no_number_for_becomes_null(value: float | None) -> None:
    assert rounded(value, 4) is None


def test_a_number_for_json_is_rounded_to_its_decimals() -> None:
    assert rounded(26.04999, 2) == 26.05
    assert rounded(-12.3456, 1) == -12.3
