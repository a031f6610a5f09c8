"""A diagnosis as one file to send: it holds all that it shows, and says of which data and model it is."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from typing import Any

import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from needle_rig.physics.library import find_effects
from needle_rig.questions.diagnose import Diagnose
from needle_rig.workbench.learning.compare import compare
from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis
from needle_rig.workbench.virtual.dataset import simulate_dataset
from tests.workbench.hidden import PROTOCOL

pytest.importorskip("matplotlib", reason="no matplotlib here: pip install needle-rig[figures]")

VALUE = {"value": 0.35, "low": 0.3, "high": 0.4, "unit": "N·mm/rad"}
TOLD: dict[str, Any] = {
    "dataset": "mine",
    "model": "null",
    "verdict": "effect",
    "sentence": "tissue_elasticity is missing",
    "errors_sentence": "Error on commands left out: 32.2 → 0.98 (noise is 1.00)",
    "effects": ["tissue_elasticity"],
    "ties": [],
    "reasons": [{"rule": "r", "sentence": "the residual has a pattern"}],
    "ranking": [
        {
            "effect": "tissue_elasticity",
            "held_out_error": 0.98,
            "error_removed": 1.0,
            "parameters": {"stiffness": VALUE},
            "in_favour": "it removes all",
            "against": "",
        },
        {
            "effect": "slit_membrane",
            "held_out_error": None,
            "error_removed": 0.0,
            "parameters": {},
            "in_favour": "",
            "against": "<b>worse</b>",
        },
    ],
    "left_over": [],
    "next_experiment": None,
    "notes": ["<script>alert(1)</script>"],
}
KEPT = KeptDiagnosis(
    dataset="mine",
    sha256="d" * 64,
    started_from="null",
    verdict="effect",
    effects=("tissue_elasticity",),
    held_out_error_before=32.2,
    held_out_error_after=0.98,
    noise={},
    policy={},
    explanations=(),
    models=(),
    place="diagnosis.yaml",
)


@pytest.mark.whole
def test_a_report_is_one_file_with_names_hashes_answer_numbers_and_pictures(tmp_path: Path) -> None:
    data = simulate_dataset(load_parameters("rig_elastic"), PROTOCOL, name="mine")
    compared = compare(data, find_effects(), None)
    Diagnose(data=["mine"]).write_report(TOLD, KEPT, compared, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count('src="data:image/png;base64,') == 3
    assert not re.findall(r"(?:src|href)=\"(?!data:)", page)  # nothing is loaded from elsewhere


def test_a_report_names_data_model_question_and_numbers_and_shows_text_as_text(tmp_path: Path) -> None:
    Diagnose(data=["mine"], quick=True).write_report(TOLD, KEPT, None, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    for told in ("What null lacks on mine", "d" * 64, "one effect alone", "Tissue_elasticity is missing"):
        assert told in page
    assert '<th>tissue_elasticity: stiffness</th><td class="number">0.35</td>' in page
    assert "N·mm/rad" in page
    assert "<script" not in page
    assert "<b>worse" not in page
    assert "model file" not in page


def test_a_model_file_is_named_with_the_hash_of_its_bytes(tmp_path: Path) -> None:
    file = tmp_path / "mine.yaml"
    save_model(file, SavedModel(load_parameters("rig_elastic"), "rig_elastic", {}))
    Diagnose(data=["mine"], model=file).write_report(TOLD, KEPT, None, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert hashlib.sha256(file.read_bytes()).hexdigest() in page
    assert "mine.yaml" in page
    Diagnose(data=["mine"], model="rig_elastic").write_report(TOLD, KEPT, None, tmp_path / "report.html")
    assert "model file" not in (tmp_path / "report.html").read_text()
