"""What the page may ask of a comparison and its figures: each refusal is a sentence."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

from needle_rig.figures.residuals import FIGURES
from needle_rig.model import load_saved, save_model
from tests.web.served import Served

STATIC = Path(__file__).parents[2] / "needle_rig" / "web" / "static"


def test_the_page_offers_the_figures_that_there_are() -> None:
    listed = (STATIC / "compared.js").read_text().split("const FIGURES")[1].split("});")[0]
    assert set(re.findall(r"^  (\w+):", listed, re.MULTILINE)) == set(FIGURES)


CHART = {
    "title": "t",
    "x": "time / s",
    "y": "°",
    "series": [{"label": "a", "look": "line"}],
    "shared": [0.0],
    "each": [[[1.0]]],
}


@pytest.mark.whole
@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"kind": "figure", "what": "loop"}, "what this builds on is not there any more"),
        ({"kind": "figure", "what": "loop", "compared": "../"}, "what this builds on is not there any more"),
        ({"kind": "open"}, "this upload is not there any more"),
        ({"kind": "compare", "fixed": {"friction_nmm_per_100mm": "much"}}, "is 'much', not a number"),
        ({"kind": "compare", "fixed": {"friction_nmm_per_100mm": True}}, "is True, not a number"),
        ({"kind": "compare", "fixed": 3}, "fixed is of type int; give values by name"),
        ({"kind": "compare", "free": "all"}, "free is 'all', not a list of text"),
        ({"kind": "compare", "refit": 1}, "refit is 1, not true or false"),
        ({"kind": "compare", "free": ["friction_nmm_per_100mm"]}, "leave fixed and free out"),
        ({"kind": "compare", "model": "rig_soft"}, "what this builds on is not there any more"),
        ({"kind": "chart"}, "there is no chart to draw"),
        ({"kind": "chart", "chart": CHART | {"each": [[[1.0]], [[1.0]]]}}, "not the values of its series"),
        ({"kind": "chart", "chart": CHART | {"each": [[[1.0, 2.0]]]}}, "as many values along as up"),
        ({"kind": "chart", "chart": CHART | {"bands": [[1, 2]]}}, "a band without edges"),
        ({"kind": "chart", "chart": CHART | {"level": "3"}}, "valid number"),
        ({"kind": "chart", "chart": CHART | {"title": "x" * 201}}, "at most 200"),
        ({"kind": "take_values"}, "choose a model with values"),
    ],
)
def test_what_cannot_be_asked_is_a_sentence(served: Served, asked: dict[str, Any], said: str) -> None:
    _, answer = worked(served, {"data": ["shipped:reed2008"], "model": None, **asked})
    assert said in answer["error"]


def worked(served: Served, request: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """Key of the job, and what it says at its end."""
    answer = served.ask("POST", "/api/jobs", json=request).json()
    job = answer.get("job", "")
    while job and answer.get("state", "running") in ("waiting", "running"):
        time.sleep(0.1)
        answer = served.ask("GET", f"/api/jobs/{job}").json()
    return job, answer


@pytest.mark.whole
@pytest.mark.parametrize(
    ("what", "said"),
    [("loops", "figure loops: there are traces"), ("loop", "reed2008 has settled values only, no traces")],
)
def test_a_figure_is_of_the_comparison_that_the_page_has(served: Served, what: str, said: str) -> None:
    key, _ = worked(served, {"kind": "compare", "data": ["shipped:reed2008"], "model": None})
    _, answer = worked(served, {"kind": "figure", "compared": key, "what": what})
    assert said in answer["error"]


@pytest.mark.whole
def test_a_model_file_that_is_dropped_is_a_model_to_hold_against_data(served: Served, tmp_path: Path) -> None:
    save_model(tmp_path / "mine.yaml", load_saved("rig_elastic"))
    upload = served.ask("POST", "/api/uploads", json={"name": "mine"}).json()["upload"]
    content = (tmp_path / "mine.yaml").read_bytes()
    taken = served.ask("PUT", f"/api/uploads/{upload}/mine.yaml", content=content).json()
    assert taken == {"files": 1, "data": 0, "model": True}
    key, answer = worked(served, {"kind": "open", "upload": upload})
    assert answer["result"]["added"] == ["tissue_elasticity"]
    _, answer = worked(served, {"kind": "compare", "data": ["shipped:reed2008"], "model": key})
    assert answer["state"] == "done"


@pytest.mark.whole
def test_without_a_watch_no_run_contradicts_the_model(served: Served) -> None:
    assert served.ask("GET", "/api/watch").json() == {"contradiction": "", "version": ""}
    assert served.ask("GET", "/api/watch", headers={}).status_code == 401
