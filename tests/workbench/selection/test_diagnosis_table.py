"""The table of how often a diagnosis is right: its plan and its judgement."""

import importlib.machinery
import importlib.util
from collections import Counter
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

SCRIPT = Path(__file__).resolve().parents[3] / "scripts" / "diagnosis_table"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    loader = importlib.machinery.SourceFileLoader("diagnosis_table", str(SCRIPT))
    spec = importlib.util.spec_from_loader(loader.name, loader)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    loader.exec_module(module)
    return module


def row(script: ModuleType, **changes: Any) -> dict[str, Any]:
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
        "limits": {"a 0 +1": [0.2, 0.1, 0.2]},
        "cpu_s": 1.0,
        "f_test": "a",
        "aic": "b",
    } | changes


def line(text: str, begins: str) -> str:
    return next(t for t in text.splitlines() if t.startswith(f"| {begins}"))


def test_the_plan_is_as_large_as_asked_and_names_no_dataset_twice(script: ModuleType) -> None:
    tasks = script.plan(5)
    assert len({script.key(t) for t in tasks}) == len(tasks)
    poor = len(script.SETUPS) - 1
    usual = [t for t in tasks if t["kind"] == "one" and t["setup"] != poor]
    one = Counter((t["effects"][0], t["strength"]) for t in usual)
    assert len({name for name, _ in one}) >= 20
    assert set(one.values()) == {5}
    assert {t["strength"] for t in tasks if t["setup"] == poor} == {0.5}
    kinds = Counter(t["kind"] for t in tasks)
    assert kinds["none"] >= 60
    for name in {name for name, _ in one}:
        assert {t["setup"] for t in tasks if t.get("effects") == [name]} == set(range(len(script.SETUPS)))


def test_later_seeds_are_other_datasets_of_the_same_plan(script: ModuleType) -> None:
    early, late = script.plan(5), script.plan(5, first=5)
    assert not {script.key(t) for t in early} & {script.key(t) for t in late}
    assert Counter(t["kind"] for t in early) == Counter(t["kind"] for t in late)


def test_any_beginning_of_the_plan_holds_every_kind_in_proportion(script: ModuleType) -> None:
    tasks = script.plan(5)
    whole = Counter(t["kind"] for t in tasks)
    begun = Counter(t["kind"] for t in tasks[: len(tasks) // 5])
    for kind, count in whole.items():
        assert 0.1 < begun[kind] / count < 0.35


def test_a_tie_of_three_is_right_and_of_four_is_neither_right_nor_a_wrong_name(script: ModuleType) -> None:
    three = row(script, named=["b"], ties={"b": ["a", "c"]})
    four = row(script, named=["b"], ties={"b": ["a", "c", "d"]})
    other = row(script, named=["b"], ties={"b": ["c"]})
    assert [script.first(r) for r in (three, four, other)] == [True, False, False]
    assert [script.wrong(r) for r in (three, four, other)] == [False, False, True]


def test_two_effects_are_right_only_when_both_are_named_and_no_third(script: ModuleType) -> None:
    pair = {"kind": "pair", "effects": ["a", "b"]}
    assert script.right(row(script, **pair, named=["b", "a"]))
    assert not script.right(row(script, **pair, named=["a"]))
    assert not script.right(row(script, **pair, named=["a", "b", "c"]))


def test_absent_at_half_the_limit_counts_as_wrong_only_where_the_size_could_matter(
    script: ModuleType,
) -> None:
    weak = {"strength": 0.5, "verdict": "none", "named": [], "covered": []}
    visible = row(script, **weak, decisions={"a": "absent"})
    small = row(script, **weak, decisions={"a": "absent"}, limits={"a 0 +1": [0.1, 0.3, 0.3]})
    told = script.table([visible, small])
    assert "| 1 | 0 = 0 %" in line(told, "half the limit, limit above")
    assert "| 1 | 1 = 100 %" in line(told, "half the limit, below")


def test_shares_have_wilsons_interval_and_crashes_are_counted(script: ModuleType) -> None:
    rows = [row(script, seed=s) for s in range(19)] + [row(script, seed=19, named=["c"], ties={})]
    told = script.table([*rows, {"kind": "none", "setup": 0, "seed": 1, "crash": "ValueError"}])
    assert "| 20 | 19 = 95 % (76 … 99) |" in line(told, "one effect at 3 ×")
    assert "| 20 | 1 = 5 % (1 … 24) |" in line(told, "one effect at any strength: a wrong name")
    assert line(told, "crashed").endswith("| 21 | 1 |")
