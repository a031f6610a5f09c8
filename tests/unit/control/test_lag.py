from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from needle_rig.control.lag import effective_length_m, lag_rad, tissue_length_m, unwinding_rad
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT
from needle_rig.physics.rod import Layout

JG_NM2 = 62.56e-6


def test_the_model_geometry_gives_equation_7() -> None:
    # τ/JG · (l_in + l_out)/2 with l_in 175 mm, l_out 275 mm
    assert effective_length_m(MODEL_LAYOUT) == pytest.approx(0.5 * (0.175 + 0.275))


def test_the_experiment_geometry_gives_equation_9() -> None:
    assert effective_length_m(EXPERIMENT_LAYOUT) == pytest.approx(0.285)


def test_the_paper_s_lag_of_26_degrees() -> None:
    assert math.degrees(lag_rad(0.0996e-3, EXPERIMENT_LAYOUT, JG_NM2)) == pytest.approx(26.0, abs=0.01)


def test_an_untouched_needle_lags_along_all_of_the_free_length() -> None:
    layout = Layout(1.0, ((0.9, 0.9 + 1e-6),), (1.0,))
    assert effective_length_m(layout) == pytest.approx(0.9, abs=1e-6)


def test_up_to_the_entry_all_of_the_torque_is_carried() -> None:
    assert effective_length_m(EXPERIMENT_LAYOUT, 0.1) == pytest.approx(0.1)
    assert effective_length_m(EXPERIMENT_LAYOUT, 0.175) == pytest.approx(0.175)


def test_each_gap_carries_what_lies_beyond_it() -> None:
    before, behind = (effective_length_m(EXPERIMENT_LAYOUT, x) for x in (0.200, 0.240))
    assert behind - before == pytest.approx(0.75 * 0.040)


@st.composite
def layouts(draw: DrawFn) -> Layout:
    cuts = draw(st.lists(st.floats(0.01, 0.2), min_size=2, max_size=12).filter(lambda x: len(x) % 2 == 0))
    places, here = [], 0.0
    for length in cuts:
        here += length
        places.append(here)
    sections = tuple(zip(places[::2], places[1::2], strict=True))
    return Layout(here + draw(st.floats(0.0, 0.1)), sections, (here,))


@given(layouts())
def test_any_layout_agrees_with_the_integral_of_the_carried_torque(layout: Layout) -> None:
    total = tissue_length_m(layout)
    steps = 4000
    width = layout.needle_length_m / steps
    integral = 0.0
    for step in range(steps):
        x = (step + 0.5) * width
        beyond = sum(max(0.0, end - max(start, x)) for start, end in layout.tissue_sections_m)
        integral += beyond / total * width
    assert effective_length_m(layout) == pytest.approx(integral, rel=1e-3)


@given(layouts(), st.floats(-1e-3, 1e-3))
def test_unwinding_agrees_with_masing_on_the_integral(layout: Layout, torque: float) -> None:
    total = tissue_length_m(layout)
    steps = 4000
    width = layout.needle_length_m / steps
    half = 0.0
    for step in range(steps):
        x = (step + 0.5) * width
        before = sum(max(0.0, min(end, x) - start) for start, end in layout.tissue_sections_m)
        half += max(0.0, 0.5 - before / total) * width
    expected = 2.0 * half * torque / JG_NM2
    assert unwinding_rad(torque, layout, JG_NM2) == pytest.approx(expected, rel=2e-3, abs=1e-9)


def test_a_relaxed_shaft_keeps_a_ninth_of_its_lag_in_the_model_geometry() -> None:
    lag = lag_rad(1e-4, MODEL_LAYOUT, JG_NM2)
    assert lag - unwinding_rad(1e-4, MODEL_LAYOUT, JG_NM2) == pytest.approx(lag / 9.0)


def test_a_needle_in_no_tissue_has_no_lag() -> None:
    layout = Layout(0.3, (), (0.1, 0.29))
    assert (
        effective_length_m(layout) == lag_rad(1e-4, layout, 6e-5) == unwinding_rad(1e-4, layout, 6e-5) == 0.0
    )
