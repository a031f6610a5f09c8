"""Faults that creep below every limit of a single tick: torque and Hall angles show them in the end.

Virtual time, the host's production code, the firmware's C.
"""

from __future__ import annotations

import pytest

from campaigns.rig.hazard.setups import DISAGREEMENT_DEG
from tests.closed_loop.hazard_trials import broken, broken_promises, reached

OWN = "own-200Hz-fresh"


@pytest.mark.whole
@pytest.mark.parametrize("rate_deg_s", [0.3, pytest.param(0.1, marks=pytest.mark.slow)])
def test_an_encoder_that_creeps_while_the_base_is_held_is_named(rate_deg_s: float) -> None:
    trial = reached(OWN, "hold", "holding")
    left_s = 1.2 * DISAGREEMENT_DEG / rate_deg_s
    result = broken(trial, (f"encoder creeps {rate_deg_s:g}°/s", 0.0), left_s=left_s)
    assert result.name
    assert result.asked_deg <= DISAGREEMENT_DEG
    assert result.ended


@pytest.mark.slow
def test_an_encoder_that_creeps_over_several_motions_is_held_against_the_first_rest() -> None:
    trial = reached(OWN, "settle 60 s", "moving")
    result = broken(trial, ("encoder creeps 0.1°/s", 0.0), left_s=190.0)
    assert result.name
    assert max(result.asked_deg, result.commanded_deg) <= DISAGREEMENT_DEG


@pytest.mark.whole
@pytest.mark.parametrize("name", ["encoder fades to half in 20 s", "encoder reads 0.9", "encoder reads 1.05"])
def test_an_encoder_whose_scale_is_wrong_is_named_before_the_base_is_far_off(name: str) -> None:
    trial = reached(OWN, "three turns", "moving", 60.0)
    result = broken(trial, (name, 0.0), left_s=30.0)
    assert broken_promises(OWN, 60.0, result, name) == []


@pytest.mark.whole
def test_a_base_that_turns_by_itself_after_a_run_is_seen_by_the_hall_angles() -> None:
    trial = reached(OWN, "run", "done", after_s=0.3)
    result = broken(trial, ("encoder stands still", 0.0), ("power stage shorted, 180°/s", 0.1))
    assert result.name
    assert result.ended


@pytest.mark.parametrize("name", ["encoder stands still", "power stage shorted, 180°/s"])
def test_either_of_the_two_alone_ends_after_a_run(name: str) -> None:
    trial = reached(OWN, "run", "done", after_s=0.3)
    result = broken(trial, (name, 0.0))
    assert broken_promises(OWN, 20.0, result, name) == []


@pytest.mark.whole
def test_a_needle_that_is_wound_up_over_several_sequences_is_stopped_at_the_limit() -> None:
    name = "needle caught, tip held fast"
    trial = reached(OWN, "wind", "before", after_s=0.1)
    result = broken(trial, (name, 0.0), left_s=40.0)
    assert result.windup_deg > 240.0
    assert broken_promises(OWN, 60.0, result, name) == []
    assert result.name == "windup_limit"
