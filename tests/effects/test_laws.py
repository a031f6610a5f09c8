"""Each law does what it says, against numbers worked out by hand or by another form of the same law."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT, load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Reading, Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout
from tests.effects.common import LIBRARY, SEQUENCE, SHORT, make_effect, path

TURNED = path((0, 0), (2, 90), (3, 90))
JG_NMM2 = 62.56


def settled(model: NeedleModel, trial: Trial = TURNED) -> tuple[float, Array]:
    """Torque (N·mm) and angles (°) at the end of a trial."""
    reading = model.predict(trial)
    return reading.torque_nm[-1] * 1e3, np.degrees(reading.hall_rad[-1])


def sequence(model: NeedleModel, extra_deg: float = 0.0) -> tuple[float, float]:
    """Tip lag (°) after the first motion and after the whole sequence of the paper, lag from equation (9)."""
    speed_deg_s, rest_s, knots = 45.0, 1.0, [(0.0, 0.0)]

    def go(to_deg: float) -> tuple[float, float]:
        at_s, from_deg = knots[-1]
        arrived_s = at_s + max(0.02, abs(to_deg - from_deg) / speed_deg_s)
        knots.extend([(arrived_s, to_deg), (arrived_s + rest_s, to_deg)])
        trial = path(*knots)
        solution = model.truth(
            replace(trial, base_angle_rad=np.r_[trial.base_angle_rad[:-1], np.radians(to_deg)])
        )
        return float(solution.torque_nm[-1] * 1e3), to_deg - float(np.degrees(solution.tip_rad[-1]))

    torque_nmm, first = go(45)
    lag = float(np.degrees(torque_nmm * 285 / (model.torsional_rigidity_nm2 * 1e6)))
    for target in (45 + lag + extra_deg, 45 - 0.75 * lag, 45 + 0.25 * lag):
        go(target)
    return first, go(45)[1]


@pytest.mark.parametrize(
    ("name", "extra_deg", "first_deg", "last_deg"),
    [
        ("rig_rigid", 0, 26.0, 0.0),
        ("rig_elastic", 0, 26.0, 12.0),
        ("rig_elastic", 12, 26.0, 4.9),
        ("stiff_needle", 0, 25.7, 10.8),
    ],
)
def test_the_parameter_sets_meet_the_papers_lags(
    name: str, extra_deg: int, first_deg: float, last_deg: float
) -> None:
    first, last = sequence(load_parameters(name), extra_deg)
    assert first == pytest.approx(first_deg, abs=0.1)
    assert last == pytest.approx(last_deg, abs=0.25)


def test_figure_3_in_the_layout_of_the_simulation() -> None:
    model = load_parameters("figure_3", layout=MODEL_LAYOUT)
    torque_nmm, angles_deg = settled(model, path((0, 0), (1, 45), (2, 45)))
    assert angles_deg[-1] == pytest.approx(33, abs=0.05)
    assert torque_nmm == pytest.approx(0.0582, abs=1e-5)


def test_the_rivals_to_elasticity(coarse: NeedleModel) -> None:
    chuck = replace(coarse, friction_n=0.54e-3).with_effects(make_effect("chuck_compliance", 0.256))
    first, last = sequence(chuck)
    assert first == pytest.approx(26, abs=0.7)
    assert last == pytest.approx(12, abs=0.7)
    assert sequence(chuck, 12)[1] == pytest.approx(0, abs=0.7)


def test_lumped_frictions_twist_what_lies_before_them(coarse: NeedleModel) -> None:
    torque_nmm, angles = settled(coarse)
    for name, upto_mm in (("tip_friction", 397), ("guide_friction", 175)):
        more_nmm, turned = settled(coarse.with_effects(make_effect(name, 0.02)))
        assert more_nmm - torque_nmm == pytest.approx(0.02, abs=1e-6)
        for place_mm, change in zip((220, 285, 350, 396), turned - angles, strict=True):
            assert change == pytest.approx(-np.degrees(0.02 * min(place_mm, upto_mm) / JG_NMM2), abs=1e-4)


def test_platform_friction_adds_up(coarse: NeedleModel) -> None:
    torque_nmm, _ = settled(coarse)
    each = (0.001, 0.002, 0.003, 0.004)
    assert settled(coarse.with_effects(make_effect("platform_friction", each)))[
        0
    ] - torque_nmm == pytest.approx(0.01)


def test_layered_friction_is_friction_by_section(coarse: NeedleModel) -> None:
    by_section = coarse.with_effects(make_effect("layered_friction", (0.3, 0.8, 1.3, 1.6)))
    assert settled(by_section)[0] == pytest.approx(0.025 * 4.0)
    doubled = coarse.with_effects(make_effect("layered_friction", 2.0))
    np.testing.assert_allclose(settled(doubled)[1], settled(replace(coarse, friction_n=2e-3))[1])
    with pytest.raises(BadInput, match=r"layered_friction\.factor: 3 values for 4 sections"):
        coarse.with_effects(make_effect("layered_friction", (1, 2, 3))).predict(SHORT)


def test_friction_differs_by_direction_and_falls_with_travel(coarse: NeedleModel) -> None:
    uneven = coarse.with_effects(make_effect("direction_asymmetry", 0.2))
    back = replace(TURNED, base_angle_rad=-TURNED.base_angle_rad)
    assert settled(uneven)[0] == pytest.approx(0.12)
    assert settled(uneven, back)[0] == pytest.approx(-0.08)
    worn = coarse.with_effects(make_effect("friction_wear", 0.1))
    assert settled(worn, replace(TURNED, travel_before_rad=2 * 2 * np.pi))[0] == pytest.approx(
        0.1 * np.exp(-0.2)
    )
    assert settled(worn, replace(TURNED, travel_before_rad=0.0))[0] == pytest.approx(0.1)


def test_viscous_slip_adds_torque_by_rate(coarse: NeedleModel) -> None:
    slippery = coarse.with_effects(make_effect("viscous_slip", 0.05))
    trial = path((0, 0), (8, 360))
    assert slippery.predict(trial).torque_nm[-1] * 1e3 == pytest.approx(0.1 + 0.05 * np.radians(45), abs=1e-5)


def test_stribeck_peaks_at_a_restart_only(coarse: NeedleModel) -> None:
    trial = path((0, 0), (2, 90), (4, 90), (6, 180), (7, 180))
    peaked = coarse.with_effects(LIBRARY["stribeck"].at_strength(1.0)).predict(trial).torque_nm * 1e3
    plain = coarse.predict(trial).torque_nm * 1e3
    assert (peaked - plain)[trial.time_s > 4].max() > 0.01
    assert abs(peaked[-1] - plain[-1]) < 1e-3


def test_ageing_peaks_grow_with_the_rest_before(coarse: NeedleModel) -> None:
    aged = coarse.with_effects(LIBRARY["stiction_ageing"].at_strength(1.0))
    peaks = []
    for rest_s in (0.5, 20.0):
        trial = path((0, 0), (2, 90), (2 + rest_s, 90), (4 + rest_s, 180))
        torque = aged.predict(trial).torque_nm * 1e3
        peaks.append((torque - coarse.predict(trial).torque_nm * 1e3)[trial.time_s > 2 + rest_s].max())
    assert peaks[1] > 1.5 * peaks[0] > 0


def test_viscoelasticity_becomes_elasticity_at_its_limits(coarse: NeedleModel) -> None:
    solid = partial(make_effect, "tissue_viscoelasticity")
    elastic = coarse.with_effects(make_effect("tissue_elasticity", 0.4)).predict(SHORT)
    for limit in (
        solid(0.4, 0.0, 2.0),  # no relaxing spring
        solid(0.1, 0.3, 1000.0),  # too slow to relax: the glassy stiffness
        solid(0.4, 0.3, 1e-4),  # relaxed at once: the relaxed stiffness
    ):
        reading = coarse.with_effects(limit).predict(SHORT)
        assert np.degrees(np.abs(reading.hall_rad - elastic.hall_rad)).max() < 0.1
        assert np.abs(reading.torque_nm - elastic.torque_nm).max() * 1e3 < 1e-3


def test_maxwell_and_kelvin_voigt_are_limits_without_trouble(coarse: NeedleModel) -> None:
    solid = partial(make_effect, "tissue_viscoelasticity")
    maxwell = [coarse.with_effects(solid(k, 0.35, 2.0)).predict(SHORT).hall_rad for k in (0.0, 1e-9, 1e-5)]
    assert np.degrees(np.abs(maxwell[0] - maxwell[1])).max() < 1e-4
    assert np.degrees(np.abs(maxwell[0] - maxwell[2])).max() < 0.05
    voigt = [coarse.with_effects(solid(0.35, k, 0.7 / k)).predict(SHORT).hall_rad for k in (1e2, 1e3)]
    assert np.degrees(np.abs(voigt[0] - voigt[1])).max() < 0.3


def test_the_standard_linear_solid_relaxes_as_its_law_says() -> None:
    # one cell behind 350 mm of needle: springs and one relaxing element in series, solved by hand
    layout = Layout(0.4, ((0.3, 0.4),), (0.4,))
    solid = make_effect("tissue_viscoelasticity", 0.3, 0.6, 1.5)
    model = NeedleModel("one cell", layout, 62.56e-6, 0.05, (solid,), element_length_m=0.1)
    trial = path((0, 0), (0.02, 60), (8, 60))
    torque_nmm = model.predict(trial).torque_nm * 1e3
    needle, relaxed, relaxing, twist_rad = JG_NMM2 / 350, 0.3, 0.6, np.radians(60)
    # τ = k∞ u + q with u = Θ − τ/needle, dq/dt = k₁ du/dt − q/1.5
    start = twist_rad / (1 / needle + 1 / (relaxed + relaxing))
    end = twist_rad / (1 / needle + 1 / relaxed)
    time_constant_s = 1.5 * (needle + relaxed + relaxing) / (needle + relaxed)
    expected = end + (start - end) * np.exp(-(trial.time_s - 0.01) / time_constant_s)
    np.testing.assert_allclose(torque_nmm[5:], expected[5:], rtol=5e-3)


@given(play_deg=st.floats(0, 20), targets=st.lists(st.integers(-90, 90), min_size=1, max_size=6))
def test_play_follows_at_half_its_width(play_deg: float, targets: list[int]) -> None:
    trial = path(*[(float(i), t) for i, t in enumerate([0.0, *targets])])
    play = make_effect("chuck_backlash", play_deg)
    held_rad = play.drive(trial)
    gap = trial.base_angle_rad - held_rad
    assert np.abs(gap).max() <= np.radians(play_deg) / 2 + 1e-12
    moved = np.diff(held_rad) != 0
    # it moves only at the end of the play, and with the base
    assert np.allclose(np.abs(gap[1:][moved]), np.radians(play_deg) / 2, atol=1e-12)
    assert (np.diff(held_rad)[moved] * np.diff(trial.base_angle_rad)[moved] > 0).all()


def test_a_trial_in_pieces_is_the_whole_trial(coarse: NeedleModel) -> None:
    model = coarse.with_effects(make_effect("chuck_backlash", 6.0), make_effect("tissue_elasticity", 0.5))
    whole = model.truth(SEQUENCE)
    state, torque_nm = None, []
    for first in range(0, SEQUENCE.time_s.size - 1, 37):
        piece = slice(first, first + 38)
        part = replace(SEQUENCE, time_s=SEQUENCE.time_s[piece], base_angle_rad=SEQUENCE.base_angle_rad[piece])
        solution = model.truth(part, state)
        state = solution.state
        torque_nm.append(solution.torque_nm[:-1])
    joined = np.concatenate(torque_nm)
    np.testing.assert_allclose(joined, whole.torque_nm[: joined.size], atol=1e-9)


@pytest.mark.parametrize("deeper_mm", [6.0, -6.0])
def test_insertion_depth_is_the_rod_of_a_moved_layout(model: NeedleModel, deeper_mm: float) -> None:
    d = deeper_mm * 1e-3
    (a, b, c, (start, end)) = EXPERIMENT_LAYOUT.tissue_sections_m
    moved = Layout(
        EXPERIMENT_LAYOUT.needle_length_m,
        (*((low - d, high - d) for low, high in (a, b, c)), (start - d, end)),
        (*(x - d for x in EXPERIMENT_LAYOUT.sensor_positions_m[:3]), 0.396),
    )
    effects = (make_effect("tissue_elasticity", 0.4), make_effect("bending_torque", 0.03, 0.01))
    shifted = model.with_effects(*effects, make_effect("insertion_depth", deeper_mm)).predict(SHORT)
    rebuilt = replace(model, layout=moved).with_effects(*effects).predict(SHORT)
    assert np.degrees(np.abs(shifted.hall_rad - rebuilt.hall_rad)).max() < 0.02
    assert np.abs(shifted.torque_nm - rebuilt.torque_nm).max() * 1e3 < 2e-4


def test_insertion_depth_that_does_not_fit(model: NeedleModel) -> None:
    shallow = replace(
        model, layout=Layout(0.1, ((0.02, 0.09),), (0.1,)), effects=(make_effect("insertion_depth", 30.0),)
    )
    with pytest.raises(BadInput, match="30 mm does not fit a free length of 20 mm"):
        shallow.predict(SHORT)


def test_bending_torque_rests_at_its_angle(coarse: NeedleModel) -> None:
    bent = make_effect("bending_torque", sine_nmm_per_100mm=0.3, cosine_nmm_per_100mm=-0.3)
    rest_rad = np.pi / 4  # tan ψ = −C/A
    assert bent.torque(rest_rad, 0.0, 0.0, 0.2) == pytest.approx(0, abs=1e-15)
    assert bent.torque(rest_rad + 0.1, 0.0, 0.0, 0.2) < 0 < bent.torque(rest_rad - 0.1, 0.0, 0.0, 0.2)
    assert bent.torque(rest_rad + np.pi / 2, 0.0, 0.0, 0.2) == pytest.approx(-np.hypot(0.3, 0.3) * 0.01)
    loose = replace(coarse, friction_n=0.0).with_effects(bent)
    assert settled(loose, path((0, 0), (0.5, 45), (1, 45)))[1] == pytest.approx([45] * 4, abs=1e-3)


def reading(torque_nm: list[float], hall_rad: list[list[float]]) -> Reading:
    time_s = np.linspace(0, 1, len(torque_nm))
    return Reading(
        Trial(time_s, np.zeros_like(time_s), start_s=60.0), np.array(torque_nm), np.array(hall_rad)
    )


def test_sensor_laws() -> None:
    seen = reading([1e-3, 2e-3, 3e-3], [[0.0, 1.0], [0.5, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(
        make_effect("torque_bias", 0.1).observe(seen).torque_nm, [1.1e-3, 2.1e-3, 3.1e-3]
    )
    np.testing.assert_allclose(make_effect("torque_gain", 2).observe(seen).torque_nm, [2e-3, 4e-3, 6e-3])
    drifted = make_effect("torque_drift", 0.06).observe(seen).torque_nm
    np.testing.assert_allclose(drifted, seen.torque_nm + 1e-6 * np.array([60, 60.5, 61]))
    offset = make_effect("hall_offset", (1, -2)).observe(seen).hall_rad
    np.testing.assert_allclose(offset, seen.hall_rad + np.radians([1, -2]))
    stretched = make_effect("hall_gain", (0.1, 0)).observe(seen).hall_rad
    np.testing.assert_allclose(stretched, seen.hall_rad * [1.1, 1])
    swung = make_effect("hall_eccentricity", 3, 2).observe(seen).hall_rad - seen.hall_rad
    expected = np.radians(3) * np.sin(seen.hall_rad) + np.radians(2) * np.cos(seen.hall_rad)
    np.testing.assert_allclose(swung, expected)
    late = make_effect("clock_offset", torque_delay_ms=250, hall_delay_ms=-500).observe(seen)
    np.testing.assert_allclose(late.torque_nm, [1e-3, 1.5e-3, 2.5e-3])
    np.testing.assert_allclose(late.hall_rad[:, 0], [0.5, 1.0, 1.0])


def test_gain_acts_before_what_is_added(coarse: NeedleModel) -> None:
    both = coarse.with_effects(make_effect("torque_bias", 0.1), make_effect("torque_gain", 0.5)).predict(
        SHORT
    )
    np.testing.assert_allclose(both.torque_nm, 0.5 * coarse.predict(SHORT).torque_nm + 1e-4)
