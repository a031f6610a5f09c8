"""Small datasets with a hidden effect, and small libraries, for the workbench's tests."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation, staircase
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.workbench.estimation import map_fit
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.selection import candidates
from needle_rig.workbench.selection.diagnose import Diagnosis, diagnose
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise

PROTOCOL = Protocol(
    "short",
    (
        compensation(45.0),
        compensation(45.0),
        compensation(-45.0),
        staircase((30.0, 60.0, 20.0, -20.0, 10.0), 30.0, 1.5),
        compensation(45.0),
    ),
)
FEW = ("tissue_elasticity", "chuck_backlash", "torque_bias", "hall_offset", "tip_friction")


def few(*names: str) -> dict[str, type[Effect]]:
    every = find_effects()
    return {name: every[name] for name in names or FEW}


@lru_cache
def dataset(*effects: Effect, seed: int = 1, name: str = "hidden", noise: Noise | None = None) -> Dataset:
    model = load_parameters("rig_rigid").with_effects(*effects)
    return simulate_dataset(model, PROTOCOL, seed, noise, name=name)


@lru_cache
def null_fit(
    *hidden: Effect, seed: int = 1, noise: Noise | None = None, library: tuple[str, ...] = FEW
) -> Baseline:
    """The null model held against such a dataset: the answer is always the same, so it is asked once."""
    return fit_baseline(dataset(*hidden, seed=seed, noise=noise), None, few(*library))


@lru_cache
def diagnosed(*hidden: Effect, seed: int = 1, library: tuple[str, ...] = FEW) -> Diagnosis:
    """What is missing in the null model of such a dataset; it, too, is asked once."""
    return diagnose(dataset(*hidden, seed=seed), few(*library))


def fit(problem: Problem, effects: Sequence[str], start: ParameterVector, **settings: Any) -> Fit:
    """The nearest minimum from `start`, which there is."""
    found = map_fit.fit(problem, effects, start, **settings)
    assert found is not None
    return found


@dataclass(frozen=True)
class Tried:
    """An effect on top of a model: the fit with it, and what it predicts of commands left out."""

    fit: Fit
    validation: CrossValidation


def try_effect(problem: Problem, parent: Fit, name: str) -> Tried:
    """The named effect on top of `parent`, which could be fitted."""
    found = candidates.try_effect(problem, parent, name)
    assert found.fit is not None
    assert found.validation is not None
    return Tried(found.fit, found.validation)


def effect(name: str, **values: float | tuple[float, ...]) -> Effect:
    return find_effects()[name](**values)
