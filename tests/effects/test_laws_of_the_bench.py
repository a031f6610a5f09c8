"""What sits around the needle, each law against a closed form or a small model of another kind."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import lsq_linear

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial
from needle_rig.physics.needle_model import NeedleModel, shown
from needle_rig.physics.rod import Layout
from needle_rig.simulation.drive.base_drive import LAG_S, Motion, base_path
from needle_rig.units import rad
from tests.effects.common import LIBRARY, SEQUENCE, SHORT, make_effect, path

JG_NM2 = 62.56e-6
TURNED = path((0, 0), (2, 90), (3, 90))


def torque_through(effect: Effect, trial: Trial, torque_nm: Array | float = 0.0) -> Array:
    """What the cell shows of `torque_nm`, N·mm."""
    torque = np.broadcast_to(np.asarray(torque_nm, dtype=float), trial.time_s.shape).copy()
    return effect.observe(Reading(trial, torque, np.zeros((trial.time_s.size, 0)))).torque_nm * 1e3


def hall_through(effect: Effect, hall_deg: list[list[float]]) -> Array:
    hall_rad = rad(np.array(hall_deg, dtype=float))
    still = Trial(np.arange(len(hall_rad), dtype=np.float64), np.zeros(len(hall_rad)))
    return np.degrees(effect.observe(Reading(still, np.zeros(len(hall_rad)), hall_rad)).hall_rad)


def uneven(end_s: float, samples: int, seed: int = 4) -> Array:
    return np.sort(np.r_[0.0, np.random.default_rng(seed).uniform(0.0, end_s, samples - 2), end_s])


def test_inertia_shows_the_acceleration_of_the_drive() -> None:
    # a ramp through two equal lags L accelerates by v t/L² e^(−t/L)
    speed_rad_s, inertia_gcm2 = 1.5, 25.0
    time_s = np.linspace(0.0, 1.2, 1201)
    trial = Trial(time_s, base_path((Motion("turn", 0.1, 0.0, 1e3, speed_rad_s, 0.0),), time_s))
    seen_nmm = torque_through(make_effect("chuck_inertia", inertia_gcm2), trial)
    since_s = np.maximum(time_s - 0.1, 0.0)
    alpha_rad_s2 = speed_rad_s * since_s / LAG_S**2 * np.exp(-since_s / LAG_S)
    np.testing.assert_allclose(seen_nmm[1:-1], inertia_gcm2 * 1e-7 * alpha_rad_s2[1:-1] * 1e3, atol=3e-4)
    assert seen_nmm.max() == pytest.approx(inertia_gcm2 * 1e-4 * speed_rad_s / LAG_S / np.e, rel=1e-3)


def test_inertia_takes_the_change_of_momentum_however_uneven_the_samples() -> None:
    time_s = uneven(2.0, 90)
    angle_rad = 0.4 * np.sin(2.5 * time_s) + 0.2 * time_s
    seen_nm = torque_through(make_effect("chuck_inertia", 30.0), Trial(time_s, angle_rad)) * 1e-3
    rate_rad_s = np.diff(angle_rad) / np.diff(time_s)
    around_s = 0.5 * (time_s[2:] - time_s[:-2])
    impulse_nms = np.sum(seen_nm[1:-1] * around_s)
    assert impulse_nms == pytest.approx(30e-7 * (rate_rad_s[-1] - rate_rad_s[0]), rel=1e-9)


def test_drag_is_dry_and_viscous_while_turning_and_dry_at_rest() -> None:
    drag = make_effect("bearing_drag", torque_nmm=0.03, viscous_nmms_per_rad=0.02, presliding_deg=4.0)
    trial = path((0, 0), (1, 0), (3, 90), (5, 90), (6, 60), (7, 60), rate_hz=100)
    seen_nmm = torque_through(drag, trial)
    at = {t: seen_nmm[int(np.searchsorted(trial.time_s, t - 1e-6))] for t in (0.5, 2.0, 4.0, 5.5, 6.5)}
    assert at[0.5] == 0.0
    assert at[2.0] == pytest.approx(0.03 + 0.02 * np.radians(45))
    assert at[4.0] == pytest.approx(0.03)
    assert at[5.5] == pytest.approx(-0.03 - 0.02 * np.radians(30))
    assert at[6.5] == pytest.approx(-0.03)


def test_drag_builds_up_over_the_presliding_angle() -> None:
    drag = make_effect("bearing_drag", torque_nmm=0.03, presliding_deg=4.0)
    trial = path((0, 0), (1, 3), (2, 10), (3, 7), (4, 0))
    seen_nmm = torque_through(drag, trial)[[50, 100, 150, 200]]
    np.testing.assert_allclose(seen_nmm, np.array([0.75, 1.0, 0.25, -1.0]) * 0.03, atol=1e-12)


def test_the_low_pass_answers_as_its_differential_equation() -> None:
    time_s = uneven(1.0, 60)
    torque_nm = 1e-4 * np.interp(time_s, [0.0, 0.2, 0.5, 0.6, 1.0], [0.2, 1.0, 1.0, -0.8, -0.5])
    smoothed_nmm = torque_through(
        make_effect("torque_low_pass", 80.0), Trial(time_s, np.zeros_like(time_s)), torque_nm
    )

    def slope(t: float, y: Array) -> Array:
        return (np.interp(t, time_s, torque_nm) * 1e3 - y) / 0.08

    followed = solve_ivp(
        slope, (0.0, 1.0), [torque_nm[0] * 1e3], t_eval=time_s, max_step=1e-3, rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(smoothed_nmm, followed.y[0], atol=1e-7)


def test_the_low_pass_is_a_delay_for_even_torque() -> None:
    time_s = np.linspace(0, 2, 101)
    still = Trial(time_s, np.zeros_like(time_s))
    smoothed_nmm = torque_through(make_effect("torque_low_pass", 50.0), still, 1e-4 * time_s)
    np.testing.assert_allclose(smoothed_nmm[50:], 0.1 * (time_s[50:] - 0.05), atol=1e-9)


@pytest.mark.parametrize("name", ["torque_low_pass", "bearing_drag"])
def test_what_a_sensor_remembers_goes_on_in_the_next_piece(name: str, coarse: NeedleModel) -> None:
    effect = LIBRARY[name].at_strength(1.0)
    truth = coarse.predict(SHORT)
    whole = effect.observe(truth).torque_nm
    cut = 40  # in the middle of the first turn
    pieces: list[Array] = []
    states: tuple[float | None, ...] = ()
    for piece in (slice(0, cut + 1), slice(cut, None)):
        part = replace(SHORT, time_s=SHORT.time_s[piece], base_angle_rad=SHORT.base_angle_rad[piece])
        reading, states = shown(
            (effect,), Reading(part, truth.torque_nm[piece], truth.hall_rad[piece]), states
        )
        pieces.append(reading.torque_nm)
    np.testing.assert_allclose(np.r_[pieces[0], pieces[1][1:]], whole, atol=1e-15)
    alone = effect.observe(Reading(part, truth.torque_nm[cut:], truth.hall_rad[cut:])).torque_nm
    assert np.abs(alone - whole[cut:]).max() > 1e-6


def test_the_curve_of_a_cell_by_hand() -> None:
    still = Trial(np.arange(3.0), np.zeros(3))
    torque_nm = np.array([-0.2e-3, 0.0, 0.1e-3])
    seen_nmm = torque_through(make_effect("torque_nonlinearity", 0.5, 5.0), still, torque_nm)
    np.testing.assert_allclose(seen_nmm, [-0.2 + 0.02 - 0.04, 0.0, 0.1 + 0.005 + 0.005])


def test_harmonics_are_what_the_arctangent_makes_of_unequal_and_bent_channels() -> None:
    turn_deg = np.arange(0.0, 360.0, 5.0)
    theta = np.radians(turn_deg)
    small = 0.01

    def angle_deg(sine: Array, cosine: Array) -> Array:
        return np.degrees(np.unwrap(np.arctan2(sine, cosine)))

    share_deg = np.degrees(small)
    make = functools.partial(make_effect, "hall_harmonics")
    for read_deg, effect, offset_deg in (
        (angle_deg((1 + small) * np.sin(theta), np.cos(theta)), make(second_sine_deg=share_deg / 2), 0.0),
        (
            angle_deg(np.sin(theta + small), np.cos(theta)),
            make(second_cosine_deg=share_deg / 2),
            share_deg / 2,
        ),
        (
            angle_deg(np.sin(theta) + small * np.sin(3 * theta), np.cos(theta) - small * np.cos(3 * theta)),
            make(fourth_sine_deg=share_deg),
            0.0,
        ),
        (
            angle_deg(np.sin(theta) + small * np.cos(3 * theta), np.cos(theta) + small * np.sin(3 * theta)),
            make(fourth_cosine_deg=share_deg),
            0.0,
        ),
    ):
        law_deg = hall_through(effect, turn_deg[:, None].tolist())[:, 0]
        # the law is the arctangent to first order
        np.testing.assert_allclose(law_deg + offset_deg, read_deg, atol=1.2 * np.degrees(small**2))


def test_cross_talk_adds_the_neighbours_fields() -> None:
    angles_deg = [[0.0, 0.0, 0.0, 0.0], [10.0, 40.0, 55.0, 20.0], [400.0, 430.0, 370.0, -300.0]]
    field = np.exp(1j * np.radians(np.array(angles_deg)))
    beside = np.zeros_like(field)
    beside[:, 1:] += field[:, :-1]
    beside[:, :-1] += field[:, 1:]
    seen_deg = hall_through(make_effect("hall_crosstalk", 0.2), angles_deg)
    turned = np.angle(np.exp(1j * np.radians(seen_deg)) / (field + 0.2 * beside))
    np.testing.assert_allclose(turned, 0.0, atol=1e-12)
    # whole turns are kept
    assert np.abs(seen_deg - angles_deg).max() < 30


def test_a_sensor_without_neighbours_has_no_cross_talk() -> None:
    seen_deg = hall_through(make_effect("hall_crosstalk", 0.3), [[12.0], [48.0]])
    assert seen_deg.ravel() == pytest.approx([12.0, 48.0], abs=1e-12)


def test_an_eccentric_encoder_turns_all_that_follows_the_base_alike(coarse: NeedleModel) -> None:
    loose = replace(coarse, friction_n=0.0).with_effects(make_effect("encoder_eccentricity", 2.0, -1.5))
    trial = path((0, 0), (4, 180), (8, -90))
    shown_deg = np.degrees(trial.base_angle_rad)
    error_deg = 2.0 * np.sin(trial.base_angle_rad) - 1.5 * (np.cos(trial.base_angle_rad) - 1.0)
    seen = loose.predict(trial)
    for column in np.degrees(seen.hall_rad).T:
        np.testing.assert_allclose(column, shown_deg - error_deg, atol=1e-6)
    assert seen.hall_rad[0] == pytest.approx(0.0, abs=1e-15)


def test_a_gear_turns_all_that_follows_the_base_unevenly(coarse: NeedleModel) -> None:
    geared = make_effect("transmission_error", sine_deg=0.8, cosine_deg=-0.5, order=14)
    loose = replace(coarse, friction_n=0.0).with_effects(geared)
    trial = path((0, 0), (4, 180), (8, -90))
    phase_rad = 14 * trial.base_angle_rad
    error_deg = 0.8 * np.sin(phase_rad) - 0.5 * (np.cos(phase_rad) - 1.0)
    seen = loose.predict(trial)
    for column in np.degrees(seen.hall_rad).T:
        np.testing.assert_allclose(column, np.degrees(trial.base_angle_rad) - error_deg, atol=1e-6)
    assert seen.hall_rad[0] == pytest.approx(0.0, abs=1e-15)


def test_a_ripple_of_the_torque_leaves_the_needle_alone(coarse: NeedleModel) -> None:
    rippled = coarse.with_effects(make_effect("torque_ripple", sine_nmm=0.02, cosine_nmm=0.01, order=9))
    trial = path((0, 0), (4, 180), (8, -90))
    seen, plain = rippled.predict(trial), coarse.predict(trial)
    phase_rad = 9 * trial.base_angle_rad
    np.testing.assert_allclose(
        (seen.torque_nm - plain.torque_nm) * 1e3,
        0.02 * np.sin(phase_rad) + 0.01 * (np.cos(phase_rad) - 1.0),
        atol=1e-12,
    )
    assert (seen.hall_rad == plain.hall_rad).all()


def test_a_coupling_that_slipped_before_a_trial_turns_its_angles_alone(coarse: NeedleModel) -> None:
    slipped = coarse.with_effects(make_effect("coupling_slip", slip_deg=6.0, at_s=SHORT.start_s))
    seen, plain = slipped.predict(SHORT), coarse.predict(SHORT)
    assert (seen.torque_nm == plain.torque_nm).all()
    np.testing.assert_allclose(np.degrees(plain.hall_rad - seen.hall_rad), 6.0)
    # a trial that ends before it knows nothing of it
    later = coarse.with_effects(make_effect("coupling_slip", slip_deg=6.0, at_s=SHORT.start_s + 100.0))
    assert (later.predict(SHORT).hall_rad == plain.hall_rad).all()


def test_a_coupling_that_slips_within_a_trial_turns_the_needle_back(coarse: NeedleModel) -> None:
    slip = make_effect("coupling_slip", slip_deg=6.0, at_s=TURNED.start_s + 1.505)
    model = replace(coarse, friction_n=0.0).with_effects(slip)
    behind_deg = np.degrees(TURNED.base_angle_rad[:, None] - model.predict(TURNED).hall_rad)
    np.testing.assert_allclose(behind_deg[TURNED.time_s < 1.5], 0.0, atol=1e-9)
    np.testing.assert_allclose(behind_deg[TURNED.time_s > 1.51], 6.0, atol=1e-9)
    # with friction the twist, and so the torque, falls by what the needle springs back
    lost = coarse.predict(TURNED).torque_nm - coarse.with_effects(slip).predict(TURNED).torque_nm
    assert lost[np.searchsorted(TURNED.time_s, 1.52)] > 1e-6


def test_instants_of_a_slip_are_the_trials_and_the_turns_in_them() -> None:
    (info,) = [i for i in LIBRARY["coupling_slip"].parameters().values() if i.places is not None]
    assert info.places is not None
    first = replace(TURNED, start_s=0.0)
    second = replace(path((0, 0), (1, 0), (2, 45), (3, 45), (4, 0), (5, 0)), start_s=50.0)
    rows = info.places([first, second])
    spans = [(round(row[0], 2), round(row[-1], 2)) for row in rows]
    assert spans == [(0.01, 1.99), (50.0, 50.0), (51.01, 51.99), (53.01, 53.99)]


def test_an_encoders_error_comes_before_the_play_behind_it(coarse: NeedleModel) -> None:
    effects = (make_effect("encoder_eccentricity", 3.0, 0.0), make_effect("chuck_backlash", 8.0))
    held_rad, _ = coarse.with_effects(*effects).held_path(SHORT)
    true_rad = SHORT.base_angle_rad - np.radians(3.0) * np.sin(SHORT.base_angle_rad)
    np.testing.assert_allclose(
        held_rad, effects[1].drive(replace(SHORT, base_angle_rad=true_rad)), atol=1e-15
    )


def followed_on_a_mount(
    layout: Layout, friction_n: float, mount_rad_per_nm: float, chuck_rad_per_nm: float, trial: Trial
) -> tuple[Array, Array, Array]:
    """Torque (N·m), sensors and tip (rad) of dry nodes on a body that turns: a box-constrained least square.

    Nodes turn by Θ − F r with the flexibility F of chuck and needle; the body by Σ r/K. What the nodes take
    from it, r within their limits, minimises the energy of both springs with the slip done so far.
    """
    cells = np.concatenate([np.arange(a, b - 1e-9, 5e-3) + 2.5e-3 for a, b in layout.tissue_sections_m])
    limits_nm = np.full(cells.size, friction_n * 5e-3)
    flexibility = np.minimum.outer(cells, cells) / JG_NM2 + chuck_rad_per_nm
    stiff = np.linalg.cholesky(flexibility + mount_rad_per_nm).T
    places = np.array([*layout.sensor_positions_m, layout.needle_length_m])
    seen = np.minimum.outer(places, cells) / JG_NM2 + chuck_rad_per_nm
    slipped_rad = np.zeros(cells.size)
    torques, angles = [], []
    for base_rad in trial.base_angle_rad:
        wanted = np.linalg.solve(stiff.T, base_rad - slipped_rad)
        held_nm = lsq_linear(stiff, wanted, (-limits_nm, limits_nm), method="bvls", tol=1e-14).x
        slipped_rad = base_rad - stiff.T @ (stiff @ held_nm)
        torques.append(held_nm.sum())
        angles.append(base_rad - seen @ held_nm)
    every = np.array(angles)
    return np.array(torques), every[:, :-1], every[:, -1]


def on_a_mount(**chuck: float) -> NeedleModel:
    layout = Layout(0.3, ((0.12, 0.16), (0.2, 0.25)), (0.18, 0.27))
    effects = [make_effect("mount_compliance", 0.4)]
    effects += [make_effect("chuck_compliance", stiffness) for stiffness in chuck.values()]
    return NeedleModel("on a mount", layout, JG_NM2, 1e-3, tuple(effects), element_length_m=5e-3)


BACK_AND_FORTH = path((0, 0), (1, 45), (1.3, 45), (2, 10), (3, 60), (4, -30), rate_hz=20)


@pytest.mark.parametrize("chuck", [{}, {"stiffness_nmm_per_rad": 0.7}])
def test_a_phantom_on_a_spring_moves_as_a_small_model_of_springs_and_sliders(chuck: dict[str, float]) -> None:
    model = on_a_mount(**chuck)
    chuck_rad_per_nm = 1e3 / 0.7 if chuck else 0.0
    torque_nm, sensor_rad, tip_rad = followed_on_a_mount(
        model.layout, model.friction_n, 1e3 / 0.4, chuck_rad_per_nm, BACK_AND_FORTH
    )
    solution = model.truth(BACK_AND_FORTH, shaft=True)
    np.testing.assert_allclose(solution.torque_nm, torque_nm, atol=1e-9)
    np.testing.assert_allclose(solution.sensor_rad, sensor_rad, atol=1e-5)
    np.testing.assert_allclose(solution.tip_rad, tip_rad, atol=1e-5)
    assert solution.shaft_rad is not None
    np.testing.assert_array_equal(solution.shaft_rad[:, -1], solution.tip_rad)
    np.testing.assert_allclose(solution.state.angle_rad, solution.shaft_rad[-1], atol=1e-15)


def test_a_phantom_on_a_spring_can_be_followed_in_pieces() -> None:
    model = on_a_mount(stiffness_nmm_per_rad=0.7).with_effects(make_effect("tissue_elasticity", 0.5))
    whole = model.truth(BACK_AND_FORTH)
    state = None
    for first in range(0, BACK_AND_FORTH.time_s.size - 1, 13):
        piece = slice(first, first + 14)
        part = Trial(BACK_AND_FORTH.time_s[piece], BACK_AND_FORTH.base_angle_rad[piece])
        solution = model.truth(part, state)
        state = solution.state
        np.testing.assert_allclose(solution.torque_nm, whole.torque_nm[piece], atol=1e-10)
        np.testing.assert_allclose(solution.sensor_rad, whole.sensor_rad[piece], atol=1e-7)


def test_a_phantom_on_a_spring_turns_sensors_beyond_the_tissue_by_what_the_torque_winds_it(
    model: NeedleModel,
) -> None:
    # deep in the tissue nothing has slipped yet: there the needle turns with the phantom alone
    mounted = model.with_effects(make_effect("mount_compliance", 1.0))
    reading = mounted.predict(path((0, 0), (1, 15)))
    np.testing.assert_allclose(reading.hall_rad[:, -1], reading.torque_nm / 1e-3, atol=1e-9)
    assert reading.torque_nm[-1] > 2e-5


def test_a_mount_that_pushes_back_is_refused(model: NeedleModel) -> None:
    rod = replace(model.rod(SEQUENCE), mount_compliance_rad_per_nm=-1.0)
    with pytest.raises(BadInput, match=r"rod\.mount_compliance_rad_per_nm is -1; it must be 0 or more"):
        _ = rod.coefficients
