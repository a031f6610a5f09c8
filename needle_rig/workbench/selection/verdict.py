"""The verdict: a list of named rules, each of which says why an answer does not explain the data."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from needle_rig.workbench.observations.snaps import Snap, sentence
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.documents import ReasonDocument, Verdict
from needle_rig.workbench.selection.residual_patterns import ResidualPatterns


@dataclass(frozen=True)
class Findings:
    """What the rules judge: the effects that a search names, and what they leave."""

    named: tuple[str, ...]
    left: ResidualPatterns
    held_out_error: float
    """Root mean square error of cross-validation, in units of the noise."""
    snaps: tuple[Snap, ...] = ()
    torque_scale: float = 1.0
    fitted_error: float = 1.0
    """Root mean square of the residual in the trials that were fitted, in units of the noise."""


@dataclass(frozen=True)
class Reason:
    """A rule that found something unexplained, in words."""

    rule: str
    sentence: str

    def as_json(self) -> ReasonDocument:
        """As it stands in the JSON answer."""
        return {"rule": self.rule, "sentence": self.sentence}


def pattern_matters(found: Findings) -> str | None:
    """A significant pattern in the residual is large enough to matter."""
    matters = [p for p in found.left.patterns if not POLICY.size.small(p.size, p.unit, found.torque_scale)]
    return f"the residual is large enough to matter: {matters[0].sentence()}" if matters else None


def above_noise(error: float) -> bool:
    """Whether an error is above the noise; with one command alone (infinite) nobody knows."""
    return POLICY.verdict.reached < error < math.inf


def noise_not_reached(found: Findings) -> str | None:
    """Commands left out are not predicted to within the noise.

    Where effects are named and leave no pattern, few commands leave their sizes open: then the trials that
    were fitted are to be met. `stick_slip` reports a needle that snaps.
    """
    return None if found.snaps else _missed(found)


def stick_slip(found: Findings) -> str | None:
    """The same of a needle that snaps."""
    if not found.snaps or not (missed := _missed(found)):
        return None
    return (
        f"{sentence(found.snaps)}; {missed}; a model without inertia gives neither the instant of a snap nor"
        " where it ends, so how friction falls once the needle slips, and what else is missing, cannot be"
        " told from these data; the strategy planned turns by the Hall angles all the same"
        " (needle-rig compensate --strategy planned --option use_hall=true)"
    )


def _missed(found: Findings) -> str | None:
    open_sizes = found.named and not found.left.significant
    error = found.fitted_error if open_sizes else found.held_out_error
    if not above_noise(error):
        return None
    model = f"with {' and '.join(found.named)}" if found.named else "with no effect named"
    where = "the trials that were fitted" if open_sizes else "commands left out"
    return f"{model} the error on {where} is {error:.2f} × the noise, more than {POLICY.verdict.reached:g}"


RULES: tuple[Callable[[Findings], str | None], ...] = (
    pattern_matters,
    noise_not_reached,
    stick_slip,
)
"""Each gives a sentence, or None where it finds nothing unexplained. Their names stand in the JSON answer."""


def reasons(found: Findings) -> tuple[Reason, ...]:
    """The rules that found something unexplained, each with its sentence."""
    said = ((rule.__name__, rule(found)) for rule in RULES)
    return tuple(Reason(name, sentence) for name, sentence in said if sentence is not None)


def verdict(named: Sequence[str], why: Sequence[Reason]) -> Verdict:
    """Unknown when a rule found something unexplained."""
    return "unknown" if why else "effect" if named else "none"
