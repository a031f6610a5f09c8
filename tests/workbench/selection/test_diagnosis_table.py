"""The table of how often a diagnosis is right: its plan and its judgement."""

from argparse import Namespace
from collections import Counter
from typing import Any

from campaigns.run import key
from campaigns.workbench import diagnosis_table
from campaigns.workbench.diagnosis_sets import SETUPS, plan
from campaigns.workbench.rates import first, right, wrong


def row(**changes: Any) -> dict[str, Any]:
    return {
        "kind": "one",
        "effects": ["a"],
        "strength": 3.0,
        "setup": 0,
        "seed": 0,
        "verdict": "effect",
        "named": ["a"],
        "ties": {},
        "after": 1.0,
        "decisions": {"a": "present"},
        "covered": [True],
        "relatives": ["b"],
        "limits": {"a": [0.2, 0.1, 0.2]},
        "f_test": "a",
        "aic": "b",
    } | changes


def line(text: str, begins: str) -> str:
    return next(t for t in text.splitlines() if t.startswith(f"| {begins}"))


def test_the_plan_is_as_large_as_asked_and_names_no_dataset_twice() -> None:
    tasks = plan(5)
    assert len({key(t) for t in tasks}) == len(tasks)
    poor = len(SETUPS) - 1
    usual = [t for t in tasks if t["kind"] == "one" and t["setup"] != poor]
    one = Counter((t["effects"][0], t["strength"]) for t in usual)
    assert len({name for name, _ in one}) >= 20
    assert set(one.values()) == {5}
    assert {t["strength"] for t in tasks if t["setup"] == poor} == {0.5}
    kinds = Counter(t["kind"] for t in tasks)
    assert kinds["none"] >= 60
    for name in {name for name, _ in one}:
        assert {t["setup"] for t in tasks if t.get("effects") == [name]} == set(range(len(SETUPS)))


def test_later_seeds_are_other_datasets_of_the_same_plan() -> None:
    early, late = plan(5), plan(5, first=5)
    assert not {key(t) for t in early} & {key(t) for t in late}
    assert Counter(t["kind"] for t in early) == Counter(t["kind"] for t in late)


def test_any_beginning_of_the_plan_holds_every_kind_in_proportion() -> None:
    tasks = plan(5)
    whole = Counter(t["kind"] for t in tasks)
    begun = Counter(t["kind"] for t in tasks[: len(tasks) // 5])
    for kind, count in whole.items():
        assert 0.1 < begun[kind] / count < 0.35


def test_a_tie_of_three_is_right_and_of_four_is_neither_right_nor_a_wrong_name() -> None:
    three = row(named=["b"], ties={"b": ["a", "c"]})
    four = row(named=["b"], ties={"b": ["a", "c", "d"]})
    other = row(named=["b"], ties={"b": ["c"]})
    assert [first(r) for r in (three, four, other)] == [True, False, False]
    assert [wrong(r) for r in (three, four, other)] == [False, False, True]


def test_two_effects_are_right_only_when_both_are_named_and_no_third() -> None:
    pair = {"kind": "pair", "effects": ["a", "b"]}
    assert right(row(**pair, named=["b", "a"]))
    assert not right(row(**pair, named=["a"]))
    assert not right(row(**pair, named=["a", "b", "c"]))


def test_absent_at_half_the_limit_counts_as_wrong_only_where_the_size_could_matter() -> None:
    weak = {"strength": 0.5, "verdict": "none", "named": [], "covered": []}
    visible = row(**weak, decisions={"a": "absent"})
    small = row(**weak, decisions={"a": "absent"}, limits={"a": [0.1, 0.3, 0.3]})
    told = diagnosis_table.table([visible, small], Namespace())
    assert "| 1 | 0 = 0 %" in line(told, "half the limit, limit above")
    assert "| 1 | 1 = 100 %" in line(told, "half the limit, below")


def test_shares_have_wilsons_interval_and_crashes_are_in_none() -> None:
    rows = [row(seed=s) for s in range(19)] + [row(seed=19, named=["c"], ties={})]
    told = diagnosis_table.table(
        [*rows, {"kind": "none", "setup": 0, "seed": 1, "crash": "ValueError"}], Namespace()
    )
    assert "| 20 | 19 = 95 % (76 … 99) |" in line(told, "one effect at 3 ×")
    assert "| 20 | 1 = 5 % (1 … 24) |" in line(told, "one effect at any strength: a wrong name")
