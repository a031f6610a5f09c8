"""Parameter sets and model files: everything comes back, and a mistake is named with its line."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.model import (
    EXPERIMENT_LAYOUT,
    MODEL_LAYOUT,
    ChannelErrors,
    HistoryEntry,
    SavedModel,
    load_model,
    load_parameter_set,
    load_parameters,
    parameter_sets,
    save_model,
)
from needle_rig.physics.needle_model import NeedleModel
from tests.effects.common import SHORT, USERS, make_effect

SETS = ("figure_3", "paper_literal", "rig_elastic", "rig_rigid", "stiff_needle")


def test_the_published_sets_are_there_with_their_sources() -> None:
    assert set(SETS) <= set(parameter_sets())
    for name in SETS:
        found = load_parameter_set(name)
        assert found.name == name
        assert "10.1109/BIOROB.2008.4762825" in found.source
        assert found.reproduces
        assert found.does_not_reproduce


@pytest.mark.parametrize("name", [name for name in SETS if name != "paper_literal"])
def test_a_set_becomes_a_model_in_the_layout_asked_for(name: str) -> None:
    model = load_parameters(name)
    assert model.layout == EXPERIMENT_LAYOUT
    assert load_parameters(name, layout=MODEL_LAYOUT, element_length_m=1e-3).layout == MODEL_LAYOUT
    assert model.values()["friction_nmm_per_100mm"] == pytest.approx(
        load_parameter_set(name).friction_nmm_per_100mm
    )


def test_the_literal_set_is_for_the_explicit_scheme() -> None:
    found = load_parameter_set("paper_literal")
    assert found.karnopp is not None
    assert found.karnopp.static_nmm_per_100mm == 0.45
    with pytest.raises(
        BadInput, match=r"paper_literal\.yaml:\d+:\d+: paper_literal is for the solver explicit_kar"
    ):
        load_parameters("paper_literal")


def test_an_unknown_set_is_answered_with_those_there_are() -> None:
    with pytest.raises(
        BadInput, match="there is no parameter set rig_soft; there are figure_3, paper_literal, rig"
    ):
        load_parameters("rig_soft")


@pytest.fixture
def saved() -> SavedModel:
    model = load_parameters("rig_rigid").with_effects(
        make_effect("tissue_elasticity", 0.45),
        make_effect("tip_friction", 0.0),
        make_effect("chuck_compliance", float("inf")),
        make_effect("hall_offset", (1.0, 2.0, 3.0, -4.5)),
    )
    history = HistoryEntry(
        added=("tissue_elasticity",),
        dataset="elastic",
        date="2024-05-01",
        errors={"hall_1_deg": ChannelErrors(training_before=4.2, training_after=0.3, floor=0.25)},
    )
    uncertainties = {
        "friction_nmm_per_100mm": 0.001,
        "tissue_elasticity.stiffness_nmm_per_rad_per_100mm": 0.02,
        "hall_offset.offset_deg[1]": 0.1,
    }
    return SavedModel(model, "rig_rigid", uncertainties, (history,))


def close(one: NeedleModel, other: NeedleModel) -> bool:
    return one.effects == other.effects and one.values() == pytest.approx(other.values(), rel=1e-12)


def test_a_model_file_comes_back(saved: SavedModel, tmp_path: Path) -> None:
    path = tmp_path / "learnt.yaml"
    save_model(path, saved)
    again = load_model(path)
    assert close(again.model, saved.model)
    assert again.uncertainties == saved.uncertainties
    assert again.history == saved.history
    assert again.starts_from == "rig_rigid"
    assert close(load_parameters(path), saved.model)
    assert "unit: N·mm/rad per 100 mm" in path.read_text(encoding="utf-8")
    save_model(path, again)
    assert close(load_model(path).model, again.model)
    assert [p.name for p in tmp_path.iterdir()] == ["learnt.yaml"]


def test_a_model_file_stands_in_its_own_layout(saved: SavedModel, tmp_path: Path) -> None:
    save_model(
        tmp_path / "m.yaml", SavedModel(load_parameters("rig_rigid", layout=MODEL_LAYOUT), "rig_rigid")
    )
    model = load_parameters(tmp_path / "m.yaml")
    assert model.layout.tissue_sections_m[0] == pytest.approx(MODEL_LAYOUT.tissue_sections_m[0])
    assert load_parameters(tmp_path / "m.yaml", layout=EXPERIMENT_LAYOUT).layout == EXPERIMENT_LAYOUT


def test_a_users_effect_in_a_model_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    model = load_parameters("rig_rigid").with_effects(make_effect("slit_membrane", 0.02))
    save_model(tmp_path / "m.yaml", SavedModel(model, "rig_rigid"))
    again = load_model(tmp_path / "m.yaml", effects=[USERS])
    assert again.model.predict(SHORT).torque_nm == pytest.approx(model.predict(SHORT).torque_nm)
    with pytest.raises(BadInput, match=r"m\.yaml:\d+:\d+: there is no effect slit_membrane"):
        load_model(tmp_path / "m.yaml")
    (tmp_path / "config" / "effects").mkdir(parents=True)
    shutil.copy(USERS / "slit_membrane.py", tmp_path / "config" / "effects")
    monkeypatch.chdir(tmp_path)
    (effect,) = load_model(tmp_path / "m.yaml").model.effects
    assert vars(effect)["torque_nmm"] == 0.02


def test_a_missing_folder_of_effects() -> None:
    with pytest.raises(BadInput, match="no/such: there is no such folder of effects"):
        load_parameters("rig_elastic", effects=["no/such"])


@pytest.mark.parametrize(
    ("old", "new", "at", "words"),
    [
        ("value: 0.45", "value: -0.45", "value: -0.45", "-0.45 N·mm/rad per 100 mm is below 0.02"),
        ("value: 0.45", "value: soft", "value: soft", "'soft' is text, not a number"),
        (
            "tissue_elasticity:\n",
            "tissue_elasticty:\n",
            "tissue_elasticty:",
            "did you mean tissue_elasticity?",
        ),
        (
            "stiffness_nmm",
            "stifness_nmm",
            "    stifness_nmm",
            "chuck_compliance has no such parameter; it has sti",
        ),
        ("starts_from: rig_rigid\n", "", "format:", "starts_from is missing"),
        ("needle-rig-model/1", "needle-rig-model/9", "format:", "reads up to 1: upgrade"),
        ("needle_length_mm: 397", "needle_length_mm: 3", "format:", "leaves the needle"),
    ],
)
def test_a_mistake_in_a_model_file_is_named_with_its_line(
    saved: SavedModel, tmp_path: Path, old: str, new: str, at: str, words: str
) -> None:
    path = tmp_path / "m.yaml"
    save_model(path, saved)
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"value: 0\.45\d*", "value: 0.45", text)
    assert old in text
    text = text.replace(old, new, 1)
    path.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput) as caught:
        load_model(path)
    sentence = str(caught.value)
    assert words in sentence
    line = re.match(rf"{re.escape(str(path))}:(\d+):\d+: ", sentence) or re.match(
        rf"{re.escape(str(path))}:", sentence
    )
    assert line
    if at != "format:":
        assert int(line[1]) == text[: text.index(at)].count("\n") + 1


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("unit: N·mm²", "unit: N·m²", "N·m² is not the unit of torsional_rigidity_nmm2: that is N·mm²"),
        (
            "unit: N·mm/rad",
            "unit: N·m/rad",
            "chuck_compliance.stiffness_nmm_per_rad.unit: N·m/rad is",
        ),
    ],
)
def test_a_unit_beside_a_value_is_no_decoration(
    saved: SavedModel, tmp_path: Path, old: str, new: str, says: str
) -> None:
    path = tmp_path / "m.yaml"
    save_model(path, saved)
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(BadInput, match=r"m\.yaml:\d+:\d+: ") as refused:
        load_model(path)
    assert says in str(refused.value)


def test_a_unit_may_be_spelt_otherwise(saved: SavedModel, tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    save_model(path, saved)
    path.write_text(path.read_text(encoding="utf-8").replace("unit: N·mm²", "unit: Nmm^2"), encoding="utf-8")
    assert load_model(path).uncertainties == saved.uncertainties


def test_a_bad_value_in_a_parameter_set(tmp_path: Path) -> None:
    text = parameter_sets()["rig_elastic"].read_text(encoding="utf-8")
    path = tmp_path / "soft.yaml"
    path.write_text(text.replace("0.278", "-1"), encoding="utf-8")
    with pytest.raises(
        BadInput, match=r"soft\.yaml:\d+:\d+: tissue_elasticity\.stiffness.*-1 .* is below 0\.02"
    ):
        load_parameters(path)


@pytest.mark.parametrize(
    ("key", "says"),
    [
        ("unsure", "unsure: unknown key"),
        ("uncertanty", r"uncertanty: unknown key; did you mean uncertainty\?"),
        ("null", "null: unknown key"),
        ("value", "is given twice"),
    ],
)
def test_a_wrong_key_of_a_fitted_value_is_told_once(key: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "model.yaml"
    model = load_parameters("rig_elastic")
    save_model(path, SavedModel(model, "rig_elastic", dict.fromkeys(model.values(), 0.1)))
    text = path.read_text(encoding="utf-8")
    before, after = text.split("effects:", 1)
    path.write_text(f"{before}effects:{after.replace('uncertainty', key, 1)}", encoding="utf-8")
    with pytest.raises(BadInput, match=says) as refused:
        load_model(path)
    assert len(str(refused.value).splitlines()) == 1
