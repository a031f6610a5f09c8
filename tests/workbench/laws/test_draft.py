"""Drafted effect files: the contract of effects, and the same law as the curve that was fitted."""

import dataclasses
from typing import Any

import numpy as np
import pytest

from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.physics.library import load_effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.laws.draft import Origin, Table, formula_text, source, written
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.law import Law, every_law
from needle_rig.workbench.laws.spline import Spline
from needle_rig.workbench.laws.spline_effect import SplineLaw
from tests.effects import test_contract as contract
from tests.effects.common import SHORT

ORIGIN = Origin("mine", "ab" * 32, "2026-11-23")
SECTIONS_M = EXPERIMENT_LAYOUT.tissue_sections_m
BY_NAME = {form.name: form for form in FORMS}
SIZES = {"N·mm per 100 mm": 0.05, "N·mm": 0.01, "°": 3.0, "1": 0.4}
SINE = Formula(BY_NAME["sine"], 90.0, -45.0, (0.05, 0.01, 2.0))


@pytest.fixture
def coarse() -> Any:
    model = NeedleModel("null", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3)
    return dataclasses.replace(model, element_length_m=2.5e-3)


def bump(law: Any) -> Any:
    ranges = {"°": (20.0, 30.0), "°/s": (20.0, 30.0), "N·mm": (0.05, 0.05), "mm": (250.0, 60.0)}
    at, width = ranges.get(law.variable_unit, (2.0, 4.0))
    if law.variable in ("clock", "travel"):
        at, width = 100.0, 500.0
    return Formula(BY_NAME["bump"], 4.0 * width, -width, (SIZES[law.unit], at, width))


def drafted(folder: Any, law: Any, curve: Any, name: Any = "found") -> Any:
    return load_effect(written(folder / f"{name}.py", law, curve, ORIGIN, SECTIONS_M))


EVERY = (*every_law(1, 1), Law("observe", "halls", "angle"), Law("torque", "section_3", "angle"))


@pytest.mark.parametrize("law", EVERY, ids=lambda law: law.name)
def test_the_draft_of_every_law_meets_the_contract_of_effects(law: Any, coarse: Any, tmp_path: Any) -> None:
    effect = drafted(tmp_path, law, bump(law))
    contract.test_off_leaves_the_model_bit_for_bit(effect, coarse)
    contract.test_hooks_themselves_do_nothing_at_off(effect, coarse)
    contract.test_a_little_of_it_changes_little(effect, coarse)
    contract.test_parameters_are_fully_described(effect)
    contract.test_text_has_law_source_and_experiment(effect)
    contract.test_values_out_of_bounds_are_refused(effect)
    contract.test_effects_do_not_know_each_other(effect)


@pytest.mark.parametrize("law", EVERY[::4], ids=lambda law: law.name)
def test_the_draft_of_a_table_meets_the_contract_of_effects(law: Any, coarse: Any, tmp_path: Any) -> None:
    table = Table(np.linspace(-40.0, 300.0, 61), SIZES[law.unit] * np.cos(np.linspace(0.0, 3.0, 61)))
    effect = drafted(tmp_path, law, table)
    contract.test_off_leaves_the_model_bit_for_bit(effect, coarse)
    contract.test_hooks_themselves_do_nothing_at_off(effect, coarse)
    contract.test_parameters_are_fully_described(effect)
    contract.test_text_has_law_source_and_experiment(effect)


SAME = (
    Law("observe", "torque", "torque"),
    Law("observe", "hall_2", "angle"),
    Law("observe", "halls", "twist"),
    Law("observe", "hall_3", "stop_time"),
    Law("drive", "base", "base_angle"),
    Law("drive", "base", "travel"),
    Law("drive", "base", "travel", "forward"),
    Law("observe", "torque", "clock", "gain"),
    Law("observe", "hall_2", "clock", "gain"),
    Law("observe", "hall_3", "angle", "play", 4.0),
    Law("shape", "slip_limit", "x"),
    Law("shape", "slip_limit", "clock"),
    Law("shape", "stiffness", "x"),
    Law("shape", "rigidity", "x"),
    Law("torque", "tissue", "x"),
    Law("torque", "section_3", "angle"),
)


@pytest.mark.parametrize(
    "law",
    [pytest.param(law, marks=pytest.mark.whole if law.hook == "torque" else ()) for law in SAME],
    ids=lambda law: law.name,
)
def test_a_curve_acts_alike_as_a_spline_and_as_the_table_of_its_draft(
    law: Any, coarse: Any, tmp_path: Any
) -> None:
    low, high = {"mm": (0.0, 400.0), "N·mm": (-0.3, 0.3), "s": (-1.0, 200.0)}.get(
        law.variable_unit, (-90.0, 120.0)
    )
    made = SplineLaw(law, Spline(low, high, 9, SIZES[law.unit], 1.0), "curve")
    z = made.scaled_values(SIZES[law.unit] * np.random.default_rng(4).uniform(0.2, 1.0, 9))
    spline = made.effect()(**{f"z{k}": float(v) for k, v in enumerate(z)})
    at = np.linspace(low, high, 401)
    table = drafted(tmp_path, law, Table(at, made.curve(made.coefficients(z), at)))
    one, other = (coarse.with_effects(e).predict(SHORT) for e in (spline, table(strength=1.0)))
    nothing = coarse.predict(SHORT)
    assert contract.distance(one, nothing) > 0.3
    assert contract.distance(one, other) < 0.02 * contract.distance(one, nothing) + 0.02


def test_the_file_says_where_it_was_learnt_and_what_the_law_is() -> None:
    text = source("slit", Law("torque", "section_3", "angle"), SINE, ORIGIN, SECTIONS_M)
    assert "learnt from mine, sha256 abababababababab, 2026-11-23" in " ".join(text.split())
    assert "class Slit(Effect):" in text
    assert "sine_nmm_per_100mm" in text
    assert all(len(line) <= 110 for line in text.splitlines())


def test_a_formula_is_told_with_its_numbers() -> None:
    assert formula_text(SINE) == "0.05 · sin(2 · v) + 0.01 · cos(2 · v)"


def test_a_negative_coefficient_is_told_by_its_sign_alone() -> None:
    told = formula_text(dataclasses.replace(SINE, values=(0.05, -0.01, 2.0)))
    assert told == "0.05 · sin(2 · v) − 0.01 · cos(2 · v)"


def test_a_spline_of_a_factor_stays_positive_and_one_of_give_is_none_below_zero() -> None:
    far = np.array([-1e3, -1.0, 0.0, 1.0, 1e3])
    factor = SplineLaw(Law("shape", "slip_limit", "x"), Spline(0.0, 400.0, 9, 1.0, 1.0), "factor")
    assert (factor.linked(far) > -1.0).all()
    assert np.isfinite(factor.linked(far)).all()
    near = np.array([-0.7, 0.0, 3.0])
    assert factor.linked(factor.unlinked(near)) == pytest.approx(near)
    give = SplineLaw(Law("shape", "stiffness", "x"), factor.spline, "give")
    assert give.linked(far) == pytest.approx(np.maximum(far, 0.0))
