"""What a job of the page answers: the same questions, as documents, with their steps told."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from needle_rig.dataset import read_dataset
from needle_rig.errors import BadInput
from needle_rig.physics.effects.tissue_elasticity import TissueElasticity
from needle_rig.questions.doing import Doing
from needle_rig.questions.strategies import Strategies
from needle_rig.web import traces
from needle_rig.web.desk import EXAMPLE
from needle_rig.web.openapi import REFERENCE
from needle_rig.web.places import COMPARISON, DATASET, DIAGNOSIS, MODEL
from needle_rig.web.work import work
from tests.web.fitting import fits
from tests.workbench.hidden import dataset

RESULTS = {
    "compare": "CompareResult",
    "diagnose": "DiagnoseResult",
    "strategies": "StrategiesResult",
    **dict.fromkeys(("adopt", "add_effect", "undo", "take_values", "open"), "ModelResult"),
}
"""Kinds whose form the browser's types say."""
TIED = ["chuck_compliance", "torque_gain"]


def asked(kind: str, out: Path, **request: Any) -> tuple[dict[str, Any], list[str]]:
    """The document, and the steps that were told on the way."""
    said: list[str] = []
    document = work(kind, {**request, "out": str(out)}, Doing(jobs=1, say=said.append))
    if kind in RESULTS:
        fits(document, {"$ref": f"{REFERENCE}{RESULTS[kind]}"}, kind, whole=False)
    return document, said


@pytest.mark.whole
def test_from_a_diagnosis_to_a_model_and_back(tmp_path: Path) -> None:
    about = {"data": ["reed2008"], "effects": []}
    compared, said = asked("compare", tmp_path, **about, model=None)
    assert compared["name"] == "reed2008"
    assert compared["traces"] is None
    assert said[0] == "fitting the model to the settled values"
    found, said = asked("diagnose", tmp_path, **about, model=None, quick=True)
    assert (found["ties"], found["quick"], found["candidates"]) == (TIED, True, {})
    assert "policy" not in found
    assert said[-1] == "keeping the fits"
    file = str(tmp_path / DIAGNOSIS)
    if find_spec("matplotlib"):
        again = {**about, "model": None}
        given = {"diagnosis": file, "comparison": str(tmp_path / "kept" / COMPARISON), "again": again}
        del found["candidates"]
        written, _ = asked("report", tmp_path, **given, told=found, question={**again, "quick": True})
        assert "chuck_compliance" in (tmp_path / written["file"]).read_text()
    model, _ = asked("adopt", tmp_path, **about, diagnosis=file, chosen=["tissue_elasticity"])
    assert model["added"] == ["tissue_elasticity"]
    back, _ = asked("undo", tmp_path, effects=[], model=str(tmp_path / MODEL))
    assert back == {"model": None, "steps": [], "values": [], "added": []}


@pytest.mark.whole
def test_an_effect_is_added_by_name_as_a_learnt_law_is(tmp_path: Path) -> None:
    law = {"data": ["reed2008"], "model": None, "effect": "tissue_elasticity"}
    model, said = asked("add_effect", tmp_path, **law, effects=[])
    assert model["added"] == ["tissue_elasticity"]
    assert said == ["fitting tissue_elasticity"]


@pytest.mark.whole
def test_strategies_run_on_the_rig_that_planned_knows(tmp_path: Path) -> None:
    rig = {"parameters": "rig_elastic", "model": "rig_elastic", "effects": []}
    found, _ = asked("strategies", tmp_path, **rig, targets_deg=[10.0], seeds=1)
    assert {row["strategy"] for row in found["rows"]} > {"planned", "reed2008"}
    assert found["target_deg"] == 10.0
    assert found["sequences"]["reed2008"]["motions"][0]["name"] == "rest"


def test_a_request_that_asks_something_else_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"^folder: is not asked here; give effects, data, model"):
        asked("compare", tmp_path, data=["nowhere"], model=None, folder="/etc")
    with pytest.raises(BadInput, match="seeds 0: give 1 to 1000"):
        asked("strategies", tmp_path, targets_deg=[10.0], seeds=0)


def test_the_example_is_a_simulated_dataset(tmp_path: Path) -> None:
    found, said = asked("example", tmp_path, **EXAMPLE, rate_hz=5.0)
    assert (found, said) == ({"name": "example"}, ["simulating a series"])
    assert len(read_dataset(tmp_path / DATASET).trials) == 8


def test_a_run_is_exported_as_one_file(run_path: Path, tmp_path: Path) -> None:
    for form, ending in {"csv": "_csv.zip", "dataset": "_dataset.zip"}.items():
        found, said = asked("export", tmp_path, data=[str(run_path)], form=form)
        assert (found, said) == ({"file": f"{run_path.stem}{ending}"}, ["writing the file"])
        assert (tmp_path / found["file"]).is_file()
    with pytest.raises(BadInput, match="form is 'pdf', not csv or dataset or mcap or png"):
        asked("export", tmp_path, data=[str(run_path)], form="pdf")


def test_no_target_is_refused_in_a_sentence() -> None:
    with pytest.raises(BadInput, match="no target was named; give one angle at least"):
        Strategies(names=["none"], targets_deg=()).answer()


@pytest.mark.whole
def test_the_worst_trials_are_drawn_first_and_a_figure_needs_no_second_comparison(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(traces, "TRIALS", 2)
    data = dataset(TissueElasticity(0.35), seed=2)
    found, _ = asked("compare", tmp_path, data=data, model=None, effects=[])
    drawn = [trial["file"] for trial in found["traces"]["trials"]]
    worst = max((place for place in found["places"] if place["sigmas"]), key=lambda place: place["sigmas"])
    assert drawn[0] == worst["trial"] != data.trials[0].file
    assert (len(drawn), found["traces"]["of"]) == (2, len(data.trials))
    figure, said = asked("figure", tmp_path, comparison=str(tmp_path / COMPARISON), what="loop", again={})
    assert said == ["drawing loop"]
    assert all((tmp_path / file).is_file() for file in figure["files"].values())
    told, _ = asked("diagnose", tmp_path, data=data, model=None, effects=[], quick=True)
    assert {tuple(candidate) for candidate in told["candidates"].values()} == {tuple(drawn)}
