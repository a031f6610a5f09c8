"""What was learnt, as it is reported."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from needle_rig.workbench.estimation.baseline import Baseline
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.draft import Origin, Table, written
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.selection.documents import NextTrial

Verdict = Literal["law", "none", "library", "cannot_tell"]
"""A law that no library holds, nothing at all, effects of the library, or something that these data do not
tell."""


@dataclass(frozen=True)
class LearntLaw:
    """A law that was found, as it is reported."""

    law: Law
    tied_with: tuple[Law, ...]
    held_out_before: float
    """Error on commands left out, in units of the noise."""
    held_out_after: float
    formula: str | None
    parameters: tuple[tuple[str, float, float, str], ...]
    """(name, value, standard deviation, unit) of the formula's."""
    curve: Curve
    told: Formula | Table
    """What the effect file holds."""
    experiment: NextTrial | None

    def as_json(self) -> dict[str, Any]:
        """As it stands in the JSON answer."""
        return {
            **self.law.as_json(),
            "tied_with": [law.as_json() for law in self.tied_with],
            "held_out_before": _plain(self.held_out_before),
            "held_out_after": _plain(self.held_out_after),
            "formula": self.formula,
        }


@dataclass(frozen=True)
class Learnt:
    """The answer."""

    verdict: Verdict
    laws: tuple[LearntLaw, ...]
    library: tuple[str, ...]
    """Effects of the library that are named: in place of a law, or beside it."""
    held_out_before: float
    held_out_after: float
    sentence: str
    tried: int
    """Laws that were tried."""
    baseline: Baseline
    """The current model, fitted."""
    origin: Origin

    def as_json(self, seconds: float) -> dict[str, Any]:
        """The stated form of the answer."""
        return {
            "verdict": self.verdict,
            "laws": [law.as_json() for law in self.laws],
            "seconds": round(seconds, 1),
        }

    def write_drafts(self, path: Path) -> tuple[Path, ...]:
        """The effect files: the first law's at `path`, those of others numbered beside it."""
        sections_m = self.baseline.dataset.layout.tissue_sections_m
        files = []
        for number, law in enumerate(self.laws, start=1):
            file = path if number == 1 else path.with_name(f"{path.stem}_{number}{path.suffix}")
            files.append(written(file, law.law, law.told, self.origin, sections_m))
        return tuple(files)


def _plain(error: float) -> float | None:
    return round(error, 4) if math.isfinite(error) else None
