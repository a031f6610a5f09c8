"""PySR beside our formulas, by a fake of it: what it is given, what is said, and what its absence says."""

from __future__ import annotations

import builtins
import sys
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.learnt import LearntLaw
from needle_rig.workbench.laws.symbolic import formula_of, regressor

AT = np.linspace(-90.0, 90.0, 19)
SINE = Formula(next(f for f in FORMS if f.name == "sine"), 90.0, -90.0, (0.5, 0.0, 2.0))


class Fake:
    """A regressor that knows one formula."""

    given: Any = None

    def __init__(self, **settings: Any) -> None:
        self.settings = settings

    def fit(self, X: Any, y: Any, weights: Any, variable_names: Any) -> None:
        Fake.given = X, y, weights, variable_names

    def predict(self, X: Any) -> Any:
        return 0.5 * np.sin(2.0 * X[:, 0])

    def get_best(self) -> Any:
        return {"equation": "0.5 * sin(2.0 * v)"}


def law(on: Law, covered: Any) -> LearntLaw:
    value = 0.5 * np.sin(np.radians(2.0 * AT)) + 0.1
    curve = Curve(AT, value, value - 0.098, value + 0.098, np.where(covered, 3, 0), ())
    return LearntLaw(on, (), 3.0, 1.0, None, (), curve, SINE, None)


def test_the_curve_is_given_where_data_are_in_radians_with_its_uncertainty() -> None:
    found = formula_of(Fake, law(Law("observe", "hall_2", "angle"), AT > -30.0))
    inputs, values, weights, names = Fake.given
    assert names == ["v"]
    assert inputs[:, 0] == pytest.approx(np.radians(AT[AT > -30.0]))
    assert values.shape == weights.shape == inputs[:, 0].shape
    assert weights == pytest.approx((0.098 / 1.96) ** -2)
    assert found.error == pytest.approx(0.1 / 0.05)
    assert found.sentence() == "PySR: 0.5 * sin(2.0 * v), v in radians; 2.0 × the curve's uncertainty off"


def test_what_is_no_angle_is_given_as_it_is() -> None:
    found = formula_of(Fake, law(Law("observe", "torque", "clock"), AT > -100.0))
    assert Fake.given[0][:, 0] == pytest.approx(AT)
    assert "radians" not in found.sentence()


def test_a_curve_without_any_width_has_weights_all_the_same() -> None:
    bare = law(Law("observe", "torque", "clock"), AT > -100.0)
    curve = Curve(AT, 0.0 * AT, 0.0 * AT, 0.0 * AT, bare.curve.data, ())
    formula_of(Fake, LearntLaw(bare.law, (), 3.0, 1.0, None, (), curve, SINE, None))
    assert np.isfinite(Fake.given[2]).all()


def test_without_pysr_one_sentence_says_how_to_get_it(monkeypatch: Any) -> None:
    monkeypatch.setitem(sys.modules, "pysr", None)
    with pytest.raises(BadInput, match=r"pip install .*\[pysr\]"):
        regressor()


def test_without_julia_one_sentence_says_so(monkeypatch: Any) -> None:
    real = builtins.__import__

    def no_julia(name: str, *rest: Any) -> Any:
        if name == "pysr":
            raise OSError("unreachable")
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", no_julia)
    with pytest.raises(BadInput, match="Julia cannot be had") as said:
        regressor()
    assert "\n" not in str(said.value)


def test_where_pysr_is_there_it_is_taken(monkeypatch: Any) -> None:
    module = ModuleType("pysr")
    module.PySRRegressor = Fake  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "pysr", module)
    assert regressor() is Fake
