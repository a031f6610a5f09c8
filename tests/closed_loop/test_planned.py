"""The planner: straight shafts with a true model, no harm with a wrong one, refusals, and its words."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from needle_rig.control.planning import effort as effort_module
from needle_rig.control.planning.belief import first_belief, needles
from needle_rig.control.planning.effort import CALL_SOLVES, Effort, Spent
from needle_rig.control.planning.plans import Aim, carry_out, cheapest, likeliest_plans, rate
from needle_rig.control.strategies import planned as planned_module
from needle_rig.control.strategies.planned import PLAN_SOLVES, Planned
from needle_rig.control.strategy import History, Reason, Strategy, Task, Trust, Waypoint, make_strategy
from needle_rig.errors import BadInput, SolverError
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT, load_parameters
from needle_rig.physics.effect import Trial
from needle_rig.physics.effects.bending_torque import BendingTorque
from needle_rig.physics.effects.chuck_backlash import ChuckBacklash
from needle_rig.physics.effects.stribeck import Stribeck
from needle_rig.physics.effects.viscous_slip import ViscousSlip
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.physics.solution import Solution
from needle_rig.physics.solver import relaxed
from needle_rig.physics.trial_friction import FrictionOfTrial
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.virtual.noise import NO_NOISE, Noise
from needle_rig.workbench.virtual.settled_run import SettledRun, run_settled

RIGIDITY_NM2 = 62.56e-6
PLENTY = Effort(math.inf)
TRUST = Trust(
    {
        "friction_nmm_per_100mm": 0.001,
        "torsional_rigidity_nmm2": 0.5,
        "tissue_elasticity.stiffness_nmm_per_rad_per_100mm": 0.005,
    }
)


def _task(model: NeedleModel | None, target_deg: float = 45.0, trust: Trust = TRUST, **more: float) -> Task:
    layout = EXPERIMENT_LAYOUT if model is None else model.layout
    values = {"angle_limit_rad": rad(720.0)} | more
    return Task(rad(target_deg), layout, RIGIDITY_NM2, rad(45.0), 3.0, model=model, trust=trust, **values)


def _run(
    plant: NeedleModel,
    strategy: Strategy,
    task: Task,
    seed: int = 1,
    *,
    scatter: float = 0.05,
    wound_deg: float = 0.0,
) -> SettledRun:
    random = np.random.default_rng(seed)
    needle = plant.with_effects(FrictionOfTrial(1.0 + scatter * float(random.standard_normal())))
    return run_settled(needle, strategy, task, random, Noise(), wound_rad=rad(wound_deg))


@pytest.mark.parametrize(
    ("target_deg", "wound_deg"), [(45.0, 0.0), (-15.0, 0.0), (180.0, 0.0), (45.0, 60.0), (45.0, -60.0)]
)
def test_elastic_tissue_ends_straight_with_half_the_rotations(target_deg: float, wound_deg: float) -> None:
    plant = load_parameters("rig_elastic")
    for seed in (1, 2):
        plain = _run(
            plant, make_strategy("reed2008", {}), _task(plant, target_deg), seed, wound_deg=wound_deg
        )
        planned = _run(plant, Planned(), _task(plant, target_deg), seed, wound_deg=wound_deg)
        assert deg(planned.worst_rad(rad(target_deg))) < 1.0
        # a shaft wound against the target unwinds on the way
        assert deg(plain.worst_rad(rad(target_deg))) > (8.0 if wound_deg >= 0.0 else 1.0)
        assert planned.rotations - 1 <= (plain.rotations - 1) / 2
        assert planned.time_s <= plain.time_s / 2
        assert abs(nmm(planned.torque_nm)) < 0.01


@pytest.mark.parametrize(("target_deg", "wound_deg"), [(45.0, 0.0), (-45.0, 0.0), (15.0, 0.0), (90.0, 60.0)])
@pytest.mark.parametrize("halls", [True, pytest.param(False, marks=pytest.mark.whole)])
def test_a_rigid_model_of_elastic_tissue_does_no_harm(
    target_deg: float, wound_deg: float, halls: bool
) -> None:
    plant, wrong = load_parameters("rig_elastic"), load_parameters("rig_rigid")
    if not halls:
        blind = dataclasses.replace(EXPERIMENT_LAYOUT, sensor_positions_m=())
        plant, wrong = dataclasses.replace(plant, layout=blind), dataclasses.replace(wrong, layout=blind)
    plain = _run(plant, make_strategy("reed2008", {}), _task(plant, target_deg), wound_deg=wound_deg)
    planned = _run(plant, Planned(), _task(wrong, target_deg), wound_deg=wound_deg)
    assert planned.worst_rad(rad(target_deg)) <= 1.1 * plain.worst_rad(rad(target_deg))
    assert any("the model does not hold here, going on as reed2008" in note for note in planned.notes)


def test_a_true_model_is_not_doubted_when_friction_is_far_from_usual() -> None:
    plant = load_parameters("rig_elastic")
    heavy = plant.with_effects(FrictionOfTrial(1.15))
    run = run_settled(heavy, Planned(), _task(plant), np.random.default_rng(0), Noise())
    assert not any("does not hold" in note for note in run.notes)
    assert deg(run.worst_rad(rad(45.0))) < 1.0


def test_a_rigid_uniform_needle_ends_on_the_two_front_optimum() -> None:
    # Zero net torque with tip, entry and base at the target needs fronts at 3/4 and 1/4 of the tissue:
    # the base comes back by 1.5 (l_in + 0.375 L)/(l_in + 0.5 L) of the lag from the wound state.
    model = NeedleModel("uniform", MODEL_LAYOUT, RIGIDITY_NM2, 1e-3, element_length_m=0.5e-3)
    length, free, friction = 0.1, 0.175, 1e-3 * 0.1
    lag = friction / RIGIDITY_NM2 * (free + length / 2)
    back = 1.0 - 1.5 * (free + 0.375 * length) / (free + 0.5 * length)
    task = _task(model)
    belief = first_belief(model, {}, 1e-6)
    history = _run_history(model, task)
    aim = Aim(task, history[-1].base_angle_rad, rad(120.0), 0.5, 0.9, rad(0.15))
    likely = needles(belief, task, history, 1, PLENTY)
    closed_form = rate(aim, likely, [task.target_rad + s * lag for s in (1.0, back, 0.0)], PLENTY)
    ours = likeliest_plans(aim, likely[0], 3, PLENTY)[2]
    assert len(ours.angles_rad) == 3
    assert nmm(closed_form.ends.torque_nm[0]) == pytest.approx(0.0, abs=2e-3)
    # the planner weighs the worst angle, so it may beat the condition of zero torque, but not lose to it
    assert ours.cost_rad <= closed_form.cost_rad + rad(0.05)


def _run_history(model: NeedleModel, task: Task) -> History:
    run = run_settled(model, make_strategy("none", {}), task, np.random.default_rng(0), NO_NOISE)
    return run.history[:1]


@pytest.mark.whole
def test_backlash_is_turned_out() -> None:
    plant = load_parameters("rig_elastic").with_effects(ChuckBacklash(6.0))
    run = _run(plant, Planned(), _task(plant))
    assert deg(run.worst_rad(rad(45.0))) < 1.0
    # a planner that knows of no play leaves the held end about half of it from where it means to be
    blind = _run(plant, Planned(), _task(plant.without("chuck_backlash")))
    assert deg(blind.worst_rad(rad(45.0))) > 2.0


def test_it_says_what_it_expects_and_keeps_its_word() -> None:
    plant = load_parameters("rig_elastic")
    run = _run(plant, Planned(), _task(plant))
    assert run.notes[0].startswith("plans 3 rotations, expects 0.")
    told = float(run.notes[-1].split("95 %: ")[1].split("°")[0])
    assert deg(run.worst_rad(rad(45.0))) <= told + 0.3


def test_no_waypoint_beyond_the_bound_or_the_drive() -> None:
    plant = load_parameters("rig_elastic")
    run = _run(plant, Planned(largest_overshoot_deg=20.0), _task(plant))
    assert max(deg(m.base_angle_rad) for m in run.history) <= 65.0 + 1e-6
    run = _run(plant, Planned(), _task(plant, angle_limit_rad=rad(70.0)))
    assert max(abs(deg(m.base_angle_rad)) for m in run.history) <= 70.0 + 1e-6


def test_refusals_are_sentences() -> None:
    plant = load_parameters("rig_elastic")
    with pytest.raises(BadInput, match="planned needs a model of this rig: give a model file"):
        Planned().check(_task(None))
    with pytest.raises(BadInput, match=r"its error was 7\.2 times the noise floor, limit 5"):
        Planned().check(_task(plant, trust=Trust({}, 7.2)))
    Planned(largest_error=8.0).check(_task(plant, trust=Trust({}, 7.2)))
    other = dataclasses.replace(plant, layout=MODEL_LAYOUT)
    with pytest.raises(BadInput, match="is of a rig with 1 tissue sections"):
        Planned().check(dataclasses.replace(_task(other), layout=EXPERIMENT_LAYOUT))
    for options in ({"quantile": 0.3}, {"largest_overshoot_deg": 0.0}, {"motions": 0}):
        with pytest.raises(BadInput):
            make_strategy("planned", options)


def test_friction_of_the_run_is_found_from_the_torque() -> None:
    plant = load_parameters("rig_elastic")
    for factor in (0.9, 1.1):
        needle = plant.with_effects(FrictionOfTrial(factor))
        run = run_settled(needle, Planned(), _task(plant), np.random.default_rng(3), Noise())
        found, spread = Planned().belief(_task(plant), run.history[:2], PLENTY).friction_factor()
        assert found == pytest.approx(factor, abs=0.03)
        assert 0.0 < spread < 0.05


@pytest.mark.whole
def test_same_input_same_plan() -> None:
    plant = load_parameters("rig_elastic")
    runs = [_run(plant, Planned(), _task(plant), seed=5) for _ in range(2)]
    assert [m.base_angle_rad for m in runs[0].history] == [m.base_angle_rad for m in runs[1].history]


def test_a_motion_more_is_taken_when_it_is_worth_its_price() -> None:
    plant = load_parameters("rig_elastic")
    task = _task(plant)
    history = _run_history(plant, task)
    likely = needles(first_belief(plant, {}, 1e-6), task, history, 1, PLENTY)
    lengths = []
    for price_deg in (0.01, 0.15, 60.0):
        aim = Aim(task, 0.0, rad(120.0), 0.5, 0.9, rad(price_deg))
        plan = cheapest(likeliest_plans(aim, likely[0], 4, PLENTY))
        again = carry_out(aim, likely, plan.angles_rad, PLENTY)
        assert again.worst_rad == pytest.approx(plan.ends.worst_rad)
        lengths.append(len(plan.angles_rad))
    assert lengths[0] >= lengths[1] == 2
    assert lengths[2] == 1


def test_what_was_the_best_way_to_go_on_stays_so() -> None:
    plant = load_parameters("rig_rigid").with_effects(ChuckBacklash(4.0))
    task = _task(plant)
    history = _run_history(plant, task)
    needle = needles(first_belief(plant, {}, 1e-6), task, history, 1, PLENTY)[0]
    aim = Aim(task, 0.0, rad(120.0), 0.5, 0.9, rad(0.15))
    plan = cheapest(likeliest_plans(aim, needle, 5, PLENTY))
    assert len(plan.angles_rad) >= 4
    travel_s = plan.angles_rad[0] / task.speed_rad_s
    path = Trial(np.array([0.0, travel_s, travel_s + 1.0]), np.array([0.0, *[plan.angles_rad[0]] * 2]))
    there = needle.moved(path)
    rest = dataclasses.replace(aim, base_rad=plan.angles_rad[0])
    going_on = cheapest(likeliest_plans(rest, there, 5, PLENTY))
    assert deg(going_on.ends.worst_rad[0]) == pytest.approx(deg(plan.ends.worst_rad[0]), abs=0.3)
    assert len(going_on.angles_rad) <= len(plan.angles_rad)


def test_a_search_ends_when_its_effort_is_spent() -> None:
    plant = load_parameters("rig_rigid").with_effects(BendingTorque(0.05, 0.02))
    task = _task(plant)
    history = _run_history(plant, task)
    likely = needles(first_belief(plant, {}, 1e-6), task, history, 1, PLENTY)
    aim = Aim(task, 0.0, rad(120.0), 0.5, 0.9, rad(0.15))
    costs = []
    with pytest.raises(Spent):
        likeliest_plans(aim, likely[0], 5, Effort(1.0))
    for solves in (5e2, 2e4, 2e5):
        effort = Effort(solves)
        plan = cheapest(likeliest_plans(aim, likely[0], 5, effort))
        assert effort.left > -1e3
        costs.append(plan.cost_rad)
    assert costs[0] >= costs[1] >= costs[2]
    assert deg(costs[0]) > 10.0 > 3.0 > deg(costs[2])


def test_a_doubt_is_kept_to_the_end() -> None:
    plant, wrong = load_parameters("rig_elastic"), load_parameters("rig_rigid")
    history = _run(plant, Planned(), _task(wrong)).history
    taken = [motion.name for motion in history if motion.reason is Reason.MODEL_DOUBTED]
    assert taken == ["overshoot", "back", "forward", "final"]
    assert [motion.name for motion in history[-4:]] == taken
    assert all(motion.reason is Reason.STRATEGY for motion in history[:-4])


def test_what_a_motion_is_called_is_no_doubt() -> None:
    plant = load_parameters("rig_elastic")
    history = _run(plant, Planned(), _task(plant)).history[:3]
    renamed = tuple(dataclasses.replace(motion, name="overshoot") for motion in history)
    there = Planned().next(_task(plant), history)
    assert there is not None
    assert there.reason is Reason.STRATEGY
    assert Planned().next(_task(plant), renamed) == there
    doubted = (*history[:2], dataclasses.replace(history[2], reason=Reason.MODEL_DOUBTED))
    back = Planned().next(_task(plant), doubted)
    assert back is not None
    assert (back.name, back.reason) == ("back", Reason.MODEL_DOUBTED)
    assert back.angle_rad == pytest.approx(rad(45.0) - 0.75 * history[1].predicted_lag_rad)


def _solves_of_each_plan(
    monkeypatch: pytest.MonkeyPatch, plant: NeedleModel, repetitions: int = 8
) -> tuple[SettledRun, list[int]]:
    """What `planned` does from a wound start, and the solves of each of its plans."""
    spent: list[int] = []
    truth, plan = NeedleModel.truth, Planned.next
    planning = False

    def counted(model: NeedleModel, *args: Any, **options: Any) -> Solution:
        solution = truth(model, *args, **options)
        if planning:
            spent[-1] += solution.solves
        return solution

    def watched(strategy: Planned, *args: Any) -> Waypoint | None:
        nonlocal planning
        spent.append(0)
        planning = True
        waypoint = plan(strategy, *args)
        planning = False
        return waypoint

    monkeypatch.setattr(NeedleModel, "truth", counted)
    monkeypatch.setattr(Planned, "next", watched)
    return _run(plant, Planned(motions=3, repetitions=repetitions), _task(plant), wound_deg=60.0), spent


@pytest.mark.whole
def test_no_plan_spends_more_solves_than_its_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = load_parameters("rig_rigid").with_effects(Stribeck(0.3, 6.0, 6.0))
    run, spent = _solves_of_each_plan(monkeypatch, plant)
    assert len(spent) >= 3
    assert 0.5 * PLAN_SOLVES < max(spent) <= PLAN_SOLVES + 1e3
    assert not any("reed2008" in note for note in run.notes)
    assert deg(run.worst_rad(rad(45.0))) < 5.0


def test_a_needle_that_takes_too_many_solves_is_left_to_reed2008(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("needle_rig.control.strategies.planned.PLAN_SOLVES", 10_000.0)
    plant = load_parameters("rig_rigid").with_effects(Stribeck(0.3, 6.0, 6.0))
    run, spent = _solves_of_each_plan(monkeypatch, plant, repetitions=0)
    assert max(spent) <= 11_000.0
    assert any("snaps too often to be planned with" in note for note in run.notes)
    assert [motion.name for motion in run.history[-4:]] == ["overshoot", "back", "forward", "final"]
    assert {motion.reason for motion in run.history[-4:]} == {Reason.EFFORT_SPENT}


@pytest.mark.whole
def test_a_needle_that_snaps_is_planned_with_at_its_kinetic_friction() -> None:
    plant = load_parameters("rig_rigid").with_effects(Stribeck(0.25, 11.46, 0.05, 1.0), ViscousSlip(0.01))
    run = _run(plant, Planned(), _task(plant))
    assert {motion.reason for motion in run.history} == {Reason.STRATEGY}
    assert deg(run.worst_rad(rad(45.0))) < 0.7


def test_what_is_said_when_the_effort_is_spent_is_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = load_parameters("rig_elastic")
    task = _task(plant)
    history = run_settled(plant, make_strategy("none", {}), task, np.random.default_rng(0), NO_NOISE).history
    turned = (history[0], dataclasses.replace(history[1], reason=Reason.EFFORT_SPENT))
    with monkeypatch.context() as hurried:
        hurried.setattr(planned_module, "PLAN_SOLVES", 10.0)
        first, second = Planned().next(task, turned[:1]), Planned().next(task, turned)
    assert first is not None
    assert (first.name, first.reason) == ("rotate", Reason.EFFORT_SPENT)
    assert first.note.endswith("turning to the target first, as reed2008 does, and planning again from there")
    after_it = Planned().next(task, turned)
    assert after_it is not None
    assert after_it.reason is Reason.STRATEGY
    assert second is not None
    assert second.note.endswith("going on as reed2008")
    assert second.reason is Reason.EFFORT_SPENT


def test_a_sequence_that_takes_too_many_solves_counts_as_bad(monkeypatch: pytest.MonkeyPatch) -> None:
    most = 1000.0
    monkeypatch.setattr(effort_module, "MOST_SOLVES", most)
    snapping = load_parameters("rig_rigid").with_effects(Stribeck(3.0, 6.0, 0.8))
    task = _task(snapping)
    model = first_belief(snapping, {}, 1e-6).model
    state = relaxed(model.rod(Trial(np.empty(0), np.empty(0))))
    aim = Aim(task, 0.0, rad(120.0), 3.0, 0.9, rad(0.15))
    turns = [rad(a) for a in (90.0, 0.0, 90.0, 45.0)]
    effort = Effort(10.0 * most)
    plan = rate(aim, [SettledNeedle(model, state)], turns, effort)
    assert not plan.followed
    assert effort.left == 9.0 * most - CALL_SOLVES
    time_s = np.array([0.0, 2.0])
    with pytest.raises(SolverError, match=r"more than 100 solves after .* s: the needle snaps too often"):
        model.truth(Trial(time_s, np.array([0.0, rad(90.0)])), state, most_solves=100.0)
    # what the whole cannot afford is not a fault of the sequence
    with pytest.raises(Spent):
        rate(aim, [SettledNeedle(model, state)], turns, Effort(0.5 * most))
