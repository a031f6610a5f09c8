"""One runner for all campaigns: what it refuses, where it goes on, what it counts."""

from __future__ import annotations

import importlib
import json
from argparse import Namespace
from pathlib import Path

import pytest

from campaigns import ROOT
from campaigns import run as runner
from campaigns.command import by_name, runnable
from campaigns.run import Campaign, Row, answered, policy, read_rows, run


def plan(given: Namespace) -> list[Row]:
    first = given.first_seed
    return [{"seed": seed, "even": seed % 2 == 0} for seed in range(first, first + given.size)]


def ask(task: Row, _: Namespace) -> Row:
    if task["seed"] == 1:
        raise ValueError("one")
    return {"skipped": "two"} if task["seed"] == 2 else {"verdict": "none", "square": task["seed"] ** 2}


def table(rows: list[Row], _: Namespace) -> str:
    return f"sum {sum(row['square'] for row in answered(rows))}"


SQUARES = Campaign("Squares?", plan, ask, table, size=4, counts="numbers")


@pytest.fixture
def clean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "commit", lambda: "abc")


def rows_of(seeds: range, commit: str = "abc") -> str:
    made = [
        runner.asked(SQUARES, task, Namespace()) | {"commit": commit, "policy": policy()}
        for task in plan(Namespace(first_seed=seeds.start, size=len(seeds)))
    ]
    return "".join(json.dumps(row) + "\n" for row in made)


@pytest.mark.whole
@pytest.mark.usefixtures("clean")
def test_it_goes_on_where_the_file_stops(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text(rows_of(range(2)))
    assert run("squares", SQUARES, ["--rows", str(file), "--jobs", "1"]) == 1  # the crash of 1 is counted
    rows = read_rows(file)
    assert [row["task"]["seed"] for row in rows] == [0, 1, 2, 3]
    assert {row["commit"] for row in rows} == {"abc"}
    told = capsys.readouterr()
    assert "sum 9" in told.out
    assert f"4 of 4 rows, measured at abc with policy {policy()}." in told.out
    assert "Not asked in 1 rows: two." in told.out
    assert 'Crashed: `{"even": false, "seed": 1}`: ValueError: one' in told.out
    assert told.err.count("\n") == 2


def test_rows_of_a_tree_with_changes_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "commit", lambda: "abc+")
    file = tmp_path / "rows.jsonl"
    assert run("squares", SQUARES, ["--rows", str(file)]) == 2
    assert "commit first" in capsys.readouterr().err
    assert not file.exists()
    assert run("squares", SQUARES, ["--rows", str(file), "--minutes", "0"]) == 0


@pytest.mark.usefixtures("clean")
def test_a_file_holds_rows_of_one_commit(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text(rows_of(range(1), "old"))
    assert run("squares", SQUARES, ["--rows", str(file)]) == 2
    assert "name another file" in capsys.readouterr().err
    assert run("squares", SQUARES, ["--rows", str(file), "--minutes", "0"]) == 0


@pytest.mark.usefixtures("clean")
def test_tasks_are_chosen_by_their_fields(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "rows.jsonl"
    file.write_text(rows_of(range(1)))
    assert run("squares", SQUARES, ["--rows", str(file), "--size", "2", "--where", "even=True"]) == 0
    assert "1 of 1 rows" in capsys.readouterr().out


def test_one_task_is_asked_and_kept_nowhere(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("squares", SQUARES, ["--only", '{"seed": 5}']) == 0
    assert json.loads(capsys.readouterr().out)["square"] == 25


def test_every_campaign_and_benchmark_has_a_name_of_its_own() -> None:
    names = [*runnable("campaigns"), *runnable("benchmarks")]
    assert len(set(names)) == len(names)
    assert {"diagnosis_table", "hazards", "import_files", "bench"} <= set(names)


@pytest.mark.whole
@pytest.mark.parametrize("name", sorted(runnable("campaigns")))
def test_a_campaign_without_rows_has_a_table_and_breaks_no_promise(name: str) -> None:
    if name == "api_fuzz":
        pytest.importorskip("schemathesis")
    place = runnable("campaigns")[name].relative_to(ROOT).with_suffix("")
    campaign: Campaign = importlib.import_module(".".join(place.parts)).CAMPAIGN
    assert isinstance(campaign.table([], runner._parsed(name, campaign, [])), str)
    assert not campaign.failed([])


def test_a_name_that_is_unknown_is_told_the_others(capsys: pytest.CaptureFixture[str]) -> None:
    assert by_name("benchmarks", ["nothing"]) == 2
    told = capsys.readouterr()
    assert "there is no 'nothing'" in told.err
    assert told.out.startswith("bench ")
    assert by_name("benchmarks", ["--help"]) == 0
