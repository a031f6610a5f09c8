"""The circle closes: the hidden effect is found, and the needle ends straighter on fresh needles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needle_rig.cli.main import run as command
from needle_rig.figures.demo import demo_figure
from needle_rig.figures.figure import png
from needle_rig.model import effect_directories, load_parameters
from needle_rig.physics.effects.tissue_elasticity import TissueElasticity
from needle_rig.physics.library import find_effects
from needle_rig.workbench.contest.demo import Story, in_words, tell_law_story, tell_story
from needle_rig.workbench.contest.untold_law import SLIT, TYPICAL_NMM_PER_100MM
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw
from needle_rig.workbench.learning import learn_law as room
from tests.values import known

CANDIDATES = ("tissue_elasticity", "tip_friction", "chuck_compliance")
"""A small library keeps the diagnosis short; the whole one is the benchmark's matter."""


@pytest.fixture(scope="module")
def story() -> Story:
    library = find_effects(effect_directories(()))
    plant = load_parameters("rig_rigid").with_effects(TissueElasticity(0.3))
    return tell_story(plant, {name: library[name] for name in CANDIDATES}, runs=4)


@pytest.mark.whole
def test_the_circle_closes(story: Story) -> None:
    told = story.as_json()
    assert told["adopted"] == ["tissue_elasticity"]
    assert told["found"]
    stiffness = told["parameters"]["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"]
    assert stiffness["value"] == pytest.approx(0.3, rel=0.05)
    held = told["held_out_error"]
    floor = known(held["noise_floor"])
    assert known(held["before"]) > 5.0 * floor
    assert known(held["after"]) < 1.6 * floor
    assert told["reed2008"]["worst_deg"]["median"] > 6.0
    planned = known(told["planned"])
    assert planned["worst_deg"]["median"] < 1.0
    assert planned["rotations"] < told["reed2008"]["rotations"]
    assert planned["time_s"] < told["reed2008"]["time_s"] / 2
    assert known(told["times_better"]) > 3.0


@pytest.mark.whole
def test_it_can_be_read_and_seen(story: Story) -> None:
    words = in_words(story)
    assert words[2].startswith("3. diagnose names tissue_elasticity; adopting brings that error to 1.")
    assert words[3].startswith("4. Before it moves: planned should leave 0.")
    assert words[-1] == "Hidden in the rig was tissue_elasticity. It was exactly that."
    assert png(demo_figure(story))[:4] == b"\x89PNG"


def answered(dataset: Any, library: Any, _model: Any, **_: Any) -> Learnt:
    """What `learn` says of the hidden slit, without its search."""
    baseline = fit_baseline(dataset, None, library)
    form = next(f for f in FORMS if f.name == "sine")
    sine = Formula(form, 90.0, -90.0, (-0.9 * TYPICAL_NMM_PER_100MM, 0.001, 2.0))
    at = np.linspace(-90.0, 90.0, 121)
    value = sine.at(at)
    curve = Curve(at, value, value - 0.01, value + 0.01, np.ones(121), (value, value))
    law = LearntLaw(SLIT, (), 40.0, 1.0, "sine: …", (), curve, sine, None)
    return Learnt("law", (law,), (), 40.0, 1.0, "A torque.", 70, baseline, Origin("runs", "0" * 64, "-"))


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_law_that_nobody_told_straightens_the_needle(monkeypatch: Any, tmp_path: Path) -> None:
    monkeypatch.setattr(room, "learn_laws", answered)
    library = find_effects(effect_directories(()))
    few = {name: library[name] for name in CANDIDATES}
    story = tell_law_story(load_parameters("rig_rigid"), few, tmp_path / "law.py", runs=3)
    assert story.found
    assert story.lesson.adopted == ("law",)
    told = story.as_json()
    held = told["held_out_error"]
    assert known(held["before"]) > 10.0
    assert known(held["after"]) < 1.1 * known(held["noise_floor"])
    assert told["parameters"]["law.sine_nmm_per_100mm"]["value"] == pytest.approx(-0.24, rel=0.02)
    assert known(told["times_better"]) > 5.0
    words = in_words(story)
    assert words[2].startswith(
        f"3. No effect of the library explains it; learn says that {SLIT.words()}, sine"
    )
    assert words[-1] == (
        "Hidden in the rig was a torque in tissue section 3, -0.24 · sin(2 · v) N·mm per 100 mm with v the"
        " angle of the needle there. Nobody had told it."
    )
    figure = demo_figure(story)
    assert len(figure.axes) == 4
    assert png(figure)[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (["--law", "--effect", "chuck_backlash"], "law hides one of its own; name no effect beside it"),
        (["--law", "--target", "0"], "target_deg 0: there is nothing to turn"),
    ],
)
def test_a_law_that_cannot_be_hidden_is_said(asked: Any, said: str, capsys: Any) -> None:
    assert command(["demo", *asked]) == 2
    assert said in capsys.readouterr().err


def test_a_rig_without_the_laws_section_is_said(monkeypatch: Any, capsys: Any) -> None:
    monkeypatch.setattr("needle_rig.workbench.contest.untold_law.SECTION", 9)
    assert command(["demo", "--law"]) == 2
    assert "the law acts in tissue section 9, and rig_rigid has 4; name another" in capsys.readouterr().err


def test_a_model_file_whose_law_would_take_an_effects_name_is_said(
    monkeypatch: Any, tmp_path: Path, capsys: Any
) -> None:
    taken = tmp_path / "m_law.py"
    source = Path(__file__).resolve().parents[2] / "data" / "effects"
    taken.write_text(next(iter(sorted(source.glob("*.py")))).read_text(encoding="utf-8"), encoding="utf-8")
    out = tmp_path / "m.yaml"
    assert command(["demo", "--law", "--effects", str(tmp_path), "--out", str(out)]) == 2
    assert "m_law.py: there is an effect m_law already; name the file otherwise" in capsys.readouterr().err
