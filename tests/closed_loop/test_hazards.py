"""A sample of `hazards`, and the figures by which it judges."""

from __future__ import annotations

import json
from argparse import Namespace
from dataclasses import replace

import pytest

from campaigns.rig.hazard.campaign import Found, broken, in_a_copy, results, until
from campaigns.rig.hazard.cases import Case
from campaigns.rig.hazard.faults import FAULTS, LATCHING, PASSING
from campaigns.rig.hazard.figures import ON_ITS_WAY_MS, Asked, Commanded, Hull, Latches
from campaigns.rig.hazard.plans import Plan, pairs, singles
from campaigns.rig.hazard.scenes import SCENES, SLOW
from campaigns.rig.hazard.setups import BOUND_DEG, DISAGREEMENT_DEG, SETUPS
from campaigns.rig.hazard.tables import report
from campaigns.rig.hazard.trial import Result, Trial
from campaigns.rig.hazards import CAMPAIGN, ask, failed, plan, table, trials
from campaigns.run import run
from needle_rig.units import deg, nmm

QUIET = Result(0.0, 0.0, 0.0, ended=True, off_ms=None, name="", named_ms=None, woken=0, moved=0)
SAMPLE = (
    "encoder stands still",
    "encoder counts backwards",
    "motor is wired backwards",
    "power stage shorted, 20°/s",
    "drive resets",
    "Hall link silent",
    "commands do not arrive",
    "emergency stop",
)


def test_a_hull_is_left_on_either_side() -> None:
    hull = Hull(-2.0, 3.0)
    assert (hull.outside_deg(1.0), hull.outside_deg(5.0), hull.outside_deg(-2.5)) == (0.0, 2.0, 0.5)
    hull.add(6.0)
    assert hull.outside_deg(5.0) == 0.0


def test_a_base_that_follows_wrong_commands_is_beyond_what_was_asked_and_not_beyond_what_was_commanded() -> (
    None
):
    commanded, asked = Commanded(0.0), Asked(0.0)
    asked.order(0.0)
    asked.waypoint(10.0)
    for _ in range(1000):
        commanded.went(20.0, 0.001)
    assert commanded.beyond_deg(20.0) == pytest.approx(0.0, abs=1e-9)
    assert commanded.beyond_deg(23.0) == pytest.approx(3.0)
    assert asked.beyond_deg(20.0) == 10.0
    assert asked.beyond_deg(-1.0) == 1.0


def test_a_new_order_begins_where_the_base_is() -> None:
    asked = Asked(0.0)
    asked.waypoint(90.0)
    asked.order(40.0)
    assert asked.beyond_deg(80.0) == 40.0


def look(latches: Latches, ms: int = 1, **now: bool) -> None:
    quiet = dict.fromkeys(("latched", "pressed", "awake", "running", "moving", "ordered"), False)
    for _ in range(ms):
        latches.look(**{**quiet, **now})


def test_a_supply_that_comes_on_after_a_latch_is_counted_until_a_person_clears() -> None:
    latches = Latches()
    look(latches, awake=True, ordered=True)
    look(latches, latched=True)
    look(latches, 2 * ON_ITS_WAY_MS)
    look(latches, awake=True)
    assert latches.woken == 1
    look(latches)
    latches.cleared()
    look(latches, awake=True)
    assert latches.woken == 1


def test_an_emergency_stop_latches_a_drive_that_was_awake() -> None:
    for awake, woken in ((True, 1), (False, 0)):
        latches = Latches()
        look(latches, awake=awake)
        look(latches, 2 * ON_ITS_WAY_MS, pressed=True)
        look(latches, awake=True)
        assert latches.woken == woken


def test_motion_without_an_order_is_counted_once_the_supply_came_on_by_itself() -> None:
    latches = Latches()
    look(latches, awake=True, ordered=True, moving=True)
    look(latches, awake=True)
    look(latches, awake=True, moving=True)  # the fault's own motion: its supply was never off
    assert latches.moved == 0
    look(latches)
    look(latches, awake=True)
    look(latches, awake=True, moving=True)
    assert latches.moved == 1


@pytest.mark.parametrize(
    ("result", "count"),
    [
        (QUIET, 0),
        (replace(QUIET, commanded_deg=5.1), 1),
        (replace(QUIET, asked_deg=5.1), 1),
        (replace(QUIET, ended=False, woken=1, moved=2), 3),
        (replace(QUIET, windup_deg=300.0), 1),
    ],
)
def test_each_promise_is_held_against_its_figure(result: Result, count: int) -> None:
    case = Case("single", "own-200Hz-fresh", "run", 60.0, 1, 9, (("encoder stands still", 0.0),))
    assert len(case.broken(result)) == count
    assert Case.parse(case.text) == case


def test_bounds_are_those_of_the_drive_and_of_the_fault() -> None:
    own, other = SETUPS["own-50Hz-near50ms"], SETUPS["cia402-50Hz-fresh"]
    assert own.bound_deg(60.0, 180.0, lies_by_little=False) == BOUND_DEG
    assert own.bound_deg(60.0, 60.0, lies_by_little=True) == DISAGREEMENT_DEG
    # 1.5° + 60 ms × 60°/s + 60°/s × (50 + 42 + 12) ms + 60²/4000°
    assert other.bound_deg(60.0, 60.0, lies_by_little=False) == pytest.approx(1.5 + 3.6 + 6.24 + 0.9)


def test_a_line_of_another_version_is_refused_in_one_sentence() -> None:
    for line in ("single|own", "single|own-200Hz-fresh|run|60|1|9||no such fault@0.000"):
        with pytest.raises(ValueError, match=r"copy the whole line|another version"):
            Case.parse(line)


def test_every_name_in_a_list_is_a_fault_and_there_are_sixty() -> None:
    named = {*PASSING, *LATCHING, *(name for _, _, name in SLOW)}
    assert named <= set(FAULTS)
    assert {scene for scene, _, _ in SLOW} <= set(SCENES)
    assert len(FAULTS) >= 60
    assert {name for name, fault in FAULTS.items() if fault.slow} <= {name for _, _, name in SLOW}


def test_the_campaign_asks_every_fault_at_every_place_and_every_setup() -> None:
    found = list(singles(20, seed=1))
    assert {plan.setup for plan in found} == set(SETUPS)
    asked = {(place, breaks[-1][0]) for plan in found for _, place, many in plan.places for breaks in many}
    quick = {name for name, fault in FAULTS.items() if not fault.slow}
    for place in ("before", "moving", "between", "seam", "done", "holding", "any"):
        assert {name for at, name in asked if at == place} == quick
    assert sum(plan.trials for plan in pairs(37, seed=1)) == 37


@pytest.mark.parametrize("drive", [pytest.param("own", marks=pytest.mark.whole), "cia402"])
def test_no_fault_of_a_sample_takes_the_base_beyond_its_bound_and_each_has_a_name(drive: str) -> None:
    breaks = tuple(((name, 0.0),) for name in SAMPLE)
    sequence = Plan(f"{drive}-200Hz-fresh", "run", 60.0, 7, (("single", "moving", breaks),))
    found = [one for one in results(sequence) if isinstance(one, Found)]
    assert len(found) == len(SAMPLE)
    assert {one.case.text: one.case.broken(one.result) for one in found if one.case.broken(one.result)} == {}
    assert [one.case.text for one in found if not one.result.name] == []
    assert [one.case.text for one in found if one.result.off_ms is None] == []
    text = report(found, [], "head")
    assert "| encoder stands still | " + drive in text
    assert f"0 of {len(SAMPLE)} trials" in text


@pytest.mark.parametrize("drive", [pytest.param("own", marks=pytest.mark.whole), "cia402"])
def test_a_trial_can_be_repeated_by_its_line(drive: str) -> None:
    breaks = ((("Hall angle jumps by 90°", 0.0), ("encoder reads half", 0.1)),)
    sequence = Plan(f"{drive}-50Hz-fresh", "run", 20.0, 3, (("pair", "seam", breaks),))
    (found,) = results(sequence)
    assert isinstance(found, Found)
    assert Found.parse(found.line()) == replace(found, cpu_s=round(found.cpu_s, 3))
    case = Case.parse(found.case.text)
    assert case.place == "seam"
    assert broken(until(case), case, left_s=3.0) == found.result


@pytest.mark.whole
def test_the_spring_stands_for_the_finite_elements() -> None:
    figures = {}
    for exact in (True, False):
        trial = Trial(SETUPS["own-200Hz-fresh"], SCENES["run"], 20.0, 7, finite_elements=exact)
        while trial.orders_given == 0 or trial.brain.busy:
            trial.tick()
        plant = trial.rig.plant
        lag_deg = [abs(trial.true_deg - deg(angle)) for angle in plant.hall_rad]
        figures[exact] = (lag_deg[0] / abs(nmm(plant.torque_nm)), lag_deg[-1] / lag_deg[0], trial.true_deg)
    for spring, elements, share in zip(figures[False], figures[True], (0.05, 0.05, 0.01), strict=True):
        assert spring == pytest.approx(elements, rel=share)


@pytest.mark.parametrize("name", ["encoder reads 0.7", "coupling slips", "torque stands still"])
def test_what_the_host_sees_by_torque_and_hall_angles_it_sees_with_either_needle(name: str) -> None:
    told = {}
    for exact in (True, False):
        trial = Trial(SETUPS["own-200Hz-fresh"], SCENES["run"], 60.0, 7, finite_elements=exact)
        case = Case("single", "own-200Hz-fresh", "run", 60.0, 7, 60, ((name, 0.0),))
        while trial.ticks < case.tick:
            trial.tick()
        told[exact] = broken(trial, case, left_s=5.0)
    assert told[True].name == told[False].name
    assert told[True].asked_deg == pytest.approx(told[False].asked_deg, abs=4.0)


def test_an_error_in_a_copy_is_no_result() -> None:
    with pytest.raises(RuntimeError):
        in_a_copy(lambda: {"no": object()})


def test_a_line_that_is_no_trial_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("hazards", CAMPAIGN, ["--only", '{"trial": "nonsense"}']) == 1
    assert "copy the whole line" in capsys.readouterr().out


def test_a_fault_that_is_unknown_is_one_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        run("hazards", CAMPAIGN, ["--fault", "no such fault"])
    assert "no fault's name" in capsys.readouterr().err


@pytest.mark.whole
def test_a_row_holds_every_trial_of_a_sequence() -> None:
    given = Namespace(size=1, first_seed=1, fault="emergency")
    (task,) = [t for t in plan(given) if t["setup"].startswith("cia402") and t["kind"] == "single"][:1]
    row = json.loads(json.dumps({**task, **ask(json.loads(json.dumps(task)), given)}))
    assert {one.case.breaks[0][0] for one in trials([row])} == {n for n in FAULTS if "emergency" in n}
    assert not failed([row])
    assert "| emergency stop | cia402 |" in table([row], given)
