"""How Python asks: names that complete, wrong arguments, errors in its words, a script without a guard."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import needle_rig as nr
from tests.notebook.notebooks import ROOT
from tests.workbench.hidden import PROTOCOL

UNGUARDED = """
import needle_rig as nr
from needle_rig.notebook.asking import at_work
print("begun")
with at_work(2).work("it") as work:
    work.share(2)
    print(work.run(pow, [(5,), (3,)]))
"""
TYPED = """
import needle_rig as nr

data = nr.read_dataset("data/mine")
count: int = len(data.trials)
found = nr.diagnose(data)
effects: tuple[str, ...] = found.effects
fit = nr.fit(data, effects=["tissue_elasticity"], fixed={"torsional_rigidity_nmm2": 62.0})
value: float = fit.params["torsional_rigidity_nmm2"].value
nr.compare(data, fit.model).plot("loop")
nr.compare("data/mine", "fitted.yaml")
for trial in data:
    name: str = trial.name
"""


untyped: Any = nr
"""For arguments of wrong types, that mypy refuses."""


def test_every_name_is_there_and_completes() -> None:
    assert set(nr.__all__) <= set(dir(nr))
    for name in nr.__all__:
        assert getattr(nr, name).__doc__
    assert {"fit", "identify", "learn", "strategies", "experiment", "import_recording"} <= set(dir(nr))


@pytest.mark.parametrize(
    ("ask", "said"),
    [
        (lambda: untyped.compare("nowhere/mine"), "nowhere/mine"),
        (lambda: untyped.compare([1.0]), "data is of type list; give a path"),
        (lambda: untyped.compare(data(), 1.0), "model is of type float; give a path"),
        (lambda: untyped.compare(data(), fixed={"torsional_rigidity_nmm2": "62"}), "is '62', not a number"),
        (lambda: untyped.simulate(["tissue_elasticity"]), "effects is of type list; name values"),
        (
            lambda: untyped.simulate({"tissue_elasticity": {"stifness": 0.35}}),
            "tissue_elasticity has no stifness",
        ),
        (
            lambda: untyped.simulate({"tissue_elasticity": "0.35"}),
            "is '0.35', not a number; give it in N·mm/rad",
        ),
        (lambda: untyped.simulate({"tissue_elasticity": None}), "is None, not a number"),
        (lambda: untyped.simulate(protocol=3), "protocol is of type int; name one, or a YAML file"),
        (lambda: untyped.simulate(layout="nowhere"), "layout nowhere: is neither experiment nor model"),
        (lambda: untyped.adopt("diagnosis.yaml"), "diagnosis is of type str; give what diagnose answers"),
        (lambda: untyped.plan("rig_elastic", 45.0, "planed"), "planed"),
        (lambda: untyped.experiment(data(), "tip_friction"), "between is 'tip_friction', not a list of text"),
        (lambda: untyped.diagnose(data(), jobs=0), "^jobs 0: give at least 1"),
        (lambda: untyped.strategies("none", targets_deg=[0.0]), "^target 0°: give angles"),
    ],
)
def test_a_wrong_argument_is_one_sentence_in_python_s_words(ask: Callable[[], Any], said: str) -> None:
    with pytest.raises(nr.BadInput, match=said) as raised:
        ask()
    assert "--" not in str(raised.value)


def data() -> Any:
    return nr.simulate({"tissue_elasticity": 0.35}, protocol=PROTOCOL, name="mine", rate_hz=20.0)


@pytest.mark.whole
def test_an_effect_that_does_not_help_is_refused_without_options() -> None:
    with pytest.raises(nr.NeedleRigError, match=r"With force it is added all the same\.$"):
        nr.add_effect(data(), "torque_bias", nr.add_effect(data(), "tissue_elasticity"))


def test_what_a_recording_lacks_is_asked_in_python() -> None:
    said = nr.identify(data()).report()
    assert "a diagnosis finds what it lacks" in said
    assert "needle-rig" not in said


@pytest.mark.whole
def test_notes_of_a_quick_diagnosis_name_arguments() -> None:
    notes = " ".join(nr.diagnose(data(), quick=True, jobs=1).notes)
    assert "Without quick it is." in notes
    assert "--" not in notes


@pytest.mark.whole
def test_a_plain_script_asks_all_cores_without_running_itself_again(tmp_path: Path) -> None:
    script = tmp_path / "ask.py"
    script.write_text(UNGUARDED)
    ran = subprocess.run(
        [sys.executable, script],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert (ran.stdout, ran.returncode) == ("begun\n[32, 8]\n", 0), ran.stderr


@pytest.mark.slow
def test_mypy_accepts_what_the_docs_write_without_a_cast(tmp_path: Path) -> None:
    script = tmp_path / "docs.py"
    script.write_text(TYPED)
    command = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", str(script)]
    env = {**os.environ, "MYPYPATH": str(ROOT)}
    ran = subprocess.run(command, env=env, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout


def test_effects_and_parameter_sets_are_listed() -> None:
    pytest.importorskip("pandas")
    effects = nr.effects()
    assert effects["tissue_elasticity"].name() == "tissue_elasticity"
    assert len(effects) == len(list(effects)) == len(set(effects.to_pandas()["effect"]))
    assert "rig_rigid" in nr.parameters()
    assert nr.parameters()["rig_rigid"].torsional_rigidity_nmm2 > 0
    assert len(nr.parameters()) == len(nr.parameters().to_pandas())
    assert "<table>" in effects._repr_html_()


def test_a_broken_effect_of_ones_own_warns_where_it_was_asked(tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text("def(")
    with pytest.warns(UserWarning, match=r"bad\.py:1: ") as told:
        nr.compare(data(), effects=[tmp_path])
    assert {warning.filename for warning in told} == {__file__}
