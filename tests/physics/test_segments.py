"""A shaft of stretches with rigidities of their own."""

import dataclasses

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout, build_rod

PLAIN = Layout(0.4, ((0.2, 0.3),), (0.15, 0.3))
STEPPED = dataclasses.replace(PLAIN, segments=((0.0, 0.1, 4.0), (0.25, 0.3, 0.5)))


def test_springs_of_the_segments_are_in_series() -> None:
    rod = build_rod(STEPPED, 6e-5, 1e-3)

    def between(start: float, end: float) -> float:
        inside = (rod.position_m[:-1] >= start - 1e-9) & (rod.position_m[1:] <= end + 1e-9)
        return float(1.0 / (1.0 / rod.stiffness_nm_per_rad[inside]).sum())

    assert between(0.0, 0.1) == pytest.approx(4.0 * 6e-5 / 0.1)
    assert between(0.1, 0.2) == pytest.approx(6e-5 / 0.1)
    assert between(0.25, 0.3) == pytest.approx(0.5 * 6e-5 / 0.05)
    assert between(0.0, 0.2) == pytest.approx(1.0 / (0.1 / 6e-5 + 0.1 / 24e-5))


def test_segments_as_rigid_as_the_needle_change_nothing() -> None:
    same = dataclasses.replace(PLAIN, segments=((0.0, 0.1, 1.0),))
    time_s = np.linspace(0.0, 4.0, 200)
    trial = Trial(time_s, np.sin(time_s))
    one, other = (NeedleModel("x", layout, 6e-5, 1e-3).predict(trial) for layout in (PLAIN, same))
    assert other.torque_nm == pytest.approx(one.torque_nm, abs=1e-12)
    assert other.hall_rad == pytest.approx(one.hall_rad, abs=1e-9)


def test_friction_of_a_whole_slipping_shaft_does_not_depend_on_the_segments() -> None:
    base = np.linspace(0.0, 6.0, 100)
    trial = Trial(np.linspace(0.0, 10.0, 100), base)
    reading = NeedleModel("x", STEPPED, 6e-5, 1e-3).predict(trial)
    assert reading.torque_nm[-1] == pytest.approx(1e-3 * 0.1)
    # twist before the tissue: 1e-4 N·m over 0.1 m of 4 GJ and 0.1 m of GJ
    assert base[-1] - reading.hall_rad[-1, 0] == pytest.approx(1e-4 * (0.1 / 24e-5 + 0.05 / 6e-5), rel=1e-6)


@pytest.mark.parametrize(
    "segment", [(0.1, 0.1, 2.0), (0.3, 0.5, 2.0), (0.1, 0.2, 0.0), (0.1, 0.2, float("nan"))]
)
def test_segments_that_cannot_be_are_refused(segment: tuple[float, float, float]) -> None:
    with pytest.raises(BadInput, match="segment 1"):
        dataclasses.replace(PLAIN, segments=(segment,))
