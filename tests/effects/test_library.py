"""A user's file is found by its name, and a broken one gets one sentence with file and line."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.physics.compiled import compiled_torque
from needle_rig.physics.effect_text import parse_effects
from needle_rig.physics.library import built_in_effects, find_effects
from needle_rig.physics.needle_model import NeedleModel
from tests.effects.common import LIBRARY, SHORT, USERS, make_effect

GOOD = (USERS / "slit_membrane.py").read_text()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path


def place_in(sentence: str, pattern: str = r".*?\.py:(\d+):") -> int:
    """The line that a sentence names."""
    found = re.match(pattern, sentence)
    assert found is not None
    return int(found[1])


def broken(folder: Path, text: str, name: str = "mine") -> str:
    (folder / f"{name}.py").write_text(text)
    found = find_effects([folder])
    [(called, sentence)] = found.broken
    assert called == name
    assert set(found) == set(built_in_effects())
    assert "\n" not in sentence
    assert sentence.startswith(f"{folder / name}.py:")
    return sentence


def line_of(text: str, part: str) -> int:
    return text[: text.index(part)].count("\n") + 1


def test_a_dropped_file_is_found_by_its_name(folder: Path) -> None:
    shutil.copy(USERS / "slit_membrane.py", folder / "my_membrane.py")
    found = find_effects([folder])
    assert set(found) == {*built_in_effects(), "my_membrane"}
    assert found["my_membrane"].name() == "my_membrane"


def test_a_missing_folder_is_an_empty_one(folder: Path) -> None:
    assert set(find_effects([folder / "nothing"])) == set(built_in_effects())


def test_an_edited_file_is_read_again(folder: Path) -> None:
    file = folder / "mine.py"
    file.write_text(GOOD)
    assert find_effects([folder])["mine"].parameters()["torque_nmm"].typical == 0.03
    file.write_text(GOOD.replace("typical=0.03", "typical=0.04"))
    assert find_effects([folder])["mine"].parameters()["torque_nmm"].typical == 0.04


def test_files_that_start_with_an_underscore_are_helpers(folder: Path) -> None:
    (folder / "_shared.py").write_text("1 +")
    assert set(find_effects([folder])) == set(built_in_effects())


def test_the_worked_example_acts_where_its_law_says(model: NeedleModel) -> None:
    # twice a turn, at one place: no other effect does this
    slit = make_effect("slit_membrane", torque_nmm=0.05, place_mm=315)
    assert slit.torque(np.pi / 4, 0.0, 0.0, 0.315) == pytest.approx(-0.05e-3 / 5e-3)
    assert slit.torque(np.pi / 4, 0.0, 0.0, 0.310) == 0
    assert slit.torque(np.pi / 2, 0.0, 0.0, 0.315) == pytest.approx(0, abs=1e-12)
    with_it, without = (m.predict(SHORT).hall_rad for m in (model.with_effects(slit), model))
    change_deg = np.degrees(np.abs(with_it - without)).max(axis=0)
    assert change_deg[2] > 1


def test_other_values_need_no_compilation(model: NeedleModel) -> None:
    compiled = compiled_torque(LIBRARY["slit_membrane"])
    slits = [make_effect("slit_membrane", torque_nmm=t) for t in (0.01, 0.02)]
    laws = [model.with_effects(slit).rod(SHORT).laws[0] for slit in slits]
    assert laws[0].law is laws[1].law is compiled
    assert laws[0].parameters[0] != laws[1].parameters[0]


@pytest.mark.parametrize(
    ("law", "steady"),
    [("2.0 * angle_rad", True), ("rate_rad_s", False), ("angle_rad + time_s", False)],
)
def test_a_law_is_steady_unless_it_reads_rate_or_time(
    model: NeedleModel, folder: Path, law: str, steady: bool
) -> None:
    assert "2.0 * angle_rad" in GOOD
    (folder / "mine.py").write_text(GOOD.replace("2.0 * angle_rad", law))
    mine = find_effects([folder])["mine"].at_strength(1.0)
    assert model.with_effects(mine).rod(SHORT).laws[0].steady is steady


def test_taking_the_name_of_a_built_in_effect(folder: Path) -> None:
    sentence = broken(folder, GOOD, "tip_friction")
    assert "the name tip_friction is taken by a built-in effect; rename the file" in sentence


def test_the_same_name_in_two_folders(folder: Path) -> None:
    for name in ("a", "b"):
        (folder / name).mkdir()
        (folder / name / "mine.py").write_text(GOOD)
    [(_, sentence)] = find_effects([folder / "a", folder / "b"]).broken
    assert re.search(r"b/mine\.py:1: the name mine is taken by .*a/mine\.py", sentence)


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("import math\n", "import math math\n", "import math", "invalid syntax"),
        ("import math\n", "import no_such_thing\n", "import math", "No module named 'no_such_thing'"),
        ("THICKNESS_M = 5e-3", "THICKNESS_M = 1 / 0", "THICKNESS_M = 5e-3", "ZeroDivisionError"),
        ("@dataclass(frozen=True)", "@dataclass", "@dataclass(", "is not a frozen dataclass"),
        ("@dataclass(frozen=True)\n", "", "@dataclass(", "is not a frozen dataclass"),
        ('        unit="N·mm",\n', "", "torque_nmm: float = parameter(", "unit"),
        (
            "lower=0.0,\n        upper=0.5",
            "lower=1.0,\n        upper=0.5",
            "@dataclass(",
            "lower 1 is not below",
        ),
        ("typical=0.03", "relative=True, typical=0.03", "@dataclass(", "relative is for factors"),
        ("typical=0.03", "typical=0.9", "@dataclass(", "typical 0.9 is outside 0 to 0.5"),
        (
            "def torque(self, angle_rad",
            "def torque(self, theta",
            "    def torque(",
            "torque must be def torque(self,",
        ),
        ("def torque(", "def twist(", "@dataclass(", "none of the hooks shape, torque, drive, observe"),
        ("torque_nmm: float", "torque_Nm: float", "@dataclass(", "its unit is N·mm, which its name does not"),
        ("torque_nmm: float", "torque_Nm: float", "@dataclass(", "call it torque_nmm"),
        ('unit="N·mm"', 'unit="1"', "@dataclass(", "torque_nmm: its unit is 1, which its name does not say"),
        ("Source:", "Seen in:", "", 'no "Source:"'),
        ("Law:", "Rule:", "", 'no "Law:"'),
        ("(Effect)", "(object)", "", "0 classes derive from Effect"),
    ],
)
def test_a_broken_file_is_named_with_its_line(
    folder: Path, old: str, new: str, line: str, words: str
) -> None:
    assert old in GOOD
    sentence = broken(folder, GOOD.replace(old, new, 1))
    assert words in sentence
    assert place_in(sentence) == (line_of(GOOD, line) if line else 1)


def test_two_effects_in_one_file(folder: Path) -> None:
    second = GOOD[GOOD.index("@dataclass") :].replace("class SlitMembrane", "class Another")
    assert "2 classes derive from Effect" in broken(folder, GOOD + "\n\n" + second)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("return self.thickness * angle_rad", "thickness"),
        ("return float(open('x').read())", "open"),
        ("return nothing_known(angle_rad)", "nothing_known"),
        ("return 'a torque'", "cannot be compiled"),
        ("return [angle_rad]", "it does not return a number"),
        ("if angle_rad > 0: return 1.0", "it does not return a number in every case"),
        ("return math.sinn(angle_rad)", "module 'math' has no attribute 'sinn'"),
    ],
)
def test_a_torque_that_cannot_be_compiled_is_named_with_its_line(
    folder: Path, model: NeedleModel, law: str, words: str
) -> None:
    text = GOOD[: GOOD.index("        if abs(position_m")] + f"        {law}\n"
    (folder / "mine.py").write_text(text)
    effect = find_effects([folder])["mine"].at_strength(1.0)
    with pytest.raises(BadInput) as caught:
        model.with_effects(effect).rod(SHORT)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert words in sentence
    line = place_in(sentence, rf"{re.escape(str(folder))}/mine\.py:(\d+): torque of mine cannot")
    assert line in (line_of(text, law), line_of(text, "    def torque("))


def test_a_torque_with_a_value_per_sensor_is_refused(folder: Path, model: NeedleModel) -> None:
    (folder / "mine.py").write_text(GOOD.replace('unit="N·mm",', 'unit="N·mm",\n        per="sensor",'))
    with pytest.raises(BadInput, match="torque_nmm has one value per sensor; the torque hook takes single"):
        model.with_effects(find_effects([folder])["mine"].at_strength(1.0)).rod(SHORT)


@pytest.mark.parametrize(
    ("texts", "values"),
    [
        (["tissue_elasticity=0.35"], {"stiffness_nmm_per_rad_per_100mm": 0.35}),
        (["tissue_elasticity"], {"stiffness_nmm_per_rad_per_100mm": 0.35}),
        (["tissue_elasticity=inf"], {"stiffness_nmm_per_rad_per_100mm": float("inf")}),
        (["stribeck=0.4,10"], {"static_excess": 0.4, "rate_deg_s": 10, "weakening_deg": 8}),
        (["stribeck=0.4", "stribeck:weakening_deg=2"], {"static_excess": 0.4, "weakening_deg": 2}),
        (["layered_friction=0.3,0.8,1.3,1.6"], {"factor": (0.3, 0.8, 1.3, 1.6)}),
        (["hall_offset=2"], {"offset_deg": 2}),
        (["hall_eccentricity:cosine_deg=1,2,3,4"], {"sine_deg": 0, "cosine_deg": (1, 2, 3, 4)}),
    ],
)
def test_effects_as_written_on_a_command_line(texts: list[str], values: dict[str, object]) -> None:
    (effect,) = parse_effects(texts, LIBRARY)
    assert {name: getattr(effect, name) for name in values} == values


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("tisue_elasticity=1", "there is no effect tisue_elasticity; did you mean tissue_elasticity?"),
        ("tip_friction=much", "'much' is not a number"),
        ("tip_friction=", "'' is not a number"),
        ("tip_friction=1,2", "2 values for 1"),
        (
            "tip_friction=0,35",
            "2 values for 1 field(s) (torque_nmm); a comma separates entries here; write 0.35",
        ),
        ("tip_friction:size=1", "has no size; it has torque_nmm"),
        ("tip_friction:torque_nmm", "torque_nmm has no value"),
        ("tip_friction=-0.1", "-0.1 N·mm is below 0; allowed are 0 to 1, and 0 for none"),
        ("chuck_backlash=nan", "nan is not a number"),
    ],
)
def test_what_cannot_be_understood_on_a_command_line(text: str, words: str) -> None:
    with pytest.raises(BadInput, match=re.escape(words)):
        parse_effects([text], LIBRARY)
