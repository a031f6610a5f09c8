"""A drive of another make has no guard of motion: the host sees its motion however old its answers are.

The production CiA 402 driver, the drive's twin and the production brain in virtual time.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from campaigns.rig.hazard.scenes import SCENES
from campaigns.rig.hazard.setups import SETUPS
from campaigns.rig.hazard.trial import Trial
from tests.closed_loop.hazard_trials import broken, broken_promises, reached

FAULTS = (
    "encoder stands still",
    "motor is wired backwards",
    "power stage shorted, 110°/s",
    "motor turns at triple",
)


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize(
    "setup",
    [
        "cia402-200Hz-fresh",
        "cia402-200Hz-ftdi",
        "cia402-50Hz-fresh",
        "cia402-1000Hz-near50ms",
        "cia402-200Hz-near50ms",
        "cia402-50Hz-near50ms",
        "cia402-200Hz-near100ms",
    ],
)
def test_a_motor_that_does_not_obey_is_stopped_within_the_derived_bound(setup: str, name: str) -> None:
    trial = reached(setup, "three turns", "moving", 20.0)
    result = broken(trial, (name, 0.0), left_s=20.0)
    assert result.name
    assert broken_promises(setup, 20.0, result, name) == []


@pytest.mark.parametrize(("late_ms", "tick_ms"), [(22, 20), (40, 5), (40, 20)])
def test_an_answer_is_as_old_as_its_way_is_long(late_ms: int, tick_ms: int) -> None:
    setup = replace(SETUPS["cia402-200Hz-fresh"], late_ms=late_ms, tick_ms=tick_ms, age_limit_ms=250.0)
    trial = Trial(setup, SCENES["hold"], 20.0, 1)
    youngest_s = []
    for _ in range(round(1000 / tick_ms)):
        trial.tick()
        youngest_s.append(trial.rig.read().drive_age_s)
    assert min(youngest_s[20:]) > (late_ms - 1.5) * 1e-3
