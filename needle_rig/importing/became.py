"""What became of every column of a recording: used, asked, or not used with the reason."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from needle_rig.importing.mapping import Mapping


@dataclass(frozen=True)
class Became:
    """One column of one clock, and its end: there is no other."""

    clock: str
    source: str
    how: Literal["used", "asked", "not used"]
    told: str
    """As what it is used, what is asked of it, or why it is not used."""


def became(mapping: Mapping) -> tuple[Became, ...]:
    """Every column that the mapping names, in its order: clocks, channels, cuts, and what is not used."""
    found = []
    for name, clock in mapping.clocks.items():
        if clock.source is not None:
            asked = clock.doubt or ("" if clock.unit else "its unit is not known")
            found.append(_of(name, clock.source, f"clock {name}", clock.unit, 1, asked))
    for c in mapping.channels:
        asked = c.doubt or ("" if c.unit else "its unit is not known")
        found.append(_of(c.clock, c.source, c.role, c.unit, c.sign, asked))
    trials = mapping.trials
    if trials.at == "column" and trials.source is not None:
        found.append(_of(trials.clock or "", trials.source, "number of the trial", None, 1, trials.doubt))
    found += [Became(n.clock, n.source, "not used", n.why) for n in mapping.not_used]
    return tuple(found)


def _of(clock: str, source: str, role: str, unit: str | None, sign: int, asked: str) -> Became:
    told = f"{role}, {'−' if sign < 0 else ''}{unit or 'no unit'}"
    return Became(clock, source, "asked" if asked else "used", f"{told}: {asked}" if asked else told)
