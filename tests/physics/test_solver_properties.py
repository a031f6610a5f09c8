"""What must hold for every rod and path, whatever the values."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from needle_rig.errors import BadInput, SolverError
from needle_rig.physics.rod import Layout, Rod, TorqueLaw
from needle_rig.physics.solution import Solution
from needle_rig.physics.solver import relaxed, solve, solve_batch
from tests.physics.rods import EXPERIMENT, MODEL, compensation, errors, lumped, path, refined, rod
from tests.physics.test_rod import layouts

angles = st.floats(-150.0, 150.0)
paths = st.lists(angles, min_size=1, max_size=5)
rates = st.sampled_from([0.0, 0.02, 0.1, 0.5, 2.8])
stiffnesses = st.sampled_from([np.inf, 1e4, 5.0, 0.278, 0.05])
creeps = st.sampled_from([None, (0.3, 1.0), (0.0, 3.0), (1.0, 0.05)])
excesses = st.sampled_from([0.0, 0.3])


@st.composite
def any_rod(
    draw: DrawFn,
    layout: Layout = EXPERIMENT,
    element_length_m: float = 2e-3,
    weakenings: tuple[float, ...] = (1.0,),
) -> Rod:
    """Any coefficients. By default no needle here comes near a snap, whose instant depends on the steps."""
    return rod(
        friction=draw(st.sampled_from([0.0, 0.02, 0.0996, 0.45])),
        viscous=draw(rates),
        stiffness=draw(stiffnesses),
        creep=draw(creeps),
        static_excess=draw(excesses),
        ageing_per_decade=draw(st.sampled_from([0.0, 0.1])),
        weakening_rad=draw(st.sampled_from(weakenings)),
        base_compliance_rad_per_nm=draw(st.sampled_from([0.0, 4000.0])),
        layout=layout,
        element_length_m=element_length_m,
    )


@given(any_rod(), paths)
def test_the_mirror_image_of_a_path_gives_the_mirror_image(needle: Rod, targets: list[float]) -> None:
    time, base = path(targets, settle_s=0.5)
    one, other = solve(needle, time, base), solve(needle, time, -base)
    assert one.sensor_rad == pytest.approx(-other.sensor_rad, abs=1e-9)
    assert one.torque_nm == pytest.approx(-other.torque_nm, abs=1e-12)


@given(any_rod(), paths)
def test_energy_is_never_created(needle: Rod, targets: list[float]) -> None:
    needle = replace(needle, base_compliance_rad_per_nm=0.0)
    time, base = refined(*path(targets, settle_s=0.5), 4)
    solution = solve(needle, time, base, shaft=True, tolerance_rad=1e-4)
    work = np.concatenate(
        [[0.0], np.cumsum(0.5 * (solution.torque_nm[1:] + solution.torque_nm[:-1]) * np.diff(base))]
    )
    assert solution.shaft_rad is not None
    twist = np.diff(solution.shaft_rad, axis=1)
    stored = 0.5 * (needle.stiffness_nm_per_rad * twist**2).sum(axis=1)
    # 1e-4 rad of numerical error times the largest torque, over the work of the whole path
    allowed = 2e-3 * work.max() + 1e-12
    assert (work - stored >= -allowed).all()


@given(any_rod(), paths, st.integers(1, 10_000))
def test_going_on_from_a_state_equals_one_run(needle: Rod, targets: list[float], cut: int) -> None:
    time, base = path(targets, settle_s=0.5)
    middle = 1 + cut % (len(time) - 1)
    whole = solve(needle, time, base)
    first = solve(needle, time[: middle + 1], base[: middle + 1])
    second = solve(needle, time[middle:], base[middle:], state=first.state)
    joined = np.concatenate([first.sensor_rad[:-1], second.sensor_rad])
    assert second.sensor_rad[0] == pytest.approx(first.sensor_rad[-1], abs=1e-15)
    # without rates it is the same solution, with them a different choice of steps
    depends_on_rate = (
        needle.viscous_nms_per_rad.any()
        or np.isfinite(needle.creep_viscosity_nms_per_rad).any()
        or needle.static_excess.any()
        or needle.ageing_per_decade.any()
    )
    assert joined == pytest.approx(whole.sensor_rad, abs=np.radians(0.1) if depends_on_rate else 1e-7)


@given(st.floats(-60.0, 60.0), st.floats(0.05, 0.95), st.floats(0.05, 0.95), stiffnesses)
def test_a_closed_loop_of_reversals_is_forgotten(
    start: float, depth: float, inner: float, stiffness: float
) -> None:
    """Return-point memory: an inner excursion that comes back leaves no trace."""
    outer = start - 40.0 * depth * np.sign(start or 1.0)
    turn = outer + (start - outer) * inner
    plain = [90.0, start, outer]
    targets = np.radians([0.0, *plain, turn, outer, outer - 20.0])
    without = np.radians([0.0, *plain, outer - 20.0])
    needle = rod(stiffness=stiffness)
    one = solve(needle, np.arange(len(targets), dtype=float), targets)
    other = solve(needle, np.arange(len(without), dtype=float), without)
    assert one.sensor_rad[-2] == pytest.approx(one.sensor_rad[3], abs=1e-6)
    assert one.torque_nm[-2] == pytest.approx(one.torque_nm[3], abs=4e-10)
    assert one.sensor_rad[-1] == pytest.approx(other.sensor_rad[-1], abs=1e-6)


@given(st.floats(60.0, 170.0), st.floats(0.02, 0.98), stiffnesses)
def test_masing_holds_in_elastic_tissue_too(wound: float, part: float, stiffness: float) -> None:
    """After full slip the branch of a reversal is the first turn, twice as large in both directions."""
    needle = rod(stiffness=stiffness, layout=MODEL)
    turn = 40.0 * part
    virgin = solve(needle, np.arange(2.0), np.radians([0.0, turn]))
    back = solve(needle, np.arange(3.0), np.radians([0.0, 300.0 + wound, 300.0 + wound - 2 * turn]))
    assert back.torque_nm[1] - back.torque_nm[2] == pytest.approx(2 * virgin.torque_nm[1], abs=1e-10)


@given(paths, stiffnesses, st.integers(2, 9))
def test_without_rates_the_number_of_steps_changes_nothing(
    targets: list[float], stiffness: float, times: int
) -> None:
    time, base = path(targets, settle_s=0.2, sample_hz=10)
    fine = refined(time, base, times)
    angle, torque = errors(
        solve(rod(stiffness=stiffness), time, base), solve(rod(stiffness=stiffness), *fine), times
    )
    assert angle < 1e-4
    assert torque < 1e-6


@given(paths, stiffnesses, st.floats(0.2e-3, 3e-3))
def test_refining_the_mesh_changes_little_and_full_slip_not_at_all(
    targets: list[float], stiffness: float, element_length_m: float
) -> None:
    time, base = path(targets, settle_s=0.2, sample_hz=10)
    coarse = solve(rod(stiffness=stiffness, element_length_m=element_length_m), time, base)
    fine = solve(rod(stiffness=stiffness, element_length_m=element_length_m / 8), time, base)
    assert errors(coarse, fine)[0] < 1e-3 * (element_length_m / 0.5e-3) ** 2 + 1e-4
    turns = np.radians([0.0, 3000.0])
    full = solve(rod(stiffness=stiffness, element_length_m=element_length_m), np.arange(2.0), turns)
    # rounding of 52 rad on cells of down to 0.2 mm
    assert full.torque_nm[-1] == pytest.approx(0.0996e-3, rel=1e-7)


def node_torques(needle: Rod, solution: Solution) -> tuple[np.ndarray, np.ndarray]:
    """Torque of the tissue on every node, shape (samples, nodes), and what rounding makes of it, (nodes,)."""
    angle = solution.shaft_rad
    assert angle is not None
    pull = np.zeros_like(angle)
    flow = needle.stiffness_nm_per_rad * np.diff(angle, axis=1)
    pull[:, :-1] += flow
    pull[:, 1:] -= flow
    pull[:, 0] += solution.torque_nm
    stiffness = np.zeros(angle.shape[1])
    stiffness[:-1] += needle.stiffness_nm_per_rad
    stiffness[1:] += needle.stiffness_nm_per_rad
    # samples inside a step lie between the angles at its ends, whose rounding they have
    return pull, 100 * np.finfo(float).eps * stiffness * (np.abs(angle).max(axis=0) + 1e-3)


@given(st.data())
def test_random_layouts_are_solved_and_obey_their_limits(data: st.DataObject) -> None:
    layout = data.draw(layouts())
    needle = data.draw(any_rod(layout=layout, element_length_m=5e-3, weakenings=(0.5, 0.02)))
    solution = solve(needle, *path(data.draw(paths), settle_s=0.3), shaft=True)
    pull, rounding = node_torques(needle, solution)
    # nothing holds a node without tissue; a dry one is held by no more than its limit
    free = needle.slip_plus_nm + needle.viscous_nms_per_rad == 0
    assert (np.abs(pull) <= rounding)[:, free].all()
    if not needle.viscous_nms_per_rad.any():
        most = needle.slip_plus_nm * (1 + needle.static_excess + 3 * needle.ageing_per_decade)
        # a limit that falls with slip is found to a part in a million
        slack = 5e-6 if needle.depends_on_rate[2] else 1e-9
        assert (np.abs(pull) <= most * (1 + slack) + rounding).all()


@pytest.mark.parametrize(
    "needle",
    [
        rod(friction=0.02, creep=(1.0, 0.05)),
        rod(creep=(0.3, 1.0)),
        rod(stiffness=0.5, creep=(0.3, 1.0)),
        lumped("tip", 0.02, viscous=0.2),
        lumped("sensors", 0.004, viscous=0.2, creep=(0.3, 1.0)),
    ],
)
def test_no_dry_node_is_ever_above_its_limit(needle: Rod) -> None:
    """Not at the end of a step, where the error of the step was extrapolated away, and not inside one."""
    solution = solve(needle, *path(compensation()), shaft=True)
    pull, rounding = node_torques(needle, solution)
    dry = (needle.viscous_nms_per_rad == 0) & (needle.slip_plus_nm > 0)
    excess = np.abs(pull) - needle.slip_plus_nm * (1 + 1e-9) - rounding
    assert (excess[:, dry] <= 0).all()
    assert (np.abs(pull) > 0.999 * needle.slip_plus_nm)[:, dry].any()


def test_a_limit_that_falls_with_slip_is_obeyed_in_every_final_state() -> None:
    needle = rod(static_excess=0.3, ageing_per_decade=0.1, weakening_rad=0.02, element_length_m=2e-3)
    time, base = path([45.0, 10.0], settle_s=0.5)
    for cut in range(5, len(time), 9):
        solution = solve(needle, time[:cut], base[:cut], shaft=True)
        pull, rounding = node_torques(needle, solution)
        state = solution.state
        grown = needle.ageing_per_decade * np.log10(1 + state.age_s / needle.ageing_time_s)
        limit = needle.slip_plus_nm * (1 + needle.static_excess * state.excess_state + grown)
        assert (np.abs(pull[-1]) <= limit * (1 + 5e-6) + rounding)[1:].all()


@pytest.mark.parametrize(
    "needle", [rod(), rod(stiffness=0.278), rod(viscous=0.05), rod(static_excess=0.3, viscous=0.05)]
)
def test_nothing_drifts_in_an_hour_of_rest(needle: Rod) -> None:
    time, base = path([*compensation(), 50.0])
    moved = solve(needle, time, base)
    settled = solve(needle, np.array([0.0, 600.0]), base[-1:].repeat(2), state=moved.state)
    hour = np.linspace(0.0, 3600.0, 361)
    rest = solve(needle, hour, np.full(361, base[-1]), state=settled.state)
    assert np.abs(rest.sensor_rad - settled.sensor_rad[-1]).max() < 1e-9
    assert np.abs(rest.torque_nm - settled.torque_nm[-1]).max() < 1e-12


def test_an_infinite_limit_holds_the_tip() -> None:
    plain = rod(friction=0.0)
    limit = plain.slip_plus_nm.copy()
    limit[plain.tip] = np.inf
    held = replace(plain, slip_plus_nm=limit, slip_minus_nm=limit)
    solution = solve(held, np.arange(2.0), np.array([0.0, np.pi / 2]))
    assert solution.tip_rad[-1] == 0.0
    assert solution.torque_nm[-1] == pytest.approx(62.56e-6 / 0.397 * np.pi / 2)


def test_a_batch_gives_what_single_runs_give() -> None:
    rods = [rod(viscous=v, stiffness=k) for v in (0.0, 0.1) for k in (np.inf, 0.278)]
    given = path(compensation())
    together = solve_batch(rods, [given], threads=2)
    for needle, solution in zip(rods, together, strict=True):
        alone = solve(needle, *given)
        assert np.array_equal(alone.sensor_rad, solution.sensor_rad)
        assert np.array_equal(alone.torque_nm, solution.torque_nm)


def pull_up(
    parameters: np.ndarray, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float
) -> float:
    return float(parameters[0] * np.sin(angle_rad - parameters[1]) - parameters[2] * rate_rad_s)


def test_a_torque_law_acts_and_its_parameters_need_no_compilation() -> None:
    needle = rod()
    time, base = path([45.0])
    plain = solve(needle, time, base)

    def with_law(*values: float) -> Solution:
        law = TorqueLaw(pull_up, np.array(values), needle.tissue_length_m)
        return solve(replace(needle, laws=(law,)), time, base)

    assert errors(with_law(0.0, 0.3, 0.0), plain)[0] < 1e-6
    pushed = with_law(0.02e-2, 0.3, 0.0)
    assert np.degrees(pushed.tip_rad[-1] - plain.tip_rad[-1]) > 0.3
    # a law that resists the rate is viscous friction by another name
    damped, viscous = with_law(0.0, 0.0, 0.5e-2), solve(rod(viscous=0.5), time, base)
    assert errors(damped, viscous)[0] < 0.03


def test_two_laws_add() -> None:
    needle = rod()
    time, base = path([45.0])
    half = TorqueLaw(pull_up, np.array([0.01e-2, 0.3, 0.0]), needle.tissue_length_m)
    whole = TorqueLaw(pull_up, np.array([0.02e-2, 0.3, 0.0]), needle.tissue_length_m)
    twice = solve(replace(needle, laws=(half, half)), time, base)
    once = solve(replace(needle, laws=(whole,)), time, base)
    assert errors(twice, once)[0] < 1e-6


def runaway(
    parameters: np.ndarray, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float
) -> float:
    return float(parameters[0] * angle_rad**3)


def test_a_law_without_balance_is_a_clear_error() -> None:
    needle = rod()
    law = TorqueLaw(runaway, np.array([1.0]), needle.tissue_length_m)
    with pytest.raises(SolverError, match=r"s (at|near) node \d+ \(.* mm from the base\)"):
        solve(replace(needle, laws=(law,)), *path([170.0]))


@pytest.mark.parametrize(
    ("time", "base", "message"),
    [
        ([], [], "trajectory is empty"),
        ([0.0, 1.0], [0.0, np.nan], "base angle is nan at sample 1"),
        ([0.0, np.inf], [0.0, 1.0], "time is inf at sample 1"),
        ([0.0, 1.0, 0.5], [0.0, 1.0, 1.0], "time goes from 1 to 0.5 s at sample 2"),
        ([0.0, 0.0], [0.0, 1.0], "must increase"),
        ([0.0, 1.0], [0.0], "same length"),
        ([[0.0, 1.0]], [[0.0, 1.0]], "same length"),
    ],
)
def test_impossible_paths_are_refused(time: list[float], base: list[float], message: str) -> None:
    with pytest.raises(BadInput, match=message):
        solve(rod(), np.array(time), np.array(base))
    with pytest.raises(BadInput, match=message):
        solve_batch([rod()], [(np.array(time), np.array(base))])


def test_a_state_of_another_rod_is_refused() -> None:
    with pytest.raises(BadInput, match="nodes"):
        solve(rod(), np.zeros(1), np.zeros(1), state=relaxed(rod(layout=MODEL)))
    with pytest.raises(BadInput, match="above 0"):
        solve(rod(), np.zeros(1), np.zeros(1), tolerance_rad=0.0)
    with pytest.raises(BadInput, match="2 rods and 3 inputs"):
        solve_batch([rod()] * 2, [(np.zeros(1), np.zeros(1))] * 3)


@pytest.mark.parametrize(
    "memory",
    [
        {"ageing_per_decade": 0.18, "weakening_rad": 0.02},
        {"ageing_per_decade": 0.1, "stiffness": 0.278},
        {"static_excess": 0.3, "stribeck_rate_rad_s": 0.1, "weakening_rad": 0.1},
        {"static_excess": 0.3, "viscous": 0.05, "weakening_rad": 0.2},
    ],
)
def test_limits_with_memory_are_found_in_few_solves(memory: dict[str, Any]) -> None:
    """By substitution alone the hardest of these takes more than four solves a step."""
    solution = solve(rod(**memory), *path(compensation()))
    assert solution.solves < 2.5 * solution.steps


@pytest.mark.whole
def test_a_snap_does_not_shrink_the_steps_to_nothing() -> None:
    """Its error is the same at any length; far shorter steps would end in angles that are no numbers."""
    time, base = refined(*path(compensation()), 4)
    snapping = rod(ageing_per_decade=0.3, weakening_rad=0.02, stiffness=0.278, element_length_m=0.125e-3)
    solution = solve(snapping, time, base, tolerance_rad=1e-5)
    assert np.isfinite(solution.torque_nm).all()
    assert solution.steps < 1.5 * time.size


@pytest.mark.parametrize("rest_s", [0.2, 0.71, 3.2])
def test_only_tissue_that_remembers_its_rest_ages(rest_s: float) -> None:
    """Rounding would double from step to step, and end in ages without bound."""
    needle = rod(ageing_per_decade=0.17, weakening_rad=0.02, element_length_m=5e-3, ageing_time_s=rest_s)
    time, base = refined(*path(compensation()), 2)
    age_s = solve(needle, time, base).state.age_s
    remembers = needle.ageing_per_decade > 0.0
    assert (age_s[~remembers] == 0.0).all()
    assert (age_s[remembers] > 1.0).all()
    assert (age_s <= time[-1]).all()


@pytest.mark.parametrize("steady", [False, True])
def test_a_torque_law_turns_the_needle_before_the_base_moves(steady: bool) -> None:
    """Elastic tissue gives way to it at once, and no further."""
    plain = rod(stiffness=0.278)
    law = TorqueLaw(pull_up, np.array([0.01e-2, 0.3, 0.0]), plain.tissue_length_m, steady)
    time, base = np.linspace(0.0, 3.0, 61), np.concatenate([np.zeros(40), np.linspace(0.0, 0.5, 21)])
    solution = solve(replace(plain, laws=(law,)), time, base)
    assert np.degrees(solution.sensor_rad[1, -1]) < -0.1
    assert solution.sensor_rad[39] == pytest.approx(solution.sensor_rad[1], abs=1e-5)


def levels_off(
    parameters: Any, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float
) -> float:
    return float(-parameters[0] * rate_rad_s / (abs(rate_rad_s) + parameters[1]))


@pytest.mark.parametrize("scale_rad_s", [0.5, 0.1, 0.02])
@pytest.mark.parametrize("drag_n", [1e-4, 5e-4])
def test_a_drag_that_levels_off_beside_dry_friction_is_followed(drag_n: float, scale_rad_s: float) -> None:
    needle = rod(friction=0.0996, element_length_m=4e-3)
    law = TorqueLaw(levels_off, np.array([drag_n, scale_rad_s]), needle.tissue_length_m, steady=False)
    time, base = path([45.0, 0.0, -35.0], settle_s=0.5)
    dry, dragged = solve(needle, time, base), solve(replace(needle, laws=(law,)), time, base)
    most_nm = drag_n * needle.tissue_length_m.sum()
    added = np.abs(dragged.torque_nm - dry.torque_nm).max()
    assert 0.1 * most_nm < added < 2.1 * most_nm


@pytest.mark.parametrize("seed", range(100))
def test_a_wound_shaft_whose_friction_has_fallen_gives_way_to_its_new_slip_limits(seed: int) -> None:
    """Turned to and fro, a shaft holds torques of either sign; with less friction nearly all of it slips."""
    random = np.random.default_rng([seed, 7])
    needle = rod(
        friction=random.choice([0.0996, 0.45]),
        stiffness=random.choice([np.inf, 1e4]),
        base_compliance_rad_per_nm=random.choice([0.0, 4000.0]),
    )
    turns = random.uniform(150.0, 600.0) * (-random.uniform(0.55, 0.95)) ** np.arange(random.integers(6, 14))
    time, base = path(list(turns), settle_s=0.3)
    held = solve(needle, time, base).state
    left = random.choice([0.1, 0.3, 0.6])
    lower = replace(
        needle, slip_plus_nm=left * needle.slip_plus_nm, slip_minus_nm=left * needle.slip_minus_nm
    )
    first = base[-1] + random.choice([0.0, 1e-5])
    after = solve(
        lower, np.array([0.0, 0.1, 0.2]), np.array([first, first, base[-1] + 0.01]), state=held
    ).state
    carried = lower.stiffness_nm_per_rad * np.diff(after.angle_rad)
    torque = np.diff(carried, append=0.0)
    assert np.all(np.abs(torque) <= lower.slip_plus_nm[1:] * (1.0 + 1e-6) + 1e-12)
