import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from needle_rig.errors import BadInput
from needle_rig.physics.rod import Layout, build_rod
from tests.physics.rods import EXPERIMENT, JG, rod


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((0.4, ((0.1, 0.2), (0.15, 0.3)), ()), "section 2 .* overlaps"),
        ((0.4, ((0.2, 0.3), (0.1, 0.15)), ()), "order from the base"),
        ((0.4, ((0.3, 0.5),), ()), "leaves the needle"),
        ((0.4, ((-0.1, 0.2),), ()), "leaves the needle"),
        ((0.4, ((0.2, 0.2),), ()), "no length"),
        ((0.4, ((0.2, math.nan),), ()), "no length"),
        ((0.4, (), (0.41,)), "sensor 1 at 410 mm is outside"),
        ((0.4, (), (0.1, math.nan)), "sensor 2"),
        ((0.0, (), ()), "must be above 0"),
        ((math.nan, (), ()), "must be above 0"),
    ],
)
def test_impossible_layouts_are_refused(arguments: tuple[Any, Any, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        Layout(*arguments)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"friction_n": -1e-3}, "friction is -0.1 N·mm"),
        ({"friction_n": math.nan}, "friction is nan"),
        ({"torsional_rigidity_nm2": 0.0}, "torsional rigidity"),
        ({"element_length_m": 0.0}, "element length is 0 mm"),
        ({"element_length_m": math.nan}, "element length is nan"),
        ({"element_length_m": -1e-3}, "element length"),
        ({"element_length_m": 1e-9}, "more than"),
    ],
)
def test_impossible_constants_are_refused(change: dict[str, float], message: str) -> None:
    arguments = {"torsional_rigidity_nm2": JG, "friction_n": 1e-3, "element_length_m": 0.5e-3} | change
    with pytest.raises(BadInput, match=message):
        build_rod(EXPERIMENT, **arguments)


@pytest.mark.parametrize(
    "name",
    ["slip_plus_nm", "slip_minus_nm", "compliance_rad_per_nm", "viscous_nms_per_rad", "static_excess"],
)
def test_a_negative_coefficient_names_its_node(name: str) -> None:
    plain = build_rod(EXPERIMENT, JG, 1e-3)
    values = getattr(plain, name).copy()
    values[7] = -1.0
    with pytest.raises(BadInput, match=f"{name} is -1 at node 7"):
        _ = replace(plain, **{name: values}).coefficients
    with pytest.raises(BadInput, match="shape"):
        _ = replace(plain, **{name: values[1:]}).coefficients


@st.composite
def layouts(draw: DrawFn) -> Layout:
    """Any layout: up to four sections, touching or apart, sensors anywhere, coincident with ends or not."""
    cuts = sorted(draw(st.lists(st.integers(0, 80), min_size=2, max_size=8, unique=True)))
    pairs = list(zip(cuts[::2], cuts[1::2], strict=False))
    if draw(st.booleans()) and len(cuts) > 2:
        pairs = [(cuts[0], cuts[1]), (cuts[1], cuts[2])]
    length = (cuts[-1] + draw(st.integers(0, 20))) * 5e-3
    sensors = draw(st.lists(st.floats(0.0, 1.0), max_size=5))
    on_ends = draw(st.lists(st.sampled_from(cuts), max_size=2))
    places = [s * length for s in sensors] + [c * 5e-3 for c in on_ends]
    sections = tuple((a * 5e-3, b * 5e-3) for a, b in pairs)
    return Layout(max(length, cuts[-1] * 5e-3), sections, tuple(min(p, length) for p in places))


@given(layouts(), st.floats(0.3e-3, 20e-3))
def test_a_rod_holds_its_layout_whatever_the_mesh(layout: Layout, element_length_m: float) -> None:
    rod = build_rod(layout, JG, 1e-3, element_length_m)
    _ = rod.coefficients
    position = rod.position_m
    assert position[rod.base] == 0.0
    assert position[rod.tip] == pytest.approx(layout.needle_length_m)
    assert (np.diff(position) > 0).all()
    assert position[rod.sensors] == pytest.approx(np.array(layout.sensor_positions_m), abs=2e-9)
    assert (rod.tissue_length_m[rod.sensors] == 0).all()
    in_tissue = sum(b - a for a, b in layout.tissue_sections_m)
    assert rod.slip_plus_nm.sum() == pytest.approx(1e-3 * in_tissue)
    assert rod.tissue_length_m.max() <= element_length_m * 1.00001
    assert (1 / rod.stiffness_nm_per_rad).sum() == pytest.approx(layout.needle_length_m / JG)
    assert position[rod.entry] == pytest.approx(layout.tissue_sections_m[0][0])
    for number, (start, end) in enumerate(layout.tissue_sections_m):
        inside = rod.section == number
        assert ((position[inside] > start) & (position[inside] < end)).all()
        # friction sits where it acts: the centre of friction of a section is the middle of the section
        centre = (rod.slip_plus_nm[inside] * position[inside]).sum() / rod.slip_plus_nm[inside].sum()
        assert centre == pytest.approx(0.5 * (start + end), rel=1e-9)


@pytest.mark.parametrize(
    ("excess", "weakening_deg", "viscous", "snaps"),
    [(0.0, 0.05, 0.0, False), (0.3, 8.0, 0.0, False), (0.3, 2.0, 0.0, True), (0.25, 0.05, 0.1, True),
     (0.25, 0.05, 0.13, False)],
)  # fmt: skip
def test_a_needle_snaps_where_neither_slip_length_nor_damping_keeps_it(
    excess: float, weakening_deg: float, viscous: float, snaps: bool
) -> None:
    """Exponential at 0.2 rad/s: 0.25 · 0.0996 N·mm per 100 mm falls by 0.1245 N·mm·s per 100 mm at most."""
    made = rod(
        static_excess=excess,
        weakening_rad=np.radians(weakening_deg),
        viscous=viscous,
        stribeck_rate_rad_s=0.2,
        stribeck_exponent=1.0,
    )
    assert made.snaps is snaps
