from typing import Any

import numpy as np
import pytest

from needle_rig.workbench.laws.formulas import FORMS, Form, Formula, ranked, scaled_size, spelled
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.spline import Quadratic, Spline
from needle_rig.workbench.laws.spline_effect import SplineLaw

ANGLE = Law("observe", "hall_2", "angle")
FAMILY = Spline(-60.0, 90.0, 16, 1.0, np.inf)
AT = np.random.default_rng(1).uniform(-55.0, 85.0, 400)
SIGMA = 0.02
PRICE = 3.7
BY_NAME = {form.name: form for form in FORMS}


def ranking(values: Any, law: Any = ANGLE) -> Any:
    noisy = values + SIGMA * np.random.default_rng(2).standard_normal(values.size)
    basis = FAMILY.basis(AT)
    quadratic = Quadratic(basis.T @ basis / SIGMA**2, basis.T @ noisy / SIGMA**2)
    return ranked(SplineLaw(law, FAMILY, "law"), quadratic, quadratic.fall(np.eye(FAMILY.count))[1], PRICE)


def test_a_form_of_which_the_data_see_nothing_is_left_out() -> None:
    quadratic = Quadratic(np.zeros((FAMILY.count, FAMILY.count)), np.zeros(FAMILY.count))
    assert ranked(SplineLaw(ANGLE, FAMILY, "law"), quadratic, np.zeros(FAMILY.count), PRICE) == []


@pytest.mark.parametrize(
    ("form", "values"),
    [
        ("sine", 0.3 * np.sin(np.radians(2.0 * AT))),
        ("line", AT / 90.0),
        ("square", (AT / 90.0) ** 2),
        ("cube", (AT / 90.0) ** 3),
        ("line beyond", 0.02 * np.maximum(AT - 40.0, 0.0)),
        ("dead zone", np.sign(AT) * np.maximum(np.abs(AT) - 20.0, 0.0) / 90.0),
        ("exponential", np.exp(-(AT + 60.0) / 40.0)),
        ("constant", np.full_like(AT, 0.4)),
    ],
)
def test_the_form_that_made_a_curve_is_the_shortest_description_of_it(form: Any, values: Any) -> None:
    first = ranking(values)[0].formula
    assert first.form.name.removeprefix("constant and ") == form
    assert np.sqrt(np.mean((first.at(AT) - values) ** 2)) < 0.1 * np.abs(values).max()


def test_a_constant_beside_a_line_is_said_where_there_is_one() -> None:
    assert ranking(0.4 + AT / 90.0)[0].formula.form.name == "constant and line"


def test_a_factor_whose_logarithm_was_fitted_is_described_by_what_it_differs_from_one() -> None:
    for height in (-0.6, 4.0):
        bump = height * np.exp(-(((AT - 20.0) / 30.0) ** 2))
        first = ranking(np.log1p(bump), Law("shape", "rigidity", "x"))[0].formula
        assert first.form.name == "bump"
        assert np.abs(first.at(AT) - bump).max() < 0.1 * abs(height)


def test_a_sine_is_said_of_angles_alone() -> None:
    of_torque = Law("observe", "hall_2", "torque")
    names = [row.formula.form.name for row in ranking(0.3 * np.sin(np.radians(2.0 * AT)), of_torque)]
    assert not [name for name in names if "sine" in name]


def test_noise_is_described_by_nothing_for_less_than_its_price() -> None:
    assert ranking(np.zeros_like(AT))[0].cost > -6.0


def test_a_coefficient_of_next_to_nothing_has_a_size_all_the_same() -> None:
    formula = Formula(BY_NAME["sine"], 90.0, -60.0, (2.0, 1e-9, 2.0))
    assert scaled_size(formula, "sine") == 2.0
    assert scaled_size(formula, "cosine") == pytest.approx(0.04)


def test_every_form_is_spelled_with_its_fields_and_no_other_name() -> None:
    for form in FORMS:
        told = dict.fromkeys((*form.coefficients, *(name for name, _ in form.shapes)), 0.7)
        formula = Formula(form, 90.0, -60.0, tuple(told.values()))
        text = spelled(form, "np")
        names = {"np": np, "self": type("Effect", (), told), "v": AT, "reach": 90.0, "low": -60.0}
        value = eval(text, {"__builtins__": {"abs": abs}}, {**names, "RAD": np.pi / 180.0})
        assert np.broadcast_to(value, AT.shape) == pytest.approx(formula.at(AT))


def test_a_field_whose_name_is_part_of_another_word_is_left_alone() -> None:
    form = Form("odd", "at * atan_like + sin(at)", ("at",))
    assert spelled(form, "math") == "self.at * atan_like + math.sin(self.at)"


@pytest.mark.parametrize("law", [Law("drive", "base", "base_angle"), Law("shape", "slip_limit", "x")])
def test_a_constant_that_nothing_can_see_is_not_said(law: Any) -> None:
    assert not [r for r in ranking(0.4 + AT / 90.0, law) if r.formula.form.has_constant]


def test_a_place_and_a_width_between_those_of_the_grid_are_found() -> None:
    first = ranking(0.5 * np.exp(-(((AT - 21.3) / 13.7) ** 2)))[0].formula
    assert first.form.name == "bump"
    assert first.parameters["at"] == pytest.approx(21.3, abs=0.2)
    assert first.parameters["width"] == pytest.approx(13.7, rel=0.05)
