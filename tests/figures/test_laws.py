"""The picture of a learnt curve: where data are and are not, few values, axes in the field's units."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.figures.laws import _covered, _gaps, laws_figure
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.halves import where_seen
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.learnt import LearntLaw

AT = np.linspace(-60.0, 60.0, 121)
SINE = Formula(next(f for f in FORMS if f.name == "sine"), 60.0, -60.0, (0.5, 0.0, 2.0))


def curve(data: Any) -> Curve:
    value = 0.5 * np.sin(np.radians(2.0 * AT))
    spread = np.where(data > 0, 0.05, 50.0)
    half = np.where(AT > 0.0, value, np.nan)
    return Curve(AT, value, value - spread, value + spread, data, (half, value))


def drawn(law: Law, data: Any) -> Any:
    learnt = LearntLaw(law, (), 3.0, 1.0, None, (), curve(data), SINE, None)
    found: Any = SimpleNamespace(laws=(learnt,), origin=SimpleNamespace(dataset="mine"))
    return laws_figure(found).axes


def test_a_stretch_without_data_is_grey_and_a_short_one_is_not() -> None:
    data = np.ones(121)
    data[10:14] = 0.0
    data[50:70] = 0.0
    assert np.array(_gaps(curve(data))) == pytest.approx(np.array([[-10.5, 9.5]]))


def test_the_ends_without_data_are_grey_however_short() -> None:
    data = np.ones(121)
    data[:2] = 0.0
    assert np.array(_gaps(curve(data))[0]) == pytest.approx(np.array([-60.5, -58.5]))


def test_a_variable_with_few_values_is_shown_by_points() -> None:
    data = np.zeros(121)
    data[[20, 100]] = 300.0
    assert _covered(curve(data)).sum() == 2
    axes, _ = drawn(Law("observe", "torque", "direction"), data)
    assert {line.get_marker() for line in axes.lines if "curve" in str(line.get_label())} == {"o"}


def test_the_band_without_data_does_not_set_the_axis() -> None:
    data = np.ones(121)
    data[90:] = 0.0
    axes, below = drawn(Law("torque", "section_3", "angle"), data)
    low, high = axes.get_ylim()
    assert -1.0 < low < -0.5
    assert 0.5 < high < 1.0
    assert axes.get_ylabel() == "torque along the needle / N·mm per 100 mm"
    assert below.get_xlabel() == "the angle of the needle there / ° (grey: no data)"


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (Law("drive", "base", "base_angle"), "needle − encoder / °"),
        (Law("observe", "torque", "rate"), "error of the torque reading / N·mm"),
        (Law("observe", "halls", "angle"), "error of halls / °"),
        (Law("shape", "slip_limit", "x"), "slip limit / that without it − 1"),
        (Law("shape", "stiffness", "x"), "angle before it slips / °"),
    ],
)
def test_the_axis_says_what_the_curve_is(law: Law, said: str) -> None:
    assert drawn(law, np.ones(121))[0].get_ylabel() == said


class Halves:
    """A problem of trials that are their own readings."""

    def __init__(self, trials: Any) -> None:
        self.trials = trials

    def over(self, trials: Any) -> Any:
        return Halves(trials)


def test_a_half_is_shown_where_its_own_trials_have_data() -> None:
    problem: Any = Halves([np.radians([0.4, 30.0]), np.radians([-30.4, 10.4]), np.radians([20.0, 50.4])])
    seen: Any = lambda half, _: np.concatenate(half.trials)  # noqa: E731
    whole = (np.ones(121), np.ones(121))
    first, second = where_seen(problem, Law("observe", "hall_2", "angle"), AT, whole, seen)
    assert AT[np.isfinite(first)] == pytest.approx(np.arange(0.0, 52.0))
    assert AT[np.isfinite(second)] == pytest.approx(np.arange(-31.0, 12.0))
    assert where_seen(problem, Law("observe", "hall_2", "angle"), AT, whole[:1], seen) == whole[:1]
