"""Whether the last run that the watch looked at contradicts a model that is to plan with."""

from __future__ import annotations

import math
from collections.abc import Sequence

from scipy.special import chdtrc

from needle_rig.model import SavedModel
from needle_rig.workbench.learning.watched_runs import WatchedRun
from needle_rig.workbench.selection.values import CONTRADICTS, spelt_sigmas, with_uncertainty


def contradiction(runs: Sequence[WatchedRun], saved: SavedModel, named: str) -> str:
    """What the newest judged run says against the model that a person calls `named`, and what to do; empty
    where it says nothing.

    Values are compared as independent ones, which a single run does not tell better.
    """
    judged = [run for run in runs if not run.not_judged]
    said = against(judged[-1], saved) if judged else ""
    return f"{said}; find out which is true: needle-rig compare last --model {named}" if said else ""


def against(run: WatchedRun, saved: SavedModel) -> str:
    """What one run says against the model, in words; empty where nothing does."""
    values = saved.model.values()
    away = {
        name: (of.value - values[name]) / math.hypot(of.uncertainty, saved.uncertainties.get(name, 0.0))
        for name, of in run.parameters.items()
        if name in values and of.uncertainty > 0.0
    }
    if not away or chdtrc(len(away), sum(each**2 for each in away.values())) >= CONTRADICTS:
        return ""
    worst = max(away, key=lambda name: abs(away[name]))
    of = run.parameters[worst]
    there = with_uncertainty(values[worst], saved.uncertainties.get(worst))
    return (
        f"the last run {run.run} contradicts the model {saved.model.name}: {worst} was"
        f" {with_uncertainty(of.value, of.uncertainty)} {of.unit} there, the model says {there},"
        f" {spelt_sigmas(away[worst])} apart"
    )
