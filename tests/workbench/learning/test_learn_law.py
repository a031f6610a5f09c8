"""A learnt law in a model: adopted from its draft, the ladder that it makes, its plan, and the step back.

What `learn` would answer is written here, so that no search is run.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from needle_rig.figures.ladder import ladder_figure
from needle_rig.model import load_model, save_model
from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.draft import Origin
from needle_rig.workbench.laws.formulas import FORMS, Formula
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw
from needle_rig.workbench.learning import learn_law as room
from needle_rig.workbench.learning.adopt import Refused, undo
from needle_rig.workbench.learning.history import ladder
from needle_rig.workbench.learning.learn_law import learn_law
from tests.values import known
from tests.workbench.hidden import dataset, few

THIRD = Law("observe", "hall_2", "angle")
SINE = Formula(next(f for f in FORMS if f.name == "sine"), 90.0, -60.0, (1.5, 0.01, 3.0))
FLAT = Curve(np.arange(3.0), np.zeros(3), np.zeros(3), np.zeros(3), np.ones(3), ())


@dataclasses.dataclass(frozen=True)
class ThirdHarmonic(Effect):
    """The second Hall sensor errs three times a turn."""

    size_deg: float = parameter(
        off=0.0, lower=-9.0, upper=9.0, typical=2.0, smallest=0.5, literature=(-9.0, 9.0), unit="°"
    )

    def observe(self, reading: Reading) -> Reading:
        hall_rad = reading.hall_rad.copy()
        hall_rad[:, 1] += np.radians(self.size_deg) * np.sin(3.0 * hall_rad[:, 1])
        return dataclasses.replace(reading, hall_rad=hall_rad)


def answer(verdict: Any, formula: Formula = SINE) -> Learnt:
    data = dataset(ThirdHarmonic(2.0), seed=31)
    baseline = fit_baseline(data, None, few())
    law = LearntLaw(THIRD, (), 3.0, 1.0, "sine: …", (), FLAT, formula, None)
    return Learnt(verdict, (law,), (), 3.0, 1.0, "An error.", 70, baseline, Origin("hidden", "ab" * 32, "-"))


def learnt(monkeypatch: Any, tmp_path: Any, said: Learnt) -> Any:
    monkeypatch.setattr(room, "learn_laws", lambda *_, **__: said)
    return learn_law(dataset(ThirdHarmonic(2.0), seed=31), few(), tmp_path / "third.py")


def test_the_ladder_goes_from_null_by_the_learnt_law_to_the_noise_and_back(
    monkeypatch: Any, tmp_path: Any
) -> None:
    lesson = learnt(monkeypatch, tmp_path, answer("law"))
    assert lesson.adopted == ("third",)
    steps = ladder(lesson.after)
    assert [s.label for s in steps] == ["null", "+ third"]
    assert known(steps[0].held_out) > 2.0
    assert known(steps[1].held_out) < 1.1 * known(steps[1].floor)
    values = lesson.after.model.values()
    assert values["third.sine_deg"] == pytest.approx(
        2.0, abs=4 * lesson.after.uncertainties["third.sine_deg"]
    )
    save_model(tmp_path / "fitted.yaml", lesson.after)
    again = load_model(tmp_path / "fitted.yaml", effects=[tmp_path])
    assert [s.label for s in ladder(again)] == ["null", "+ third"]
    figure = ladder_figure(again)
    named = [axes for axes in figure.axes if axes.get_visible()]
    assert [label.get_text() for label in named[0].get_xticklabels()] == ["null", "+ third"]
    assert "hall 2 / °" in [axes.get_title() for axes in named]
    back = undo(again)
    assert back.model.effects == ()
    assert back.history == ()


def test_what_cannot_be_told_is_not_adopted(monkeypatch: Any, tmp_path: Any) -> None:
    lesson = learnt(monkeypatch, tmp_path, answer("cannot_tell"))
    assert lesson.adopted == ()
    assert lesson.after is lesson.before
    assert not list(tmp_path.glob("*.py"))


def test_a_draft_that_is_refused_leaves_the_model_as_it_was(monkeypatch: Any, tmp_path: Any) -> None:
    def refused(*_: Any, **__: Any) -> Any:
        raise Refused("third does not lower the error left out")

    monkeypatch.setattr(room, "adopt", refused)
    lesson = learnt(monkeypatch, tmp_path, answer("law"))
    assert lesson.adopted == ()
    assert lesson.after is lesson.before
