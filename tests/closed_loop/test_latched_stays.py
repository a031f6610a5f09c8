"""A latching fault stays until a person clears it, whatever passing fault the host has too.

Virtual time, the host's production code, the firmware's C.
"""

from __future__ import annotations

import pytest

from tests.closed_loop.hazard_trials import broken, broken_promises, reached

OWN = "own-200Hz-fresh"
PASSING = (
    "Hall link silent",
    "Hall magnet out of reach",
    "Hall angles are no numbers",
    "torque is no number",
    "torque link silent",
    "drive link silent",
)
STOPPED = "emergency stop for 1 s"


@pytest.mark.parametrize("latching", [STOPPED, "torque 3 N·mm for 1 s", "encoder jumps by 90°"])
def test_without_another_fault_it_stays(latching: str) -> None:
    trial = reached(OWN, "run", "moving")
    result = broken(trial, (latching, 0.0))
    assert (result.woken, result.moved) == (0, 0)
    assert trial.brain.state.latched


@pytest.mark.parametrize("passing", PASSING)
@pytest.mark.parametrize(
    ("scene", "place"),
    [
        ("run", "moving"),
        pytest.param("hold", "holding", marks=pytest.mark.whole),
        pytest.param("run", "done", marks=pytest.mark.whole),
    ],
)
def test_an_emergency_stop_under_a_passing_fault_stays(passing: str, scene: str, place: str) -> None:
    trial = reached(OWN, scene, place, after_s=0.3)
    result = broken(trial, (passing, 0.0), (STOPPED, 0.3))
    assert (result.woken, result.moved) == (0, 0)
    assert not trial.rig.awake


@pytest.mark.parametrize("latching", ["torque 3 N·mm for 1 s", "encoder jumps by 90°"])
def test_a_limit_of_the_node_under_a_dead_link_stays(latching: str) -> None:
    trial = reached(OWN, "run", "moving")
    result = broken(trial, ("Hall link silent", 0.0), (latching, 0.3))
    assert (result.woken, result.moved) == (0, 0)
    assert not trial.rig.awake


@pytest.mark.parametrize("speed_deg_s", [3, 20, 180])
@pytest.mark.parametrize("passing", [None, "Hall link silent"])
def test_a_shorted_stage_turns_the_base_once(speed_deg_s: int, passing: str | None) -> None:
    name = f"power stage shorted, {speed_deg_s}°/s"
    trial = reached(OWN, "run", "moving")
    breaks = ((name, 0.0),) if passing is None else ((passing, 0.0), (name, 0.3))
    result = broken(trial, *breaks)
    assert broken_promises(OWN, 20.0, result, name) == []


@pytest.mark.parametrize("passing", ["Hall link silent for 0.3 s", "Hall link comes and goes"])
def test_an_emergency_stop_outlasts_a_link_that_comes_back(passing: str) -> None:
    trial = reached(OWN, "run", "moving")
    result = broken(trial, (passing, 0.0), (STOPPED, 0.1))
    assert (result.woken, result.moved) == (0, 0)
    assert not trial.rig.awake


def test_a_person_s_clear_wakes_the_drive_again() -> None:
    trial = reached(OWN, "run", "moving")
    assert broken(trial, (STOPPED, 0.0)).name == "emergency_stop"
    trial.brain.clear()
    trial.latches.cleared()
    for _ in range(100):
        trial.tick()
    assert trial.rig.awake
    assert trial.latches.woken == 0
    assert trial.brain.state.fault_name is None
