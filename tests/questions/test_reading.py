"""What every question reads in one place: effects with warnings, a model of either kind, data."""

from __future__ import annotations

from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.model import MODEL_LAYOUT, SavedModel, load_parameters, save_model
from needle_rig.questions.doing import Doing
from needle_rig.questions.fit import Fit
from needle_rig.questions.question import Question
from needle_rig.questions.strategies import Strategies


def test_a_broken_effect_is_told_and_the_others_work(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("class Broken(:\n")
    told: list[str] = []
    found = Question(effects=[tmp_path]).library(Doing(tell=told.append))
    assert "tissue_elasticity" in found
    assert len(told) == 1
    assert told[0].startswith("warning: ")
    assert "broken.py" in told[0]


def test_a_rig_is_a_model_file_as_well_with_its_layout(tmp_path: Path) -> None:
    saved = load_parameters("rig_elastic", layout=MODEL_LAYOUT)
    save_model(tmp_path / "mine.yaml", SavedModel(saved, "null"))
    plant = Strategies(parameters=tmp_path / "mine.yaml").plant()
    assert [effect.name() for effect in plant.effects] == ["tissue_elasticity"]
    assert plant.layout.tissue_sections_m[0] == pytest.approx((0.175, 0.275))


def test_settled_values_are_too_few_for_what_needs_traces() -> None:
    with pytest.raises(BadInput, match=r"^reed2008: holds settled values only, too few to fit values one by"):
        Fit(data="reed2008").answer()
