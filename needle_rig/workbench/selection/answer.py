"""What a diagnosis answers: values, decisions, ranking and verdict, as they stand in JSON."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from needle_rig.records import JsonObject
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.documents import (
    DiagnoseDocument,
    NextExperiment,
    RankedEffect,
    RankedValue,
    Verdict,
)
from needle_rig.workbench.selection.explanation import Explanation
from needle_rig.workbench.selection.lack_of_fit import LackOfFit
from needle_rig.workbench.selection.residual_patterns import ResidualPatterns
from needle_rig.workbench.selection.verdict import Reason

Say = Callable[[str], None]

SIGMAS_95 = 1.96
"""Half a two-sided 95 % interval, in standard deviations."""


@dataclass(frozen=True)
class Value:
    """One fitted parameter with its 95 % interval."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    plausible: bool

    def as_json(self) -> RankedValue:
        """As it stands in the JSON answer."""
        return {
            "value": _plain(self.value),
            "unit": self.unit,
            "low": _plain(self.low),
            "high": _plain(self.high),
        }


@dataclass(frozen=True)
class Decision:
    """What can be said of one effect."""

    effect: str
    decision: str
    """present, negligible, absent or cannot_tell."""
    limit: float | None
    """Upper end of the 95 % range of its size, in the unit of `parameter`; None where nothing limits it."""
    parameter: str
    unit: str
    matters_from: float
    downwards: bool = False
    """Whether the effect grows as its parameter falls, as a compliance does given as a stiffness."""

    def sentence(self) -> str:
        """The effect with the limit of its size, in words."""
        if self.limit is None:
            return self.effect
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{self.effect} ({'>' if self.downwards else '<'} {self.limit:.2g}{unit})"

    def as_json(self) -> JsonObject:
        """As it stands in the JSON answer."""
        return {
            "decision": self.decision,
            "limit": _plain(self.limit),
            "parameter": self.parameter,
            "unit": self.unit,
            "matters_from": _plain(self.matters_from),
        }


@dataclass(frozen=True)
class Ranked:
    """One candidate of the ranking."""

    effect: str
    held_out_error: float | None
    error_removed: float
    values: tuple[Value, ...]
    indistinguishable_from: tuple[str, ...]
    separation_sigma: float | None
    in_favour: str
    against: str

    def as_json(self) -> RankedEffect:
        """As it stands in the JSON answer."""
        return {
            "effect": self.effect,
            "held_out_error": _error(self.held_out_error),
            "error_removed": _plain(self.error_removed),
            "parameters": {v.name: v.as_json() for v in self.values},
            "indistinguishable_from": list(self.indistinguishable_from),
            "separation_sigma": _plain(self.separation_sigma),
            "in_favour": self.in_favour,
            "against": self.against,
        }


@dataclass(frozen=True)
class Answer:
    """What `needle-rig diagnose` says, whatever kind of data it was asked of."""

    left_out: ClassVar[str] = "commands"
    """What held-out errors leave out in turn."""

    dataset: str
    model: str
    verdict: Verdict
    effects: tuple[str, ...]
    ranking: tuple[Ranked, ...]
    decisions: dict[str, Decision]
    residual_patterns: ResidualPatterns
    explained: bool
    reasons: tuple[Reason, ...]
    """Why it is unknown; empty for the other verdicts."""
    lack_before: LackOfFit | None
    """Lack of fit of the current model; None without replicates."""
    lack_after: LackOfFit | None
    """Lack of fit of the model with what is named; None without replicates."""
    explained_fraction: float
    held_out_error_before: float
    held_out_error_after: float
    noise_floor: float
    next_experiment: NextExperiment | None
    notes: tuple[str, ...]

    @property
    def noise(self) -> dict[str, float]:
        """Standard deviation of a reading, by channel, in the unit that its name ends in."""
        raise NotImplementedError

    def explanations(self) -> tuple[Explanation, ...]:
        """What can be adopted: the named effects, then each tie in their place; none without an effect.

        Raises SolverError.
        """
        raise NotImplementedError

    @property
    def ties(self) -> tuple[str, ...]:
        """Effects that cannot be told apart from the named ones."""
        named = self.ranking[: len(self.effects)]
        return tuple(sorted({r for row in named for r in row.indistinguishable_from}))

    def sentence(self) -> str:
        """The verdict in words."""
        if self.verdict == "none":
            return "nothing is missing beyond the noise and the scatter of the trials."
        if self.verdict == "unknown":
            if any(r.rule == "stick_slip" for r in self.reasons):
                return "the needle sticks and slips, and no effect of the library predicts it."
            return "something is missing that no effect of the library explains."
        named = f"{' and '.join(self.effects)} missing"
        return named + (f"; cannot be told apart from {', '.join(self.ties)}." if self.ties else ".")

    def errors_sentence(self) -> str:
        """The error left out, before and after."""
        before, after = (left_out_error(e) for e in (self.held_out_error_before, self.held_out_error_after))
        return f"Error on {self.left_out} left out: {before} → {after} (noise is {self.noise_floor:.2f})"

    def left_in_words(self) -> list[str]:
        """The residual: its patterns, and what replicates share beyond how they differ."""
        lack = self.lack_after
        shared = [lack.sentence()] if lack is not None and lack.significant else []
        return [p.sentence() for p in self.residual_patterns.patterns] + shared

    def as_json(self) -> DiagnoseDocument:
        """The stated form of the answer."""
        return {
            "dataset": self.dataset,
            "model": self.model,
            "verdict": self.verdict,
            "reasons": [r.as_json() for r in self.reasons],
            "effects": list(self.effects),
            "ranking": [r.as_json() for r in self.ranking],
            "noise_floor": _plain(self.noise_floor),
            "held_out_error_before": _error(self.held_out_error_before),
            "held_out_error_after": _error(self.held_out_error_after),
            "explained_fraction": _plain(self.explained_fraction),
            "decisions": {name: d.as_json() for name, d in self.decisions.items()},
            "left_over": {"explained": self.explained, "where": self.left_in_words()},
            "lack_of_fit": {
                "before": self.lack_before.as_json() if self.lack_before else None,
                "after": self.lack_after.as_json() if self.lack_after else None,
            },
            "next_experiment": self.next_experiment,
            "notes": list(self.notes),
            "policy": POLICY.as_json(),
        }


def left_out_error(error: float | None) -> str:
    """An error of cross-validation, or a dash where there was only one command."""
    return "—" if error is None or not math.isfinite(error) else f"{error:.2f}"


def _plain(value: float | None) -> float | str | None:
    """JSON has no infinity: it is written as text."""
    if value is None or np.isnan(value):
        return None
    return float(f"{value:.6g}") if np.isfinite(value) else ("inf" if value > 0 else "-inf")


def _error(value: float | None) -> float | None:
    """An error, or None where no command could be left out."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.6g}")
