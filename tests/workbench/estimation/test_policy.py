"""A row on either side of the threshold of the discretisation error."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.workbench.estimation import discretisation_error


@dataclass(frozen=True)
class Found:
    """What of a fit is looked at."""

    objective: float
    covariance: Array
    parameters: tuple[Any, ...]
    vector: Any


@dataclass(frozen=True)
class Rods:
    """A problem whose rods' slip limits have a memory or not."""

    memory: bool
    size: int = 100
    trials: tuple[Any, ...] = (SimpleNamespace(trial=None),)

    def model(self, *_: object) -> Any:
        return SimpleNamespace(rod=lambda _: SimpleNamespace(depends_on_rate=(False, False, self.memory)))


@pytest.mark.parametrize(
    ("sigmas", "memory", "driven_finely"),
    [(3.5, False, False), (7.0, False, True), (0.5, True, True), (0.0, True, False)],
)
def test_a_discretisation_error_of_five_sigmas_is_no_straight_nuisance(
    monkeypatch: pytest.MonkeyPatch, sigmas: float, memory: bool, driven_finely: bool
) -> None:
    """None is straight where a slip limit has a memory."""
    finely = []

    def by_every_sample(problem: Any, found: Any, _: object) -> tuple[Any, Any]:
        finely.append(1)
        return problem, found

    monkeypatch.setattr(discretisation_error, "whitened_error", lambda *_: (np.array([[sigmas]]),))
    monkeypatch.setattr(
        discretisation_error, "_as_first_nuisance", lambda problem, found, _: (problem, found)
    )
    monkeypatch.setattr(discretisation_error, "by_every_sample", by_every_sample)
    monkeypatch.setattr(discretisation_error, "over_profiles", lambda _, found: found)
    monkeypatch.setattr(discretisation_error, "_between_imputations", lambda *_: np.zeros((2, 2)))
    problem: Any = Rods(memory)
    found: Any = Found(100.0, np.zeros((2, 2)), (), None)
    discretisation_error.with_discretisation_error(problem, found, [], 1e-3)
    assert bool(finely) is driven_finely
