"""What `learn` refuses before it computes anything, and what it prints."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.cli.main import run as command
from needle_rig.workbench.laws import symbolic
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw
from needle_rig.workbench.laws.symbolic import SymbolicFormula
from needle_rig.workbench.learning import learn_law

SINE = Formula(next(f for f in FORMS if f.name == "sine"), 90.0, -45.0, (0.05, 0.01, 2.0))
CURVE = Curve(np.arange(3.0), np.zeros(3), np.zeros(3), np.zeros(3), np.ones(3), ())
SLIT = LearntLaw(
    Law("torque", "section_3", "angle"),
    (Law("torque", "tissue", "angle"),),
    18.8,
    0.97,
    "sine: 0.05 · sin(2 · v)",
    (("times", 2.0, 0.001, "1"), ("sine_nmm_per_100mm", 0.05, 0.002, "N·mm per 100 mm")),
    CURVE,
    SINE,
    {
        "between": ["a", "b"],
        "kind": "compensate",
        "target_deg": 45.0,
        "settle_s": 3.0,
        "separation_sigma": 4.0,
        "watch": "hall_2_deg",
        "sentence": "a trial would tell.",
        "steps_deg": [45.0],
        "speed_deg_s": 45.0,
        "duration_s": 10.0,
    },
)


@pytest.mark.parametrize(
    ("out", "said"),
    [
        ("nowhere/found.py", "there is no folder nowhere; make it, or name another place"),
        ("found.txt", "an effect's file is a Python file; name it as found.py"),
        ("_found.py", "an effect's file is a Python file; name it as found.py"),
        ("2nd law.py", "an effect's file is a Python file; name it as found.py"),
        ("torque_bias.py", "there is an effect torque_bias already; name the file otherwise"),
    ],
)
def test_a_place_for_the_draft_that_cannot_be_one(
    out: Any, said: Any, tmp_path: Any, monkeypatch: Any, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    assert command(["learn", "no-data", "--out", out]) == 2
    assert capsys.readouterr().err == f"{out}: {said}\n"


def test_settled_values_are_too_few_for_a_curve(capsys: Any) -> None:
    assert command(["learn", "reed2008"]) == 2
    said = capsys.readouterr().err
    assert "reed2008: holds settled values only, too few to learn a curve; name a dataset of traces" in said
    assert len(said.splitlines()) == 1


@pytest.fixture
def answered(monkeypatch: Any) -> Any:
    """The command with an answer that needs no computing."""
    layout = SimpleNamespace(tissue_sections_m=((0.1, 0.12), (0.2, 0.22), (0.3, 0.32)))
    baseline: Any = SimpleNamespace(dataset=SimpleNamespace(layout=layout))
    origin = Origin("mine", "ab" * 32, "2026-11-23")
    answer = Learnt("law", (SLIT,), (), 18.8, 0.97, "A torque.", 70, baseline, origin)
    monkeypatch.setattr(learn_law, "laws_of", lambda *_, **__: answer)
    return str(Path(__file__).resolve().parents[2] / "data" / "practice" / "backlash")


def test_a_law_is_told_with_its_numbers_its_ties_and_the_next_step(
    answered: Any, tmp_path: Any, capsys: Any
) -> None:
    draft = tmp_path / "found.py"
    assert command(["learn", answered, "--out", str(draft)]) == 0
    told = capsys.readouterr()
    assert "times = 2 ± 0.001\n" in told.out
    assert "sine_nmm_per_100mm = 0.05 ± 0.002 N·mm per 100 mm\n" in told.out
    assert "cannot be told apart from: a torque along the tissue" in told.out
    assert "next: a trial would tell." in told.out
    assert f"adopt it: needle-rig adopt {answered} found --effects {tmp_path} --out MODEL.yaml\n" in told.out
    assert f"wrote {draft}\n" in told.err
    assert "class Found(Effect):" in draft.read_text(encoding="utf-8")


def test_the_json_answer_stands_alone_on_stdout(answered: Any, capsys: Any) -> None:
    assert command(["learn", answered, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["verdict"] == "law"
    assert told["laws"][0]["tied_with"] == [{"hook": "torque", "place": "tissue", "variable": "angle"}]
    assert isinstance(told["seconds"], float)


def test_pysr_is_told_beside_our_formula(answered: Any, monkeypatch: Any, capsys: Any) -> None:
    other = SymbolicFormula("sin(v + v)", 0.5, radians=True)
    monkeypatch.setattr(symbolic, "regressor", lambda: object)
    monkeypatch.setattr(symbolic, "formula_of", lambda *_: other)
    assert command(["learn", answered, "--pysr"]) == 0
    assert "  PySR: sin(v + v), v in radians; 0.5 × the curve's uncertainty off\n" in capsys.readouterr().out
    assert command(["learn", answered, "--pysr", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["laws"][0]["pysr"] == "sin(v + v)"


def test_pysr_that_is_not_there_is_said_before_anything_is_computed(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setitem(sys.modules, "pysr", None)
    assert command(["learn", "no-data", "--pysr"]) == 2
    said = capsys.readouterr().err
    assert "pip install -c requirements.lock -e '.[pysr]'" in said
    assert len(said.splitlines()) == 1
