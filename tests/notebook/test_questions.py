"""Strategies, experiments, laws and imports, asked from Python: what the commands answer, as tables."""

from __future__ import annotations

from pathlib import Path

import pytest

import needle_rig as nr
from needle_rig.dataset.protocol import load_protocol
from needle_rig.questions.question import Question
from tests.notebook.notebooks import ROOT
from tests.workbench.hidden import PROTOCOL, dataset, effect, few

PRACTICE = ROOT / "tests/data/practice/elastic"
BETWEEN = ("tip_friction", "chuck_backlash")


def test_strategies_meet_on_one_rig() -> None:
    pytest.importorskip("pandas")
    found = nr.strategies("reed2008", "none", targets_deg=[45.0], seeds=1, jobs=1)
    rows = found.to_pandas().set_index("strategy")
    assert rows.loc["reed2008", "worst_deg"] < rows.loc["none", "worst_deg"]
    assert rows.loc["none", "rotations"] == 1
    assert found.model is None
    assert repr(found) == "rig_elastic (tissue_elasticity)"
    assert len(found.plot().axes) == 2


@pytest.mark.whole
def test_planned_works_with_the_model_that_it_is_given() -> None:
    found = nr.strategies(
        "planned",
        parameters="rig_rigid",
        effects={"tissue_elasticity": 0.35},
        model="rig_elastic",
        targets_deg=[45.0],
        seeds=1,
        jobs=1,
    )
    assert found.model is not None
    assert found.model.headline().startswith("rig_elastic")
    assert "planned should leave" in repr(found)


def test_a_strategy_that_there_is_not_is_refused_before_anything_is_fitted() -> None:
    with pytest.raises(nr.BadInput, match="strategy 'planed' is unknown"):
        nr.strategies("planned", "planed", jobs=1)


@pytest.mark.whole
def test_an_experiment_is_a_protocol_that_can_be_simulated(tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    data = dataset(effect("tip_friction", torque_nmm=0.02))
    found = nr.experiment(data, BETWEEN)
    rows = found.to_pandas()
    assert len(rows) > 6
    assert rows["separation_sigma"].iloc[0] > 3.0
    assert "such trials on top of these data" in repr(found)
    found.save(tmp_path / "decide.yaml")
    assert load_protocol(tmp_path / "decide.yaml").trials == found.protocol.trials
    assert len(nr.simulate(protocol=found.protocol, rate_hz=20.0)) == 3
    with pytest.raises(nr.BadInput, match=r"^between tip_friction tip_friction: name two different"):
        nr.experiment(data, ("tip_friction", "tip_friction"))


@pytest.mark.whole
def test_what_the_library_holds_is_no_law(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    monkeypatch.setattr(Question, "library", lambda *_: few("tissue_elasticity", "torque_bias"))
    data = nr.simulate({"tissue_elasticity": 0.45}, protocol=PROTOCOL, name="mine", rate_hz=20.0)
    found = nr.learn(data, jobs=1)
    assert (found.verdict, found.library, found.formulas) == ("library", ("tissue_elasticity",), ())
    assert repr(found).startswith("mine: library. ")
    assert len(found.to_pandas()) == 0
    with pytest.raises(nr.BadInput, match="there is no curve"):
        found.plot()


def test_a_recording_is_imported_once_its_doubts_are_accepted(tmp_path: Path) -> None:
    pytest.importorskip("polars")
    trial = nr.read_dataset(PRACTICE)[0].to_pandas().drop(columns=["trial", "motion"])
    log = tmp_path / "log.csv"
    trial.assign(hall_1_deg=trial["hall_4_deg"], hall_4_deg=trial["hall_1_deg"]).to_csv(log, index=False)
    with pytest.raises(nr.BadInput, match=r"hall_1.*take the guess as it is with accept_doubts=True$"):
        nr.import_recording(log, out=tmp_path / "mine", layout=PRACTICE)
    found = nr.import_recording(log, out=tmp_path / "mine", layout=PRACTICE, accept_doubts=True)
    assert len(found) == len(nr.read_dataset(tmp_path / "mine")) == 1
    again = nr.import_recording(tmp_path / "mine" / "import.yaml", out=tmp_path / "again")
    assert repr(again).split(": ")[1] == repr(found).split(": ")[1]
    with pytest.raises(nr.BadInput, match="exists already; name another folder with out"):
        nr.import_recording(log, out=tmp_path / "mine")
