"""What can explain settled values: every effect added to the current model, and those that tie.

An effect ties when it meets the values within their scatter with parameters that are plausible, and leaves
something to test it by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from needle_rig.dataset.settled import SettledData
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import NEEDLE, fitting
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.baseline import FRICTIONS_N, element_length
from needle_rig.workbench.estimation.parameters import FreeParameter, scaled_values_of
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.published.fit import SettledFit, SettledProblem, fit_settled
from needle_rig.workbench.selection.answer import SIGMAS_95
from needle_rig.workbench.selection.rivals import cannot_be_told_apart


@dataclass(frozen=True)
class Candidate:
    """The current model with one effect more; `fit` is None when the effect changes none of the values."""

    effect: str
    fit: SettledFit | None
    adjusted_p: float
    """Šidák-adjusted p value of the gain over the current model."""

    @property
    def meets(self) -> bool:
        """Whether the values are met within their scatter."""
        return self.fit is not None and self.fit.p_value > POLICY.evidence.significance

    @property
    def testable(self) -> bool:
        """Whether the fit leaves a degree of freedom; priors make it no whole number."""
        return self.fit is not None and round(self.fit.freedom) > 0

    @property
    def plausible(self) -> bool:
        """Whether every parameter of the effect is within its plausible range."""
        return self.fit is not None and bool(
            np.all(np.abs(effect_parameters(self.fit, self.effect)[1]) <= SIGMAS_95)
        )

    @property
    def explains(self) -> bool:
        """Whether the effect is significant, plausible and testable and meets the values."""
        return (
            self.meets and self.testable and self.plausible and self.adjusted_p < POLICY.evidence.significance
        )


def settled_problem(
    data: SettledData, library: Mapping[str, type[Effect]], model: NeedleModel | None = None
) -> tuple[SettledProblem, SettledFit]:
    """The values with the current model (default: the null model) fitted to them. Raises BadInput."""
    current = model or NeedleModel(
        "null", data.layout, data.needle.torsional_rigidity_nm2, FRICTIONS_N[2], element_length_m=0.5e-3
    )
    problem = values_to_meet(data, library, current)
    effects = tuple(e.name() for e in current.effects)
    start = None
    if effects:
        at = scaled_values_of(problem.parameters(effects), current.effects)
        start = [np.r_[np.log(f), 0.0, at] for f in (current.friction_n, *FRICTIONS_N)]
    found = fit_settled(problem, effects, start)
    if found is None:
        raise BadInput(
            f"{data.name}: the current model cannot be solved on these sequences; check the layout"
        )
    return problem, found


def values_to_meet(
    data: SettledData, library: Mapping[str, type[Effect]], current: NeedleModel
) -> SettledProblem:
    """The weighed values, to be met by a model that begins as `current`. Raises BadInput."""
    if len(current.layout.sensor_positions_m) != len(data.sensor_names):
        raise BadInput(
            f"{data.name} has {len(data.sensor_names)} Hall sensors and the model {current.name}"
            f" {len(current.layout.sensor_positions_m)}; give a model made for this rig"
        )
    base = dataclasses.replace(
        current,
        layout=data.layout,
        torsional_rigidity_nm2=data.needle.torsional_rigidity_nm2,
        effects=(),
        element_length_m=element_length(current),
    )
    effects = {e.name(): type(e) for e in current.effects}
    return SettledProblem(data, base, {**fitting(library, NEEDLE), **effects}, data.weighed)


def try_effect(problem: SettledProblem, root: SettledFit, name: str, library: int) -> Candidate:
    """The current model with the effect `name`, one of `library` that are tried."""
    found = fit_settled(problem, (*root.effects, name), within=root)
    if found is None:
        return Candidate(name, None, 1.0)
    gain = max(root.objective - found.objective, 0.0)
    p = float(chdtrc(max(1.0, root.freedom - found.freedom), gain))
    return Candidate(name, found, float(-np.expm1(library * np.log1p(-min(p, 1 - 1e-16)))))


def tied_effects(problem: SettledProblem, tried: list[Candidate]) -> list[Candidate]:
    """Effects that explain the values and tie, most plausible first, without generalisations of each
    other."""
    able = {c.effect: c for c in tried if c.explains}
    objective = {c.effect: c.fit.objective for c in able.values() if c.fit}
    least = min(objective.values(), default=0.0)
    close = {e for e, value in objective.items() if cannot_be_told_apart(value - least)}

    def tied(effect: str) -> bool:
        special = [objective[e] for e in problem.library[effect].limits if e in close]
        gain = min(special) - objective[effect] if special else None
        return cannot_be_told_apart(objective[effect] - least, gain_over_special=gain)

    return [able[e] for e in sorted(close, key=lambda e: (objective[e], e)) if tied(e)]


def fits_of(candidates: list[Candidate]) -> list[SettledFit]:
    """The fits of those candidates that have one, in the same order."""
    return [c.fit for c in candidates if c.fit is not None]


def effect_parameters(
    found: SettledFit, effect: str
) -> tuple[list[tuple[FreeParameter, float, float]], np.ndarray]:
    """(parameter, scaled value, its standard deviation) of one effect, and their pulls (k,) in σ."""
    rows = [
        (a, float(x), float(e), float(p))
        for a, x, e, p in zip(found.parameters, found.x[2:], found.error, found.pulls, strict=True)
        if a.effect == effect
    ]
    return [r[:3] for r in rows], np.array([r[3] for r in rows])
