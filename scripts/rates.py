"""What of an answer counts as right, shares with their intervals, and the code they were measured with."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from pathlib import Path

from diagnosis_sets import Row
from scipy.stats import binomtest

HEAD = ("| question | asked | datasets | result (95 %) |", "|---|---|---|---|")
MOST_TIED = 3


def first(row: Row) -> bool:
    """Whether the one hidden effect is named first, or stands in a reported tie of at most three."""
    tie = tied(row)
    return row["verdict"] == "effect" and row["effects"][0] in tie and len(tie) <= MOST_TIED


def tied(row: Row) -> set[str]:
    """The effect that is named first and those that tie with it."""
    return {n for f in row["named"][:1] for n in (f, *row["ties"].get(f, []))}


def wrong(row: Row) -> bool:
    """Whether an effect is named that is not there, nor tied with one that is."""
    hidden = set(row.get("effects", ()))
    return any(not hidden & {name, *row["ties"].get(name, [])} for name in row["named"])


def line(question: str, asked: str, said: Iterable[object]) -> list[str]:
    """A line of a table with the share of true answers and Wilson's 95 % interval; none without answers."""
    answers = [bool(a) for a in said]
    if not answers:
        return []
    share = binomtest(sum(answers), len(answers)).proportion_ci(method="wilson")
    result = f"{sum(answers)} = {100 * sum(answers) / len(answers):.0f} %"
    between = f"({100 * share.low:.0f} … {100 * share.high:.0f})"
    return [f"| {question} | {asked} | {len(answers)} | {result} {between} |"]


def time_spent(cpu_s: Iterable[float]) -> str:
    """A sentence on the processor time of the answers."""
    taken = sorted(cpu_s)
    return (
        f"Processor time of a diagnosis: median {taken[len(taken) // 2]:.0f} s, 95 % below"
        f" {taken[int(0.95 * (len(taken) - 1))]:.0f} s, of one core."
    )


def versions_of(rows: Iterable[Row]) -> str:
    """A sentence on the code that the rows were measured with."""
    said = [r.get("version", "?") for r in rows]
    counted = [f"{v} ({said.count(v)})" for v in dict.fromkeys(said)]
    return f"{len(said)} datasets; code: {', '.join(counted)}."


def version() -> str:
    """The code's revision, with a + when files differ from it."""
    home = str(Path(__file__).resolve().parents[1])
    command = ["git", "-C", home, "describe", "--always", "--dirty=+", "--exclude=*"]
    told = subprocess.run(command, capture_output=True, text=True, check=False)
    return told.stdout.strip() or "unknown"
