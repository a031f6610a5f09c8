"""The needle whose friction is not ours, beside closed forms and, with stiff bristles, beside the solver."""

from typing import Any

import numpy as np
import pytest

from needle_rig.physics.rod import Layout
from needle_rig.physics.solver import solve
from needle_rig.units import deg, nmm, rad
from tests.physics.rods import MODEL, rod
from tests.workbench.foreign_friction import (
    FRICTION_N,
    LAYOUT,
    MOTIONS,
    RIGIDITY_NM2,
    Bristles,
    Hidden,
    Law,
    Measured,
    Path,
    Response,
    dataset,
    of,
    respond,
)

SILENT = Measured(0.0, 0.0, 0.0, 0.0, commands=1, replicates=1)
STATIC = {Law.DAHL: 1.0, Law.LUGRE: 1.0, Law.IWAN: float(sum(1.0 / np.arange(1, 9)))}
"""Stiffness at rest in units of υ/d."""


def path(motion: str) -> Path:
    return MOTIONS[motion](np.random.default_rng(1))


def apart(one: Response, other: Response) -> tuple[float, float]:
    """Largest difference of angles, °, and of torque, N·mm."""
    return deg(np.abs(one.hall_rad - other.hall_rad).max()), nmm(
        np.abs(one.torque_nm - other.torque_nm).max()
    )


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("law", [pytest.param(Law.DAHL, marks=pytest.mark.whole), Law.IWAN])
def test_bristles_of_a_thousandth_of_a_degree_are_the_solvers_rigid_friction(law: Law, motion: str) -> None:
    told = path(motion)
    rigid = solve(rod(), told.time_s, told.base_rad)
    theirs = respond(Bristles(law, rad(0.001)), told.time_s, told.base_rad)
    assert deg(np.abs(rigid.sensor_rad - theirs.hall_rad).max()) < 0.02
    assert nmm(np.abs(rigid.torque_nm - theirs.torque_nm).max()) < 5e-5
    soft = respond(Bristles(law, rad(0.6)), told.time_s, told.base_rad)
    assert deg(np.abs(rigid.sensor_rad - soft.hall_rad).max()) > 0.5


@pytest.mark.parametrize("law", Law)
def test_a_small_first_turn_meets_the_stiffness_of_the_bristles(law: Law) -> None:
    """As of a rod in elastic tissue: docs/explanation/needle-model.md, the slope after a reversal."""
    turn_rad, time_s = rad(1e-4), np.array([0.0, 10.0])
    found = respond(Bristles(law, rad(0.3)), time_s, np.array([0.0, turn_rad]), layout=MODEL, cells=64)
    ((start, end),) = MODEL.tissue_sections_m
    k = STATIC[law] * FRICTION_N / rad(0.3)
    decay_m = np.sqrt(RIGIDITY_NM2 / k)
    slope = 1.0 / (
        start / RIGIDITY_NM2 + 1.0 / (np.sqrt(k * RIGIDITY_NM2) * np.tanh((end - start) / decay_m))
    )
    assert found.torque_nm[-1] / turn_rad == pytest.approx(slope, rel=2e-3)


@pytest.mark.parametrize("law", Law)
def test_a_long_turn_slips_at_the_torque_of_all_tissue(law: Law) -> None:
    rate_rad_s = 0.5
    time_s = np.linspace(0.0, 8.0, 400)
    rated: dict[str, Any] = {"static_excess": 0.1, "stribeck_rate_rad_s": 0.5, "viscous_ns": FRICTION_N / 2.0}
    found = respond(Bristles(law, rad(0.3), **rated), time_s, rate_rad_s * time_s)
    length_m = sum(end - start for start, end in LAYOUT.tissue_sections_m)
    # LuGre's alone knows the rate
    level = 1.0 + 0.1 * np.exp(-1.0) + 0.5 * rate_rad_s if law is Law.LUGRE else 1.0
    assert found.torque_nm[-1] == pytest.approx(level * FRICTION_N * length_m, rel=1e-3)


@pytest.mark.parametrize("deflection_deg", [0.05, 0.6])
@pytest.mark.parametrize("law", Law)
def test_neither_mesh_nor_step_can_be_seen_beside_the_noise(law: Law, deflection_deg: float) -> None:
    told, bristles = path("chirp"), Bristles(law, rad(deflection_deg))
    usual, coarse, fine, quick = (
        respond(bristles, told.time_s, told.base_rad, cells=cells, steps=steps)
        for cells, steps in ((16, None), (4, None), (48, None), (16, 32))
    )
    for other in (fine, quick):
        angle_deg, torque_nmm = apart(usual, other)
        assert angle_deg < 0.01
        assert torque_nmm < 5e-5
    assert apart(coarse, fine)[0] > 4.0 * apart(usual, fine)[0]


@pytest.mark.parametrize("law", Law)
def test_energy_is_lost_and_never_won(law: Law) -> None:
    told = path("to and fro")
    at = np.arange((told.time_s.size - 1) * 20 + 1) / 20.0
    time_s, base_rad = (np.interp(at, np.arange(told.time_s.size), v) for v in (told.time_s, told.base_rad))
    found = respond(Bristles(law, rad(0.3)), time_s, base_rad, steps=1)
    work_j = np.diff(base_rad) * (found.torque_nm[1:] + found.torque_nm[:-1]) / 2.0
    lost_j = work_j - np.diff(found.stored_j)
    assert lost_j.sum() > 10.0 * found.stored_j.max()
    assert lost_j.min() > -1e-5 * lost_j.sum()


def test_friction_at_the_tip_twists_every_span_alike() -> None:
    time_s = np.linspace(0.0, 20.0, 1000)
    base_rad = rad(8.0) * time_s
    alone, having = (
        respond(Bristles(Law.DAHL, rad(0.05)), time_s, base_rad, tip_nm=tip) for tip in (0.0, 3e-5)
    )
    twist = (alone.hall_rad - having.hall_rad)[-1] / np.array(LAYOUT.sensor_positions_m)
    assert twist == pytest.approx(3e-5 / RIGIDITY_NM2, rel=1e-3)


def test_what_is_hidden_stands_in_the_readings() -> None:
    needle = of(Bristles(Law.DAHL, rad(0.3)))
    plain = dataset(needle, "chirp", 3, measured=SILENT).trials[0]
    hidden = Hidden(torque_gain=1.2, hall_offset_deg=(2.0, 0.0, 0.0, -1.0))
    read = dataset(needle, "chirp", 3, hidden, SILENT).trials[0]
    assert read.torque_nm == pytest.approx(1.2 * plain.torque_nm)
    shift_deg = deg(read.hall_rad - plain.hall_rad)
    assert shift_deg == pytest.approx(np.broadcast_to([2.0, 0.0, 0.0, -1.0], shift_deg.shape))
    loose = dataset(needle, "chirp", 3, Hidden(chuck_backlash_deg=3.0), SILENT).trials[0]
    assert loose.base_measured_rad == pytest.approx(plain.base_measured_rad)
    behind = plain.torque_nm - loose.torque_nm
    first = np.flatnonzero(np.abs(plain.torque_nm) > 0.0)[0]
    assert loose.torque_nm[first] == 0.0
    assert np.abs(behind).max() > 1e-6


def test_replicates_share_a_command_and_differ_in_noise() -> None:
    made = dataset(of(Bristles(Law.IWAN, rad(0.1))), "random steps", 5)
    assert sorted(map(len, made.replicates.values())) == [1, 1, 1, 3]
    one, other = (made.trials[k] for k in next(p for p in made.replicates.values() if len(p) == 3)[:2])
    assert np.array_equal(one.phase, other.phase)
    assert not np.array_equal(one.torque_nm, other.torque_nm)


def test_a_layout_of_one_section_is_taken() -> None:
    layout = Layout(0.3, ((0.1, 0.3),), (0.2,))
    time_s = np.linspace(0.0, 10.0, 500)
    found = respond(Bristles(Law.DAHL, rad(0.1)), time_s, rad(10.0) * time_s, layout=layout)
    lag_rad = FRICTION_N / RIGIDITY_NM2 * (0.2 * 0.2 - 0.1**2 / 2.0)
    assert (10.0 * rad(10.0) - found.hall_rad[-1, 0]) == pytest.approx(lag_rad, rel=1e-3)
