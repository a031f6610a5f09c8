"""What of an answer counts as right, and shares with their intervals."""

from __future__ import annotations

from collections.abc import Iterable

from scipy.stats import binomtest

from campaigns.run import Row
from needle_rig.physics.library import find_effects

HEAD = ("| question | asked | datasets | result (95 %) |", "|---|---|---|---|")
MOST_TIED = 3
PHYSICS = ("shape", "torque", "drive")
"""Hooks of effects of the needle or its drive; a clock offset is what a late stream is."""


def groups(row: Row) -> list[set[str]]:
    """Each named effect with those that tie with it."""
    return [{name, *row["ties"].get(name, [])} for name in row["named"]]


def first(row: Row) -> bool:
    """Whether the one hidden effect is named first, or stands in a reported tie of at most three."""
    tie = tied(row)
    return row["verdict"] == "effect" and row["effects"][0] in tie and len(tie) <= MOST_TIED


def tied(row: Row) -> set[str]:
    """The effect that is named first and those that tie with it."""
    return next(iter(groups(row)), set())


def wrong(row: Row) -> bool:
    """Whether an effect is named that is not there, nor tied with one that is."""
    return any(not set(row.get("effects", ())) & group for group in groups(row))


def right(row: Row) -> bool:
    """Whether every hidden effect, and none besides, is named or stands in a tie of at most three."""
    hidden, said = row.get("effects", ()), groups(row)
    found = all(any(name in tie and len(tie) <= MOST_TIED for tie in said) for name in hidden)
    return row["verdict"] == ("effect" if hidden else "none") and found and len(said) == len(hidden)


def mimicked(row: Row) -> bool:
    """Whether the answer is unknown, or nothing but declared relatives of what is hidden."""
    return row["verdict"] == "unknown" or (bool(row["named"]) and set(row["named"]) <= set(row["relatives"]))


def as_physics(row: Row) -> bool:
    """Whether an effect of the needle or its drive is named."""
    known = find_effects()
    return any(known[name].has(hook) for name in row["named"] for hook in PHYSICS)


def line(question: str, asked: str, said: Iterable[object]) -> list[str]:
    """A line of a table with the share of true answers and Wilson's 95 % interval; none without answers."""
    answers = [bool(a) for a in said]
    if not answers:
        return []
    share = binomtest(sum(answers), len(answers)).proportion_ci(method="wilson")
    result = f"{sum(answers)} = {100 * sum(answers) / len(answers):.0f} %"
    between = f"({100 * share.low:.0f} … {100 * share.high:.0f})"
    return [f"| {question} | {asked} | {len(answers)} | {result} {between} |"]
