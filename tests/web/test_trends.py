"""What the page shows of the watch: the files that the watch keeps, and nothing of its own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from needle_rig.recording.watch_summary import WATCH_FOLDER
from needle_rig.web.trends import LAG, trends
from needle_rig.workbench.learning.watch import MISFIT, limits, reference_range
from needle_rig.workbench.learning.watched_runs import Watched, WatchedRun
from tests.web.served import Served

FRICTION = "friction_nmm_per_100mm"
REFERENCE = 20


def watched(number: int, friction: float, misfit: float = 1.0, **more: Any) -> WatchedRun:
    """What a run said that has this friction; `at` is its logarithm, near 0.1."""
    one = Watched(at=10.0 * (friction - 0.1), value=friction, uncertainty=0.001, unit="N·mm", least=0.02)
    return WatchedRun(
        run=f"run{number:03d}",
        started_utc=f"2026-11-01T{number // 60:02d}:{number % 60:02d}:00",
        rig="r",
        parameters={FRICTION: one},
        misfit=misfit,
        **more,
    )


def kept(folder: Path, runs: list[WatchedRun]) -> str:
    """The folder as the watch leaves it."""
    (folder / WATCH_FOLDER).mkdir()
    for run in runs:
        (folder / WATCH_FOLDER / f"{run.run}.json").write_text(json.dumps(run.model_dump()))
    return str(folder)


def series(count: int, jump: float = 0.0) -> list[WatchedRun]:
    """Runs that scatter by 1 %, and from the 21st on have more friction."""
    return [
        watched(k, 0.1 + 0.001 * (-1) ** k + (jump if k >= REFERENCE else 0.0), 1.0 + 0.02 * (k % 3))
        for k in range(count)
    ]


def by_name(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {chart["name"]: chart for chart in found["charts"]}


def test_a_change_is_an_alarm_with_the_run_since_which_it_is(tmp_path: Path) -> None:
    found = trends(kept(tmp_path, series(30, jump=0.02)), {})
    assert found["alarm"]
    assert "up since" in found["sentences"][0]
    charts = by_name(found)
    assert charts[FRICTION]["since"] == "run020"
    assert charts[MISFIT]["since"] is None
    low, high = charts[FRICTION]["range"]
    inside = [low < value < high for value in charts[FRICTION]["values"]]
    assert inside == [True] * 20 + [False] * 10


def test_where_nothing_changed_no_alarm_is_shown(tmp_path: Path) -> None:
    lags = {f"run{k:03d}": 5.0 + 0.1 * (k % 2) for k in range(29)}
    found = trends(kept(tmp_path, series(30)), lags)
    assert not found["alarm"]
    charts = by_name(found)
    assert charts[FRICTION]["since"] is None
    assert charts[LAG]["values"][-1] is None  # of a run whose file was not read yet
    assert charts[LAG]["range"][0] < 5.0 < 5.1 < charts[LAG]["range"][1]


def test_in_the_reference_period_there_is_no_range(tmp_path: Path) -> None:
    found = trends(kept(tmp_path, series(7)), {})
    assert "7 of 20" in found["sentences"][0]
    assert not found["alarm"]
    assert {chart["range"] for chart in found["charts"]} == {None}


def test_runs_that_are_not_judged_are_named_and_another_rig_is_left_out(tmp_path: Path) -> None:
    other = [run.model_copy(update={"rig": "another"}) for run in series(3)]
    mute = watched(50, 0.1, not_judged="ended as aborted")
    found = trends(kept(tmp_path, [*other, *(watched(k, 0.1) for k in range(10, 15)), mute]), {})
    assert [run["run"] for run in found["runs"]] == [f"run{k:03d}" for k in range(10, 15)]
    assert found["not_judged"] == [{"run": "run050", "why": "ended as aborted"}]


def test_without_a_watch_the_page_is_told_so(tmp_path: Path) -> None:
    assert trends(str(tmp_path), {})["watched"] is False
    assert limits([], REFERENCE) == {}


def test_a_range_is_of_the_scatter_or_of_what_matters() -> None:
    low, high = reference_range([1.0, 1.0, 1.0, 1.0], 0.02)
    assert (low, high) == pytest.approx((1.0 - 0.06 * 1.25**0.5, 1.0 + 0.06 * 1.25**0.5))
    assert reference_range([1.0, 1.0]) == (1.0, 1.0)


@pytest.mark.whole
def test_the_page_asks_for_trends_and_may_have_new_runs_looked_at(served: Served) -> None:
    assert served.ask("GET", "/api/trends").json()["watched"] is False
    assert served.ask("POST", "/api/jobs", json={"kind": "watch"}).status_code == 202
