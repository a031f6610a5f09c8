"""A sample of scripts/hazards: every fault once in mid-motion, at the fastest speed."""

from __future__ import annotations

import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from typing import Any

import pytest

HARMLESS = {
    "host stands still for 45 ms",  # the drive waits for 50
    "motor turns at double",  # its loop takes it back
    "Hall angle stands still",  # until its neighbours are too far away
}


@pytest.fixture(scope="module")
def hazards() -> Any:
    path = Path(__file__).parents[2] / "scripts" / "hazards"
    loader = SourceFileLoader("hazards", str(path))
    spec = spec_from_loader("hazards", loader)
    assert spec is not None
    module = module_from_spec(spec)
    sys.modules["hazards"] = module
    loader.exec_module(module)
    return module


def test_no_single_fault_takes_the_base_beyond_its_bound_and_each_has_a_name(hazards: Any) -> None:
    trial = hazards.Trial(60.0, 1, seed=7)
    while trial.brain.state.phase.value != "moving" or trial.true_deg < 10.0:
        trial.tick()
    found = {}
    for name, inject in hazards.FAULTS.items():
        found[name] = hazards.in_a_copy(lambda: hazards.aftermath(trial, inject, trial.seconds))  # noqa: B023
    assert len(found) >= 30
    far = {name: result for name, result in found.items() if not result.beyond_deg <= hazards.BOUND_DEG}
    assert not far
    unnamed = {name for name, result in found.items() if not result.name}
    assert unnamed <= HARMLESS
