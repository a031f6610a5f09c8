"""Values with their uncertainty, by name, as lmfit calls them: value, stderr, vary, correl."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from needle_rig.notebook.shown import Shown
from needle_rig.notebook.tables import Table, or_nan, table_of

LEAST_CORRELATION = 0.1
"""Correlation from which a report tells it, as in lmfit."""
COLUMNS = ("parameter", "value", "stderr", "low", "high", "unit")


@dataclass(frozen=True)
class Param:
    """One value, in the unit of files."""

    name: str
    value: float
    stderr: float | None
    """One standard deviation; None for a value that no fit moved."""
    interval: tuple[float, float] | None
    """95 %."""
    unit: str
    correl: Mapping[str, float] = field(default_factory=dict, repr=False)
    """Correlation with each other value that was fitted."""

    @property
    def vary(self) -> bool:
        """Whether it was fitted."""
        return self.stderr is not None

    def line(self) -> str:
        """In a report."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        if self.stderr is None or self.interval is None:
            return f"{self.value:.7g}{unit} (fixed)"
        share = f" ({100 * self.stderr / abs(self.value):.2f}%)" if self.value else ""
        low, high = self.interval
        return f"{self.value:.7g} +/- {self.stderr:.4g}{share}{unit} (95%: {low:.6g} to {high:.6g})"


def correl_of(name: str, pairs: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """Correlations of one value with the others, from those of pairs."""
    return {
        other if one == name else one: value for (one, other), value in pairs.items() if name in (one, other)
    }


class Params(Shown, Mapping[str, Param]):
    """Values by name."""

    def __init__(self, of: str, params: Mapping[str, Param]) -> None:
        self._of, self._params = of, dict(params)

    def __getitem__(self, name: str) -> Param:
        return self._params[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._params)

    def __len__(self) -> int:
        return len(self._params)

    def valuesdict(self) -> dict[str, float]:
        """The values alone."""
        return {name: param.value for name, param in self.items()}

    def headline(self) -> str:
        """Whose they are, and how many were fitted."""
        fitted = sum(param.vary for param in self.values())
        return f"{self._of}: {len(self)} parameters, {fitted} with an uncertainty"

    def table(self) -> Table:
        """A row a value."""
        return table_of(
            (
                {
                    "parameter": param.name,
                    "value": param.value,
                    "stderr": or_nan(param.stderr),
                    "low": math.nan if param.interval is None else param.interval[0],
                    "high": math.nan if param.interval is None else param.interval[1],
                    "unit": param.unit,
                }
                for param in self.values()
            ),
            COLUMNS,
        )

    def report(self) -> str:
        """Variables and correlations, as lmfit's fit_report writes them."""
        width = max((len(name) for name in self), default=0) + 1
        lines = ["[[Variables]]"]
        lines += [f"    {name + ':':<{width}} {param.line()}" for name, param in self.items()]
        names = list(self)
        pairs = [
            (one, other, self[one].correl[other])
            for i, one in enumerate(names)
            for other in names[i + 1 :]
            if other in self[one].correl
        ]
        told = sorted((p for p in pairs if abs(p[2]) >= LEAST_CORRELATION), key=lambda p: -abs(p[2]))
        if told:
            lines.append(f"[[Correlations]] (unreported correlations are < {LEAST_CORRELATION:.3f})")
            lines += [f"    C({one}, {other}) = {value:+.4f}" for one, other, value in told]
        return "\n".join(lines)
