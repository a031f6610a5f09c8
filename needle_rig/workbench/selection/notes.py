"""What a diagnosis says in sentences beside its numbers."""

from __future__ import annotations

import math

import numpy as np

from needle_rig.units import per_100mm
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.decisions import may_snap
from needle_rig.workbench.selection.ranking import values_of
from needle_rig.workbench.selection.search import SearchTrace


def contrived(search: SearchTrace, named: list[str], assumed_noise: bool) -> list[str]:
    """What to say of a set that meets the data but is too many effects: at values that none should have, or
    beside noise that the residual alone shows."""
    found, validation = search.fits[search.best]
    odd = [(e, v) for e in named for v in values_of(found, e) if not v.plausible]
    if len(named) <= POLICY.verdict.at_any_value or not (odd or assumed_noise):
        return []
    said = ", ".join(f"{effect} {v.name} = {v.value:.3g} {v.unit}" for effect, v in odd)
    why = f"with values outside what is plausible ({said})" if odd else "beside noise that nothing else shows"
    before = search.root_validation.error
    after = math.inf if validation is None else validation.error
    known = max(before, after) < math.inf
    held_out = f" (on commands left out {before:.3g} → {after:.3g} × the noise)" if known else ""
    return [
        f"{', '.join(named[:-1])} and {named[-1]} together come nearer the data{held_out}, but {why}: they"
        " describe what is missing, they are not named for it."
    ]


def not_refitted(search: SearchTrace, named: list[str]) -> list[str]:
    """What was not fitted in the place of an effect, since screening promises too little of it."""
    notes = []
    here = search.fits[search.best][0].objective
    for effect in named:
        rest = frozenset(search.best - {effect})
        left_out = [
            c
            for c in search.children.get(rest, ())
            if c.fit is None and rest | {c.effect} not in search.fits and c.effect not in search.best
        ]
        if left_out:
            most = max(left_out, key=lambda c: (c.screening.gain, c.effect))
            gain = search.fits[rest][0].objective - here
            notes.append(
                f"In the place of {effect}, {len(left_out)} effects were not refitted: screening promises"
                f" at most {100 * most.screening.gain / max(gain, 1e-9):.0f} % of its gain ({most.effect})."
            )
    return notes


def partial(named: list[str], share: float, validation: CrossValidation) -> list[str]:
    """That effects leave more than the noise; `share` of the error is removed by them."""
    left = (
        f" and leaves {validation.error:.2f} × the noise on commands left out"
        if math.isfinite(validation.error)
        else ""
    )
    return [f"{' with '.join(named)} removes {100 * share:.1f} % of the error{left}: not the whole truth."]


def constrained_means(found: Fit) -> list[str]:
    """Notes on factors with a constrained mean: what all items share is friction."""
    fields = sorted({f"{a.effect} {a.field}" for a in found.parameters if a.info.relative})
    friction_nmm_per_100mm = per_100mm(float(np.exp(found.vector.log_friction)))
    return [
        f"The mean of {field} is held at 1: what all items share is friction,"
        f" here {friction_nmm_per_100mm:.3g} N·mm per 100 mm."
        for field in fields
    ]


def negligible(search: SearchTrace) -> list[str]:
    """Effects that are seen and too small to matter, with their sizes."""
    notes = []
    for name, found in search.negligible.items():
        said = ", ".join(f"{v.name} = {v.value:.3g} {v.unit}" for v in values_of(found, name))
        if may_snap(search.problem, search.fits[search.best][0], name):
            notes.append(
                f"{name} is seen ({said}), and how much there is of it cannot be told: with an excess that is"
                " lost within less slip the needle snaps, and what a snap leaves looks like less of it."
            )
        else:
            notes.append(f"{name} is seen, but too small to matter ({said}).")
    return notes
