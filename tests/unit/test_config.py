"""Mistakes in a config file: each answered with file, line, column, value, limit and a hint."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.config.loader import (
    find_config_file,
    load_rig_config,
    parse_rig_config,
    parse_yaml,
    read_yaml,
    rig_config_text,
    write_yaml,
)
from needle_rig.errors import BadInput, NeedleRigError

SHIPPED = Path(__file__).parents[2] / "config" / "rig.yaml"
TEXT = SHIPPED.read_text(encoding="utf-8")


def place(text: str, fragment: str) -> str:
    """line:column at which `fragment` begins in `text`."""
    index = text.index(fragment)
    return f"{text.count(chr(10), 0, index) + 1}:{index - text.rfind(chr(10), 0, index)}"


def complaint(text: str) -> str:
    with pytest.raises(BadInput) as caught:
        parse_rig_config(text, "rig.yaml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("rig_elastik", "there is no parameter set rig_elastik; did you mean rig_elastic?"),
        ("lost.yaml", "there is no file lost.yaml below"),
    ],
)
def test_a_needle_that_is_not_there_is_told_when_the_file_is_read(
    written: str, says: str, tmp_path: Path
) -> None:
    file = tmp_path / "rig.yaml"
    text = TEXT.replace("parameters: rig_elastic ", f"parameters: {written} ")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(BadInput, match=r"rig\.yaml:\d+:15: simulation\.parameters: ") as refused:
        load_rig_config(file)
    assert says in str(refused.value)
    assert parse_rig_config(text).simulation, "the rig inside a run is read without the file"


def test_what_check_warns_of_is_read() -> None:
    assert parse_rig_config(TEXT.replace("mm2: 62.56 ", "mm2: 31.0 ")).needle.torsional_rigidity_nmm2 == 31.0


def test_entries_apart_are_no_decimal_comma() -> None:
    data, _ = parse_yaml("a: {value: 62, 55, b: 1}\nc: [37,1, 5]\n", "f.yaml")
    assert data == {"a": {"value": 62, "55": None, "b": 1}, "c": [37, 1, 5]}


def test_the_shipped_rig_is_valid_and_survives_being_written_out() -> None:
    config = load_rig_config(SHIPPED)
    assert config.sequence.settle_s == 3.0
    assert config.layout.tissue_sections_mm[3] == (370.0, 395.0)
    assert parse_rig_config(rig_config_text(config)) == config


@pytest.mark.parametrize(
    ("old", "new", "points_at", "says"),
    [
        ("settle_s: 3.0", "settle_ms: 3000", "settle_ms", "did you mean settle_s: 3.0?"),
        ("settle_s: 3.0", "settle: 3.0", "settle: 3.0", "mean settle_s? (the unit belongs to the name)"),
        ("settle_s: 3.0", "setle_s: 3.0", "setle_s", "unknown key; did you mean settle_s?"),
        ("torque_limit_nmm: 2.0", "torque_limit_nm: 0.002", "torque_limit_nm:", "torque_limit_nmm: 2.0?"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: 5000", "5000", "5000 is above 50 N·mm; did you mean 5 "),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: -2", "-2", "-2 is not above 0 N·mm; did you mean 2?"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: 2,5", "2,5", "is text, not a number; write 2.5"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: 0.002 N·m", "0.002 N", "write 2 alone, the unit is in"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: .nan", ".nan", ".nan is not a finite number"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: .inf", ".inf", ".inf is not a finite number"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: 1e400", "1e400", "1e400 is not a finite number"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: on", "on\n\npid", "'on' is text, not a number"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: true", "true", "true stands where a number is expected"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: [2]", "[2]", "a list stands where a number is expected"),
        ("torque_limit_nmm: 2.0", "torque_limit_nmm: '2.0'", "'2.0'", "is text, not a number; write 2"),
        ("torque_age_limit_ms: 250", "torque_age_limit_ms: 0.05", "0.05", "5 ms; did you mean 50 (0.05 s)?"),
        ("seed: 1", "seed: 1.5", "1.5", "1.5 is not a whole number"),
        ("seed: 1", "seed: .inf", ".inf", "is not a whole number; write one"),
        ("seed: 1", "seed: 1\n  seed: 2", "seed: 2", "seed is given twice, first at rig.yaml:"),
        ("kind: simulated", "kind: simulatd", "simulatd", "is not one of 'simulated' or 'hardware'"),
        ("name: simulated rig", "name: 5", "5\nkind", "5 is a number, not text; put it in quotes"),
        ("[175, 200]", "[175]", "[175]", "value number 2 of the list is missing"),
        ("[175, 200]", "[175, 200, 9]", "[175, 200, 9]", "has 3 values; give 2"),
        ("[175, 200]", "[175, 250]", "[240, 265]", "overlaps [175, 250]"),
        ("[175, 200]", "[200, 175]", "[200, 175]", "ends before it starts"),
        ("[370, 395]", "[370, 399]", "[370, 399]", "leaves the needle, which runs from 0 to"),
        ("position_mm: 396", "position_mm: 398", "398", "hall_4 at 398 mm is beyond the needle's tip"),
        ("name: hall_4", "name: hall_1", "hall_1, position_mm: 396", "hall_1 is used twice"),
        ("kind: simulated", "kind: hardware", "auto, bitrate", "auto is for kind: simulated; name the port"),
        ("speed_deg_s: 45", "speed_deg_s: 61", "61", "is above drive.velocity_limit_deg_s: 60"),
        ("torque_window_s: 0.5", "torque_window_s: 5", "5\n  motion", "longer than sequence.settle_s: 3 s"),
        ("  seed: 1", "\tseed: 1", "\tseed", "a tab stands where YAML wants spaces"),
        ("name: simulated rig", "name: a: b  # c", ": b", 'needs quotes; write name: "a: b"'),
        ("  density_g_cm3", "   density_g_cm3", ": 6.45", "by 3 spaces, more than the line above, which has"),
        ("  density_g_cm3", " density_g_cm3", "density", "by 1 space, as no line above it; align it"),
        ("position_mm: 396}", "position_mm: 396,0}", "396,0", "separates entries here; write 396.0"),
        ("mm2: 62.56 ", "mm2: 6.256 ", "6.256", "6.256 N·mm² is 0.1 times the 61.8 N·mm² of 0.39 mm"),
        ("mm2: 62.56 ", "mm2: 625.6 ", "625.6", "625.6 N·mm² is 10 times the 61.8 N·mm² of 0.39 mm"),
        ("format: needle-rig/1", "format: needle-rig/2", "needle-rig/2", "format 2; needle-rig"),
        ("format: needle-rig/1", "format: needle-rig-dataset/1", "needle-rig-d", "its folder as DATA"),
        ("format: needle-rig/1", "format: 1", "1\nname", "1 is not known; a rig file (needle-rig/1) is read"),
        ("name: simulated rig", "name: *x", "*x", "text that starts with * needs quotes"),
        ("name: simulated rig", "name: !!python/name:os.system x", "!!python", "is not read here"),
        ("name: simulated rig", "<<: {a: 1}", "<<", "merge keys (<<) are not read here"),
    ],
)  # fmt: skip
def test_a_mistake_is_answered_with_place_and_hint(old: str, new: str, points_at: str, says: str) -> None:
    text = TEXT.replace(old, new)
    assert text != TEXT
    first = complaint(text).splitlines()[0]
    assert first.startswith(f"rig.yaml:{place(text, points_at)}: ")
    assert says in first


def test_every_mistake_is_told_at_once_in_the_order_of_the_file() -> None:
    text = (
        TEXT.replace("tick_hz: 200", "tick_hz: 2")
        .replace("seed: 1", "sead: 1")
        .replace("  kd: 0.0\n", "  kq: 0\n")
    )
    lines = complaint(text).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["tick_hz", "pid.kq", "simulation.sead"]


def test_a_misspelt_key_is_not_also_called_missing() -> None:
    text = TEXT.replace("diameter_mm: 0.39", "diamter_mm: 0.39")
    assert complaint(text).count("\n") == 0


def test_missing_sections_are_one_sentence() -> None:
    assert complaint("format: needle-rig/1\nname: x\nkind: hardware\n") == (
        "rig.yaml:1:1: needle, layout, links, drive, pid, sequence, recording are missing; add them"
    )


def test_a_simulated_rig_needs_its_simulation_section() -> None:
    assert "needs a section simulation" in complaint(TEXT[: TEXT.index("simulation:\n")])


def test_an_age_limit_shorter_than_two_readings_can_never_be_kept() -> None:
    slow = TEXT.replace("sensor_rate_hz: 1000", "sensor_rate_hz: 50").replace(
        "hall_age_limit_ms: 250", "hall_age_limit_ms: 30"
    )
    lines = complaint(slow).splitlines()
    assert lines == [
        f"rig.yaml:{place(slow, '30' + chr(10) + '  drive_age')}: links.hall_age_limit_ms: 30 ms is "
        "below two readings at simulation.sensor_rate_hz: 50 Hz (40 ms)"
    ]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "rig.yaml: the file is empty"),
        ("# only a comment\n", "rig.yaml: the file is empty"),
        ("[1, 2]", "rig.yaml:1:1: the file holds a list; a mapping"),
        ("hello", "rig.yaml:1:1: the file holds text; a mapping"),
        ("a: &a [*a]", "rig.yaml:1:4: a value contains itself"),
        ("a: 1\n---\nb: 2\n", "rig.yaml:2:1: a second document begins"),
        ("a: b\x07", "rig.yaml:1:5: character U+0007 may not stand in YAML"),
        ("a: " + "[" * 5000, "rig.yaml: is nested too deeply"),
        ("? [1]\n: 2\n", "rig.yaml:1:3: a key must be a plain word"),
    ],
)
def test_a_file_that_holds_no_config(text: str, says: str) -> None:
    assert complaint(text).startswith(says)


def test_aliases_that_multiply_are_refused() -> None:
    levels = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    levels += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 9)]
    assert "holds more than" in complaint("\n".join(levels))


def test_a_file_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.yaml").write_text("a: 1")
    (tmp_path / "latin.yaml").write_bytes("a: 1\nname: Nürnberg".encode("latin-1"))
    with pytest.raises(BadInput, match=r"^rog.yaml: there is no such file; \. has latin.yaml, other.yaml$"):
        read_yaml("rog.yaml")
    with pytest.raises(BadInput, match=r"^gone/rig.yaml: there is no such file; nor is there a folder gone$"):
        read_yaml("gone/rig.yaml")
    with pytest.raises(BadInput, match=r"is a folder"):
        read_yaml(tmp_path)
    with pytest.raises(BadInput, match=r"^latin.yaml:2:8: byte 0xfc is not UTF-8"):
        read_yaml(tmp_path / "latin.yaml")
    with pytest.raises(BadInput, match="cannot be read"):
        read_yaml("a\0b.yaml")
    with pytest.raises(BadInput, match="cannot be read: File name too long"):
        read_yaml("x" * 300)


def test_a_file_without_read_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_given: object) -> None:
        raise PermissionError(13, "Permission denied")

    (tmp_path / "rig.yaml").write_text("a: 1\n")
    monkeypatch.setattr("os.open", forbidden)
    with pytest.raises(BadInput, match="you may not read this file"):
        read_yaml(tmp_path / "rig.yaml")


def test_scalars_are_read_without_surprises() -> None:
    data, _ = parse_yaml(
        "a: 1e-3\nb: on\nc: yes\nd: true\ne: 010\nf: 0x1F\ng: 1:30\nh: 2026-01-01\n"
        "i: ~\nj: .5\nk: '1'\nl: 1_000\n",
        "x",
    )
    assert data == {
        "a": 1e-3, "b": "on", "c": "yes", "d": True, "e": 10, "f": 31, "g": "1:30", "h": "2026-01-01",
        "i": None, "j": 0.5, "k": "1", "l": "1_000",
    }  # fmt: skip


def test_options_replace_values_and_are_named_in_errors() -> None:
    assert load_rig_config(SHIPPED, {"sequence.settle_s": 2, "name": None}).sequence.settle_s == 2
    with pytest.raises(BadInput, match=r"^option: sequence.settle_s: nan is not a finite number"):
        load_rig_config(SHIPPED, {"sequence.settle_s": math.nan})
    with pytest.raises(BadInput, match=r"^option: sequence.speed_deg_s: 61°/s is above"):
        load_rig_config(SHIPPED, {"sequence.speed_deg_s": 61.0})


def test_the_working_folder_comes_before_what_is_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert find_config_file("rig.yaml") == SHIPPED
    own = tmp_path / "config" / "rig.yaml"
    own.parent.mkdir()
    own.write_text(TEXT.replace("settle_s: 3.0", "settle_s: 4.0"))
    assert find_config_file("rig.yaml") == own
    assert find_config_file("needle_rig.dbc") == SHIPPED.parent / "needle_rig.dbc"
    assert load_rig_config().sequence.settle_s == 4.0
    with pytest.raises(BadInput, match=r"^nothing.yaml: no such file in config and "):
        find_config_file("nothing.yaml")


# PyYAML folds these two line breaks into spaces when it writes.
characters = st.characters(
    exclude_categories=["Cs", "Cc"], exclude_characters="\u2028\u2029", include_characters="\n\t"
)
keys = st.text(characters, max_size=8).filter(lambda key: key != "<<")
numbers = st.integers(-(10**30), 10**30) | st.floats(allow_nan=False)
scalars = st.none() | st.booleans() | numbers | st.text(characters, max_size=30)
trees = st.recursive(
    scalars, lambda t: st.lists(t, max_size=4) | st.dictionaries(keys, t, max_size=4), max_leaves=20
)


@given(st.dictionaries(keys, trees, max_size=5))
def test_what_is_written_is_read_back_equal(data: dict[str, object]) -> None:
    assert parse_yaml(write_yaml(data), "x")[0] == data


@given(st.integers(0, len(TEXT)), st.integers(0, 6), st.text(max_size=6))
def test_a_damaged_file_never_gives_anything_but_a_sentence(start: int, length: int, inserted: str) -> None:
    text = TEXT[:start] + inserted + TEXT[start + length :]
    said = "rig.yaml:"
    try:
        parse_rig_config(text, "rig.yaml")
    except NeedleRigError as error:
        said = str(error)
    assert said.startswith("rig.yaml:")
