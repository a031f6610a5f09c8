"""Rules switched off one by one: each comes back as it was; answers are graded by what is hidden."""

from __future__ import annotations

import sys
from argparse import Namespace
from typing import Any

import pytest

from campaigns.workbench import ablation
from campaigns.workbench.ablation_rules import RULES, Memory, remembering, switched_off
from needle_rig.workbench.policy import POLICY


def given(size: int) -> Namespace:
    return Namespace(size=size, first_seed=900, before=None)


def state() -> dict[tuple[str, str], Any]:
    """Everything that a rule may replace."""
    return {
        (name, field): value
        for name, module in list(sys.modules.items())
        if name.startswith("needle_rig.workbench")
        for field, value in vars(module).items()
    }


def test_every_rule_changes_something_and_comes_back() -> None:
    before, thresholds = state(), POLICY.as_json()
    with remembering() as memory:
        inside = state()
        for rule in RULES:
            with switched_off(rule, memory):
                methods = rule.name in {
                    "search again from the starts of another",
                    "tie: from starts of its own",
                    "verdict: a pattern of small size",
                }
                assert methods or state() != inside or POLICY.as_json() != thresholds, rule.name
            assert state() == inside, rule.name
            assert POLICY.as_json() == thresholds, rule.name
    assert state() == before
    assert len({rule.name for rule in RULES}) == len(RULES)


def test_a_memory_asks_once_for_equal_arguments_and_again_inside_a_rule() -> None:
    memory, asked = Memory(), []

    def double(of: list[int], *, by: int = 2) -> list[int]:
        asked.append(of)
        if by == 0:
            raise ValueError("0")
        return [by * each for each in of]

    remembered = memory.of("double", double)
    assert remembered([1, 2]) == remembered([1, 2]) == [2, 4]
    assert len(asked) == 1
    with memory.apart(fresh=("double",)):
        assert remembered([1, 2]) == remembered([1, 2]) == [2, 4]
        assert len(asked) == 2
    with memory.apart(fresh=()):
        assert remembered([1, 2]) == [2, 4]
        assert remembered([3]) == remembered([3]) == [6]
        assert len(asked) == 3
    assert remembered([3]) == [6]
    assert len(asked) == 4
    for _ in range(2):
        with pytest.raises(ValueError, match="0"):
            remembered([1], by=0)
    assert len(asked) == 5


@pytest.mark.parametrize(
    ("task", "verdict", "named", "ties", "points"),
    [
        ({"kind": "none"}, "none", [], {}, 2),
        ({"kind": "none"}, "unknown", [], {}, 1),
        ({"kind": "none"}, "effect", ["hall_gain"], {}, 0),
        ({"kind": "one", "effects": ["hall_gain"], "strength": 3.0}, "effect", ["hall_gain"], {}, 2),
        ({"kind": "one", "effects": ["hall_gain"], "strength": 0.5}, "none", [], {}, 2),
        ({"kind": "one", "effects": ["hall_gain"], "strength": 3.0}, "none", [], {}, 1),
        (
            {"kind": "one", "effects": ["hall_gain"], "strength": 3.0},
            "effect",
            ["torque_bias"],
            {"torque_bias": ["hall_gain"]},
            2,
        ),
        (
            {"kind": "pair", "effects": ["hall_gain", "torque_bias"], "strength": 3.0},
            "effect",
            ["hall_gain"],
            {},
            1,
        ),
        ({"kind": "removed", "effects": ["hall_gain"], "strength": 10.0}, "unknown", [], {}, 2),
        ({"kind": "removed", "effects": ["hall_gain"], "strength": 10.0}, "none", [], {}, 1),
        ({"kind": "impostor", "impostor": "2 % outliers"}, "effect", ["tip_friction"], {}, 0),
        ({"kind": "impostor", "impostor": "2 % outliers"}, "effect", ["hall_gain"], {}, 2),
        ({"kind": "snapping", "ratio": 0.5}, "effect", ["stribeck"], {}, 2),
        ({"kind": "snapping", "ratio": 0.5}, "effect", ["viscous_slip"], {}, 0),
        ({"kind": "snapping", "ratio": 0.5}, "none", [], {}, 1),
    ],
)
def test_answers_are_graded_by_what_is_hidden(
    task: dict[str, Any],
    verdict: str,
    named: list[str],
    ties: dict[str, list[str]],
    points: int,
) -> None:
    assert ablation.points(task, {"verdict": verdict, "named": named, "ties": ties}) == points
    assert ablation.points(task, {"crash": "…"}) == 0


def test_the_plan_is_a_mixture_of_all_kinds() -> None:
    tasks = ablation.plan(given(60))
    assert [task["number"] for task in tasks] == list(range(60))
    assert {task["kind"] for task in tasks} == {"one", "none", "pair", "removed", "impostor", "messy"}
    assert sum(task["kind"] == "messy" for task in tasks) == 12
    assert ablation.plan(given(20)) == tasks[:20]


def test_the_table_counts_better_and_worse() -> None:
    whole = {"verdict": "none", "named": [], "ties": {}, "points": 2}
    worse = {"verdict": "effect", "named": ["hall_gain"], "ties": {}, "points": 0}
    row = {"number": 0, "kind": "none", "setup": 0, "seed": 1, "answer": whole}
    row |= {"asked": [RULES[0].name], "changed": {RULES[0].name: worse}, "whole_s": 1.0}
    text = ablation.table([row, {"number": 1, "kind": "none", "skipped": "…"}], given(2))
    assert f"| {RULES[0].name} | 1 | 1 |  | 1 | 1000" in text
    assert "1 of 1 right" in text
    assert f"none: nothing, setup 0 | {RULES[0].name} | none | hall_gain |" in text


def test_two_commits_are_compared_on_the_datasets_of_both() -> None:
    right = {"verdict": "none", "named": [], "ties": {}, "points": 2}
    wrong = {"verdict": "effect", "named": ["hall_gain"], "ties": {}, "points": 0}
    task = {"kind": "none", "setup": 0, "whole_s": 3.0}
    before = [{**task, "number": n, "answer": right, "commit": "old"} for n in range(3)]
    after = [{**task, "number": n, "answer": a, "commit": "new"} for n, a in enumerate((right, wrong))]
    text = ablation.beside(after, before)
    assert "| old | 2 | 2 (" in text
    assert "| new | 2 | 1 (" in text
    assert text.count("| none: nothing, setup 0 | none | hall_gain |") == 1
