from collections.abc import Callable, Sequence

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.workbench.estimation.derivatives import directional_derivatives

MATRIX = np.array([[1.0, -2.0], [0.5, 3.0], [4.0, 0.0]])
LOW, HIGH = np.array([-1.0, -1.0]), np.array([1.0, 1.0])


def taken(
    x: Array, directions: Array, steps: Sequence[float], values: Callable[[Array], Array | None]
) -> tuple[Array | None, list[Array]]:
    asked = []

    def watched(at: Array) -> Array | None:
        asked.append(at - x)
        return values(at)

    found = directional_derivatives(watched, x, MATRIX @ x, directions, np.array(steps), LOW, HIGH)
    return found, asked


def test_derivatives_of_a_linear_function_are_its_matrix_along_the_directions() -> None:
    directions = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    found, asked = taken(np.array([0.2, 0.3]), directions, [0.01, -0.02, 0.01], lambda x: MATRIX @ x)
    assert found == pytest.approx(MATRIX @ directions.T)
    assert np.array(asked) == pytest.approx(np.array([[0.01, 0.0], [0.0, -0.02], [0.01, 0.01]]))


@pytest.mark.parametrize(
    ("x", "step", "went"), [(0.995, 0.01, -0.01), (-0.995, -0.01, 0.01), (0.5, 0.01, 0.01)]
)
def test_a_step_that_would_leave_the_bounds_goes_the_other_way(x: float, step: float, went: float) -> None:
    found, asked = taken(np.array([x, 0.0]), np.eye(1, 2), [step], lambda x: MATRIX @ x)
    assert found == pytest.approx(MATRIX[:, :1])
    assert [a[0] for a in asked] == pytest.approx([went])


def test_a_step_to_where_there_are_no_values_goes_the_other_way() -> None:
    found, asked = taken(np.zeros(2), np.eye(2), [0.01, 0.01], lambda x: None if x[1] > 0 else MATRIX @ x)
    assert found == pytest.approx(MATRIX)
    assert [a[1] for a in asked] == pytest.approx([0.0, 0.01, -0.01])


def test_without_values_on_either_side_there_are_no_derivatives() -> None:
    assert taken(np.zeros(2), np.eye(2), [0.01, 0.01], lambda x: None if x[1] else MATRIX @ x)[0] is None
