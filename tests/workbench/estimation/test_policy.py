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


@pytest.mark.parametrize(("sigmas", "driven_finely"), [(3.5, False), (7.0, True)])
def test_a_discretisation_error_of_five_sigmas_is_no_straight_nuisance(
    monkeypatch: pytest.MonkeyPatch, sigmas: float, driven_finely: bool
) -> None:
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
    problem: Any = SimpleNamespace(size=100)
    found: Any = Found(100.0, np.zeros((2, 2)))
    discretisation_error.with_discretisation_error(problem, found, [], 1e-3)
    assert bool(finely) is driven_finely
