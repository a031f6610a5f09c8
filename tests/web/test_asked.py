"""What the page may ask of a comparison and its figures: each refusal is a sentence."""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any

import pytest

from needle_rig.figures.residuals import FIGURES
from tests.web.served import Served

STATIC = Path(__file__).parents[2] / "needle_rig" / "web" / "static"


def test_the_page_offers_the_figures_that_there_are() -> None:
    listed = (STATIC / "compared.js").read_text().split("const FIGURES")[1].split("});")[0]
    assert set(re.findall(r"^  (\w+):", listed, re.MULTILINE)) == set(FIGURES)


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"kind": "figure", "what": "loops"}, "figure loops: there are traces"),
        ({"kind": "figure", "what": "loop"}, "reed2008"),
        ({"kind": "compare", "fixed": {"friction_nmm_per_100mm": "much"}}, "give a number for each value"),
        ({"kind": "compare", "fixed": {"friction_nmm_per_100mm": True}}, "give a number for each value"),
        ({"kind": "compare", "free": "all"}, "names of those that are free"),
        ({"kind": "compare", "free": ["friction_nmm_per_100mm"]}, "leave fixed and free out"),
        ({"kind": "compare", "model": "rig_soft"}, "what this builds on is not there any more"),
        ({"kind": "take_values"}, "choose a model with values"),
    ],
)
def test_what_cannot_be_asked_is_a_sentence(served: Served, asked: dict[str, Any], said: str) -> None:
    request = {"data": ["shipped:reed2008"], "model": None, **asked}
    answer = served.ask("POST", "/api/jobs", json=request).json()
    job = answer.get("job")
    while job and answer.get("state", "running") == "running":
        time.sleep(0.1)
        answer = served.ask("GET", f"/api/jobs/{job}").json()
    assert said in answer["error"]


def test_without_a_watch_no_run_contradicts_the_model(served: Served) -> None:
    assert served.ask("GET", "/api/watch").json() == {"contradiction": ""}
    assert served.ask("GET", "/api/watch", headers={}).status_code == 401
