"""A stretch of zeros that was never measured is asked; a shaft at rest is not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needle_rig.importing import guess, read_recording
from needle_rig.importing.guess.dropouts import dropout
from needle_rig.numerics import Array
from tests.importing.machines import Joint, swings

TIME_S, ANGLE_RAD, RATE_RAD_S = swings()
TORQUE_NM = Joint().torque_nm(ANGLE_RAD, RATE_RAD_S, np.random.default_rng(4))


def zeroed(values: Array, begin: int, end: int, edge: float = 0.0) -> Array:
    values = values.copy()
    values[begin:end] = 0.0
    if edge:
        values[end] = edge
    return values


@pytest.mark.parametrize(("begin", "end"), [(200, 400), (0, 300), (len(TIME_S) - 300, len(TIME_S))])
@pytest.mark.parametrize("edge", [0.0, 2e-315, 3e-5])
def test_zeros_between_noise_are_a_dropout(begin: int, end: int, edge: float) -> None:
    if end == len(TIME_S) and edge:
        end -= 1
    found = dropout(zeroed(TORQUE_NM, begin, end, edge), ANGLE_RAD)
    assert found is not None
    assert abs(found[0] - begin) <= 1
    assert abs(found[1] - end) <= 1


def test_an_angle_that_jumps_to_zeros_drops_out() -> None:
    noisy = ANGLE_RAD + 1e-3 * np.random.default_rng(5).standard_normal(len(TIME_S))
    noisy[:50:2] = np.nan
    high = int(np.argmax(np.abs(ANGLE_RAD)))
    assert dropout(zeroed(noisy, high, high + 200)) == (high, high + 200)


@pytest.mark.parametrize(
    "values",
    [
        TORQUE_NM,
        np.round(TORQUE_NM, 2),
        np.concatenate((np.zeros(500), np.round(ANGLE_RAD - ANGLE_RAD[0], 3))),  # an encoder at rest
        np.repeat([0.0, 30.0, -30.0, 0.0, 90.0], 200),  # commands
        np.repeat([0.0, 30.0], 200),
        np.zeros(300),
        np.array([0.0] * 9 + [1.0, 2.0]),
        np.full(100, np.nan),
    ],
    ids=["noise", "coarse", "rest", "commands", "step", "still", "few", "empty"],
)
def test_what_rests_or_steps_is_none(values: Array) -> None:
    assert dropout(values) is None


def test_a_torque_before_the_base_moves_is_none() -> None:
    still = np.concatenate((np.zeros(500), TORQUE_NM - TORQUE_NM[0]))
    base = np.concatenate((np.full(500, ANGLE_RAD[0]), ANGLE_RAD))
    assert dropout(still, base) is None
    assert dropout(still, np.full(len(still), np.nan)) is None


@pytest.mark.parametrize("zero", [True, False])
def test_a_guess_asks_about_it(tmp_path: Path, zero: bool) -> None:
    torque = zeroed(TORQUE_NM, 300, 700) if zero else TORQUE_NM
    rows = np.column_stack((TIME_S, np.degrees(ANGLE_RAD), torque))
    file = tmp_path / "joint.csv"
    np.savetxt(file, rows, "%.6f", ",", header="time_s,motor angle [deg],torque [Nm]", comments="")
    mapping = guess([read_recording(file)], "joint", None, Path(), machine="joint")
    asked = [doubt for doubt in mapping.doubts() if "it is 0 from 1.5 s to 3.495 s" in doubt]
    assert len(asked) == zero
    assert all(doubt.startswith("base_torque") for doubt in asked)
