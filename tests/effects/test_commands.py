"""`needle-rig parameters` and `needle-rig effects` say what there is."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from needle_rig.cli.main import run
from tests.effects.common import USERS


def test_parameters_lists_every_set(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["parameters"]) == 0
    out = capsys.readouterr().out
    for name in ("paper_literal", "figure_3", "rig_rigid", "rig_elastic", "stiff_needle"):
        assert name in out
    assert "Coulomb friction 0.1058 N·mm per 100 mm" in out


def test_parameters_shows_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["parameters", "rig_elastic"]) == 0
    out = capsys.readouterr().out
    assert "does not reproduce:" in out
    assert "BioRob 2008" in out
    assert run(["parameters", "rig_elastic", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["friction_nmm_per_100mm"] == 0.1058
    assert run(["parameters", "--json"]) == 0
    assert len(json.loads(capsys.readouterr().out)["parameters"]) >= 5
    assert run(["parameters", "none_such"]) == 2
    assert "there is no parameter set none_such" in capsys.readouterr().err


def test_effects_lists_built_in_and_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["effects", "--effects", str(USERS)]) == 0
    out = capsys.readouterr().out
    assert "slit_membrane" in out
    assert "(your own)" in out
    assert "tissue_viscoelasticity" in out


def test_effects_shows_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["effects", "tissue_elasticity"]) == 0
    out = capsys.readouterr().out
    assert "Law:" in out
    assert "off inf, typical 0.35" in out
    assert run(["effects", "tissue_elasticity", "--json"]) == 0
    described = json.loads(capsys.readouterr().out)
    assert described["parameters"][0]["off"] == "inf"
    assert described["hooks"] == ["shape"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["effects", "tip_fricton"], "did you mean tip_friction?"),
        (["effects", "--effects", "no/such"], "no/such: there is no such folder of effects"),
    ],
)
def test_what_is_not_there(capsys: pytest.CaptureFixture[str], arguments: list[str], words: str) -> None:
    assert run(arguments) == 2
    err = capsys.readouterr().err
    assert words in err
    assert err.count("\n") == 1


def test_a_broken_file_gets_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.py").write_text("def :\n")
    assert run(["effects", "--effects", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    assert f"{tmp_path}/mine.py:1: invalid syntax" in err
    assert err.count("\n") == 1


def test_a_law_that_cannot_be_compiled_is_found_while_listing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (USERS / "slit_membrane.py").read_text().replace("math.sin(2.0 * angle_rad)", "self.wobble")
    (tmp_path / "mine.py").write_text(text)
    assert run(["effects", "--effects", str(tmp_path)]) == 2
    err = capsys.readouterr().err
    line = text[: text.index("self.wobble")].count("\n") + 1
    assert f"{tmp_path}/mine.py:{line}: torque of mine cannot be compiled: " in err
    assert "wobble" in err
