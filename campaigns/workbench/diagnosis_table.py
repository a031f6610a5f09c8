"""How often a diagnosis is right: own datasets with fresh seeds.

Strengths are multiples of the effect's detection limit in the dataset's own setup (layout, trials, noise,
scatter): the strength whose expected gain, other parameters refitted, is 16. Multiples of 1 and more count
from the smallest size that matters where the limit lies below it: smaller ones are rightly called negligible.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterable
from typing import Literal

from campaigns.run import Campaign, Row, answered, markdown
from campaigns.workbench.diagnosis_sets import SETUPS, STRENGTHS, Impostor, answer_to, made, naive, plan
from campaigns.workbench.rates import HEAD, as_physics, first, groups, line, mimicked, right, wrong


def planned(given: Namespace) -> list[Row]:
    return plan(given.size, given.first_seed)


def ask(task: Row, _: Namespace) -> Row:
    given = made(task)
    if isinstance(given, str):
        return {"skipped": given}
    answer, found = answer_to(given)
    if task["kind"] in ("one", "none"):
        answer["f_test"], answer["aic"] = naive(found)
    return answer


def table(every: list[Row], _: Namespace) -> str:
    """The figures, in markdown, with Wilson's 95 % intervals."""
    rows = answered(every)
    lines = list(HEAD)

    def say(question: str, asked: str, said: Iterable[object]) -> None:
        lines.extend(line(question, asked, said))

    def limits(row: Row) -> tuple[float, float]:
        limit, smallest, _ = next(iter(row["limits"].values()))
        return limit, smallest

    one = [r for r in rows if r["kind"] == "one"]
    strong = [r for r in one if r["strength"] >= 3]
    say(
        "one effect at 3 × its limit and more: first, or in a tie of three",
        "≥ 95 %",
        map(first, strong),
    )
    for strength in STRENGTHS[1:]:
        asked = "≥ 95 %" if strength >= 3 else "—"
        say(f"… at {strength:g} ×", asked, [first(r) for r in one if r["strength"] == strength])
    say(
        "… in another layout, 3 × and more", "≥ 95 %", [first(r) for r in strong if SETUPS[r["setup"]].layout]
    )
    say("one effect at any strength: a wrong name", "≤ 2 %", map(wrong, one))
    weak = [r for r in one if r["strength"] == 0.5]
    visible = [r for r in weak if limits(r)[0] > limits(r)[1]]
    say(
        "half the limit, limit above the smallest size that matters: cannot tell (or found)",
        "all",
        [set(r["decisions"].values()) <= {"cannot_tell", "present"} for r in visible],
    )
    say(
        "… called absent or negligible though the hidden size matters",
        "none",
        [
            bool({"absent", "negligible"} & set(r["decisions"].values()))
            for r in visible
            if 0.5 * limits(r)[0] > limits(r)[1]
        ],
    )
    say(
        "half the limit, below the smallest size that matters (absent and negligible are true): not named",
        "all",
        [not r["named"] for r in weak if limits(r)[0] <= limits(r)[1]],
    )
    none = [r for r in rows if r["kind"] == "none"]
    say("nothing hidden: none", "≥ 97 %", [r["verdict"] == "none" for r in none])
    pairs = [r for r in rows if r["kind"] == "pair"]
    say("two effects at 3 × and more: both named, nothing else", "≥ 90 %", map(right, pairs))
    for strength in (3.0, 10.0):
        say(f"… at {strength:g} ×", "≥ 90 %", [right(r) for r in pairs if r["strength"] == strength])
    removed = [r for r in rows if r["kind"] == "removed"]
    say(
        "effect not in the library, 10 ×: unknown, or a declared relative named",
        "≥ 90 %",
        map(mimicked, removed),
    )
    say("… unknown", "—", [r["verdict"] == "unknown" for r in removed])
    snapping = [r for r in rows if r["kind"] == "snapping"]
    named = [groups(r) == [{"stribeck"}] or not r["named"] for r in snapping]
    say("a needle of another code that snaps: Stribeck friction, or nothing, is named", "all", named)
    spoilt = [r for r in rows if r["kind"] == "impostor"]
    say("impostors: named as physics", "≤ 5 %", [as_physics(r) for r in spoilt])
    for impostor in Impostor:
        say(f"… {impostor}", "≤ 5 %", [as_physics(r) for r in spoilt if r["impostor"] == impostor])
    met = [r for r in strong if first(r)]
    covered = [c for r in met if r["named"] == r["effects"] for c in r["covered"]]
    say("95 % intervals of strengths that hold the truth", "88 … 99 %", covered)
    say(
        "held-out error after adoption at most 1.1 × the floor",
        "all",
        [r["after"] is not None and r["after"] <= 1.1 for r in met],
    )
    tests: dict[Literal["f_test", "aic"], str] = {"f_test": "independent-noise F-test", "aic": "AIC"}
    for test, name in tests.items():
        say(f"beside it, nothing hidden: the {name} finds something", "—", [r[test] for r in none])
        found = [r[test] in r["effects"] for r in strong]
        say(f"beside it, one effect at 3 × and more: the {name}'s first is right", "—", found)
    return "\n".join([*lines, "", by_effect(one)])


def by_effect(one: list[Row]) -> str:
    """Right over asked for each effect and strength, and what was named wrongly."""
    lines = []
    for name in sorted({r["effects"][0] for r in one}):
        own = [r for r in one if r["effects"] == [name]]
        cells = []
        for strength in STRENGTHS:
            some = [first(r) for r in own if r["strength"] == strength]
            cells.append(f"{sum(some)}/{len(some)}" if some else "")
        names = sorted({n for r in own if wrong(r) for n in r["named"]})
        lines.append((name, *cells, ", ".join(names)))
    return markdown(("effect", *(f"{s:g} ×" for s in STRENGTHS), "wrong names"), lines)


CAMPAIGN = Campaign(__doc__, planned, ask, table, size=5, counts="seeds of each question (5)")
