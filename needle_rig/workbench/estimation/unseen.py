"""Parameters of a fit on which no reading depends: what a fit leaves where it began is no finding."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from needle_rig.physics.needle_model import FRICTION, TORSIONAL_RIGIDITY
from needle_rig.workbench.estimation.linear import UNSEEN, LinearisedFit
from needle_rig.workbench.estimation.problem import Fit, Problem


def unseen_names(problem: Problem, found: Fit) -> list[str]:
    """The shared parameters that all readings together see less than `UNSEEN`, as files call them.

    Parameters are given in e-folds or typical sizes: the readings would know one to 30 of them at best.
    """
    names = (FRICTION, TORSIONAL_RIGIDITY, *(f"{p.effect}.{p.name}" for p in found.parameters))
    linear = LinearisedFit.of(problem, found)
    seen = np.sum([information.diagonal() for information in linear.information], axis=0)
    return [name for name, value in zip(names, seen, strict=False) if value < UNSEEN]


def unseen_sentences(unseen: Sequence[str]) -> list[str]:
    """A sentence on the parameters that no reading sees; none where each is seen."""
    if not unseen:
        return []
    return [
        f"No reading depends on {', '.join(unseen)}: such a value is where the fit began, not a finding."
        " Turn the base farther, until the needle slips below a sensor, and record the base torque."
    ]
