import math
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.dataset import denoised_base, read_dataset, write_dataset
from needle_rig.dataset.channels import unwrapped
from needle_rig.dataset.table import read_table
from needle_rig.errors import BadInput

PRACTICE = Path(__file__).parents[1] / "data" / "practice"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A dataset of two trials to spoil: a compensation and a staircase."""
    target = tmp_path / "set"
    (target / "trials").mkdir(parents=True)
    text = (PRACTICE / "none" / "dataset.yaml").read_text()
    head, trials = text.split("trials:\n", 1)
    parts = ["- " + p for p in trials.split("- file:") if p.strip()]
    parts = ["- file:" + p.removeprefix("- ") for p in parts]
    (target / "dataset.yaml").write_text(head + "trials:\n" + parts[0] + parts[6])
    for name in ("01.csv", "07.csv"):
        shutil.copy(PRACTICE / "none" / "trials" / name, target / "trials" / name)
    return target


def rows(folder: Path) -> list[list[str]]:
    return [line.split(",") for line in (folder / "trials/01.csv").read_text().splitlines()]


def save(folder: Path, table: list[list[str]], separator: str = ",") -> None:
    (folder / "trials/01.csv").write_text("\n".join(separator.join(r) for r in table) + "\n")


def refused(folder: Path) -> str:
    with pytest.raises(BadInput) as caught:
        read_dataset(folder)
    return str(caught.value)


def test_practice_datasets_are_read_whole_and_in_si() -> None:
    for name in ("none", "elastic", "layers", "backlash", "bias", "two"):
        dataset = read_dataset(PRACTICE / name)
        assert dataset.name == name
        assert len(dataset.trials) == 8
        assert dataset.notes == ()
        assert len(dataset.layout.tissue_sections_m) == 4
        assert dataset.needle.torsional_rigidity_nm2 == pytest.approx(61.78e-6, rel=1e-3)
        assert dataset.needle.rigidity_sigma == 0.02
        for trial in dataset.trials:
            assert trial.torque_ok.all()
            assert trial.hall_ok.all()
            assert math.degrees(trial.base_residual_rad) < 0.022
        three = [places for places in dataset.replicates.values() if len(places) > 1]
        assert three == [(0, 1, 7)]


def test_numbers_are_those_of_the_file(folder: Path) -> None:
    trial = read_dataset(folder).trials[0]
    table = np.array([r[:-1] for r in rows(folder)[1:]], dtype=float)
    assert np.array_equal(trial.trial.time_s, table[:, 0])
    np.testing.assert_allclose(np.degrees(trial.base_measured_rad), table[:, 1], rtol=0, atol=1e-12)
    np.testing.assert_allclose(trial.torque_nm * 1e3, table[:, 2], rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.degrees(trial.hall_rad), table[:, 3:], rtol=0, atol=1e-12)
    assert trial.phase.tolist() == [r[-1] for r in rows(folder)[1:]]


def test_writing_and_reading_gives_the_same(tmp_path: Path) -> None:
    dataset = read_dataset(PRACTICE / "two")
    again = read_dataset(write_dataset(dataset, tmp_path / "copy"))
    assert again.layout == dataset.layout
    assert again.needle == dataset.needle
    for a, b in zip(dataset.trials, again.trials, strict=True):
        assert a.command == b.command
        np.testing.assert_allclose(a.base_measured_rad, b.base_measured_rad, atol=1e-6)
        np.testing.assert_allclose(a.torque_nm, b.torque_nm, atol=1e-9)
        np.testing.assert_allclose(a.hall_rad, b.hall_rad, atol=1e-6)
        assert (a.phase == b.phase).all()
    with pytest.raises(BadInput, match="holds a dataset already"):
        write_dataset(dataset, tmp_path / "copy")


def test_a_trial_is_read_in_50_ms() -> None:
    read_dataset(PRACTICE / "none")
    costs = []
    for _ in range(5):
        before = time.process_time()
        read_dataset(PRACTICE / "elastic")
        costs.append((time.process_time() - before) / 8)
    assert min(costs) < 0.05


def test_order_of_the_file_does_not_matter(folder: Path) -> None:
    text = (folder / "dataset.yaml").read_text()
    head, first, second = text.split("- file:")
    (folder / "dataset.yaml").write_text(head + "- file:" + second.rstrip() + "\n- file:" + first)
    dataset = read_dataset(folder)
    assert [t.command.kind for t in dataset.trials] == ["compensate", "staircase"]
    assert [t.trial.index for t in dataset.trials] == [0, 1]
    assert math.degrees(dataset.trials[1].trial.travel_before_rad) == pytest.approx(162.5, abs=1.0)


def test_several_folders_are_one_series() -> None:
    both = read_dataset([PRACTICE / "none", PRACTICE / "elastic"])
    assert len(both.trials) == 16
    assert len(both.replicates[both.trials[0].command]) == 6
    assert any("clock" in note for note in both.notes)


# What can be wrong with a file: refused with its line …


def test_missing_base_column(folder: Path) -> None:
    table = rows(folder)
    table[0][1] = "base_angel_deg"
    save(folder, table)
    message = refused(folder)
    assert "01.csv:1:" in message
    assert "base_angle_deg is missing; did you mean base_angel_deg?" in message


def test_text_in_a_number(folder: Path) -> None:
    table = rows(folder)
    table[41][3] = "1.2.3"
    save(folder, table)
    assert "01.csv:42: hall_1_deg: '1.2.3' is no number" in refused(folder)


def test_short_and_long_rows(folder: Path) -> None:
    table = rows(folder)
    table[10] = table[10][:4]
    save(folder, table)
    assert "01.csv:11: 4 fields where the header has 8" in refused(folder)
    table = rows(folder)
    table[10] = [*table[9], "1"]
    save(folder, table)
    assert "01.csv:11: more fields than the header's 8" in refused(folder)


def test_time_going_back(folder: Path) -> None:
    table = rows(folder)
    table[300], table[301] = table[301], table[300]
    save(folder, table)
    message = refused(folder)
    assert "01.csv:302: time goes back from 6 to 5.98" in message


@pytest.mark.parametrize(
    ("column", "factor", "words"),
    [
        (1, math.pi / 180, "base_angle_deg reaches 1.3 where dataset.yaml has a target of 45°"),
        (3, math.pi / 180, "hall_1_deg follows the base with 1/"),
        (6, math.pi / 180, "hall_4_deg follows the base with 1/"),
        (2, 1e-3, "looks like N·m"),
        (2, 1e3, "looks like µN·m"),
        (0, 1e3, "looks like milliseconds"),
    ],
)
def test_wrong_units(folder: Path, column: int, factor: float, words: str) -> None:
    table = rows(folder)
    for row in table[1:]:
        row[column] = f"{float(row[column]) * factor:.7f}"
    save(folder, table)
    message = refused(folder)
    assert "01.csv:1:" in message
    assert words in message


def test_a_column_whose_name_says_another_unit_than_its_values_have(folder: Path) -> None:
    table = rows(folder)
    table[0][2] = "base_torque_nm"
    save(folder, table)
    message = refused(folder)
    assert "01.csv:1: base_torque_nm spans 0.2" in message
    assert "N·m where the twist" in message
    assert "it looks like N·mm; convert it, or call the column base_torque_nmm" in message


@pytest.mark.parametrize(
    ("column", "name", "factor"),
    [
        (1, "base_angle_rad", math.pi / 180),
        (2, "base_torque_nm", 1e-3),
        (0, "time_ms", 1e3),
        (3, "hall_1_rad", math.pi / 180),
    ],
)
def test_units_in_the_name_are_converted(folder: Path, column: int, name: str, factor: float) -> None:
    as_given = read_dataset(folder).trials[0]
    table = rows(folder)
    table[0][column] = name
    for row in table[1:]:
        row[column] = f"{float(row[column]) * factor:.9f}"
    save(folder, table)
    trial = read_dataset(folder).trials[0]
    np.testing.assert_allclose(trial.trial.time_s, as_given.trial.time_s, atol=1e-9)
    np.testing.assert_allclose(trial.trial.base_angle_rad, as_given.trial.base_angle_rad, atol=2e-8)
    np.testing.assert_allclose(trial.torque_nm, as_given.torque_nm, atol=2e-9)
    np.testing.assert_allclose(trial.hall_rad, as_given.hall_rad, atol=2e-8)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "format: needle-rig-dataset/1",
            "format: needle-rig-model/1",
            "this is a model file",
        ),
        (
            "format: needle-rig-dataset/1",
            "format: other/2",
            "'other/2' is not known; a dataset",
        ),
        ("diameter_mm: 0.39", "diameter_mm: -0.39", "-0.39"),
        ("- - 175.0\n    - 200.0", "- - 200.0\n    - 175.0", "not after its start"),
        ("- - 240.0", "- - 190.0", "before 200 mm"),
        ("position_mm: 396.0", "position_mm: 400.0", "beyond the needle"),
        ("name: hall_2", "name: hall_1", "two sensors are called hall_1"),
        ("file: trials/07.csv", "file: trials/01.csv", "is listed twice"),
        ("file: trials/07.csv", "file: trials/77.csv", "there is no such file"),
    ],
)
def test_descriptions_that_cannot_be(folder: Path, old: str, new: str, words: str) -> None:
    text = (folder / "dataset.yaml").read_text()
    assert old in text
    (folder / "dataset.yaml").write_text(text.replace(old, new))
    assert words in refused(folder)


def test_no_dataset_there(tmp_path: Path) -> None:
    assert "no such folder" in refused(tmp_path / "nowhere")
    assert "did you mean" in refused(PRACTICE)


# … or handled, and said.


def notes_of(folder: Path) -> str:
    dataset = read_dataset(folder)
    return "\n".join(dataset.notes)


def test_nan_runs_are_masked_and_said(folder: Path) -> None:
    table = rows(folder)
    for row in table[101:131]:
        row[5] = "nan"
    for row in table[401:406]:
        row[2] = ""
    save(folder, table)
    dataset = read_dataset(folder)
    trial = dataset.trials[0]
    assert trial.hall_ok[:, 2].sum() == len(table) - 1 - 30
    assert trial.torque_ok.sum() == len(table) - 1 - 5
    assert "01.csv:102: hall_3 is missing in 30 samples; not compared" in "\n".join(dataset.notes)
    assert "01.csv:402: base_torque is missing in 5 samples" in "\n".join(dataset.notes)


def test_a_row_may_begin_and_end_with_nothing(folder: Path) -> None:
    """Whole columns of empty fields are read as fast as numbers."""
    path = folder / "trials/01.csv"
    head, *lines = path.read_text(encoding="utf-8").splitlines()
    names = head.split(",")
    order = [*range(2, len(names)), 0, 1]
    turned = [[row[k] for k in order] for row in (line.split(",") for line in lines)]
    for row in turned[50:60]:
        row[0], row[1], row[2] = "", "", ""
    text = "\n".join(",".join(row) for row in ([names[k] for k in order], *turned))
    before = read_dataset(folder).trials[0]
    path.write_text(text + "\n", encoding="utf-8")
    after = read_dataset(folder).trials[0]
    assert np.array_equal(np.flatnonzero(~after.torque_ok & before.torque_ok), np.arange(50, 60))
    known = np.isfinite(after.hall_rad)
    assert np.array_equal(after.hall_rad[known], before.hall_rad[known])
    assert np.count_nonzero(~known) == 20


def test_a_channel_that_is_read_more_slowly_is_no_gap(folder: Path) -> None:
    table = rows(folder)
    for k, row in enumerate(table[1:]):
        if k % 5:
            row[4] = ""
    save(folder, table)
    assert "hall_2 has a reading in one of 5 samples: compared where it was read" in notes_of(folder)


def test_a_short_gap_of_the_encoder_is_filled(folder: Path) -> None:
    before = read_dataset(folder).trials[0].trial.base_angle_rad
    table = rows(folder)
    for row in table[160:190]:  # during the first hold
        row[1] = "NaN"
    save(folder, table)
    trial = read_dataset(folder).trials[0]
    assert np.degrees(np.abs(trial.trial.base_angle_rad - before)).max() < 0.05
    assert "filled along a straight line" in notes_of(folder)


def test_after_a_blind_turn_nothing_is_compared(folder: Path) -> None:
    table = rows(folder)
    for row in table[226:266]:  # 0.8 s across the second motion
        row[1] = ""
    save(folder, table)
    trial = read_dataset(folder).trials[0]
    assert len(trial.trial.time_s) == 225
    assert "without the encoder; the 730 samples after it are not used" in notes_of(folder)


def test_missing_hall_column_is_masked_and_said(folder: Path) -> None:
    save(folder, [[*r[:4], *r[5:]] for r in rows(folder)])
    dataset = read_dataset(folder)
    assert not dataset.trials[0].hall_ok[:, 1].any()
    assert dataset.trials[1].hall_ok.all()
    assert "01.csv:1: column hall_2_deg is missing" in "\n".join(dataset.notes)


def test_an_empty_column_is_said_whatever_another_note_names(folder: Path) -> None:
    table = rows(folder)
    column = table[0].index("hall_2_deg")
    for row in table[1:]:
        row[column] = ""
        row.append("1")
    table[0].append("hall_2_raw_deg")
    save(folder, table)
    said = notes_of(folder)
    assert "no sensor of the dataset has this name: hall_2_raw" in said
    assert "hall_2 is missing in every sample; nothing is compared in this channel" in said


def test_wrapped_angles(folder: Path) -> None:
    expected = read_dataset(folder).trials[0].hall_rad
    table = rows(folder)
    for row in table[1:]:
        row[4] = f"{(float(row[4]) + 340) % 360 - 340:.3f}"
    save(folder, table)
    np.testing.assert_allclose(read_dataset(folder).trials[0].hall_rad, expected, atol=1e-5)
    assert "hall_2 wraps by a whole turn; unwrapped" in notes_of(folder)


def test_a_dead_sensor(folder: Path) -> None:
    table = rows(folder)
    for row in table[1:]:
        row[6] = "3.25"
    save(folder, table)
    dataset = read_dataset(folder)
    assert not dataset.trials[0].hall_ok[:, 3].any()
    assert "hall_4 never changes: a dead sensor" in "\n".join(dataset.notes)


def test_a_sensor_that_dies_on_the_way(folder: Path) -> None:
    table = rows(folder)
    for row in table[501:]:
        row[6] = table[500][6]
    save(folder, table)
    dataset = read_dataset(folder)
    assert dataset.trials[0].hall_ok[:, 3].sum() == 499
    assert "01.csv:501: hall_4 repeats one value" in "\n".join(dataset.notes)


def test_a_coarse_sensor_is_not_dead(folder: Path) -> None:
    table = rows(folder)
    for row in table[1:]:
        row[6] = f"{round(float(row[6]) / 0.7) * 0.7:.3f}"
    save(folder, table)
    dataset = read_dataset(folder)
    assert dataset.trials[0].hall_ok.all()


def test_not_at_rest_at_the_start(folder: Path) -> None:
    table = rows(folder)
    save(folder, [table[0], *table[60:]])
    dataset = read_dataset(folder)
    assert [t.command.kind for t in dataset.trials] == ["staircase"]
    assert "01.csv:2: left out: the base already turns at" in dataset.notes[0]


def _moved(tmp_path: Path, columns: dict[int, float]) -> Path:
    """A copy of a dataset whose fourth trial has numbers added to columns."""
    shutil.copytree(PRACTICE / "none", tmp_path / "set")
    file = tmp_path / "set" / "trials" / "04.csv"
    table = [line.split(",") for line in file.read_text().splitlines()]
    for row in table[1:]:
        for column, added in columns.items():
            row[column] = f"{float(row[column]) + added:.3f}"
    file.write_text("\n".join(",".join(r) for r in table))
    return tmp_path / "set"


def test_one_angle_that_begins_elsewhere_is_a_sensor_that_moved(tmp_path: Path) -> None:
    dataset = read_dataset(_moved(tmp_path, {6: -12.0}))
    assert len(dataset.trials) == 7
    assert "04.csv:2: left out: hall_4 begins at -11.9°, others at" in dataset.notes[0]
    assert "`start: wound`" in dataset.notes[0]


def test_two_angles_that_begin_elsewhere_are_a_wound_start(tmp_path: Path) -> None:
    dataset = read_dataset(_moved(tmp_path, {5: -9.0, 6: -12.0}))
    assert [t.start for t in dataset.trials] == [*["relaxed"] * 3, "wound", *["relaxed"] * 4]
    assert "04.csv:2: hall_4 begins at -11.9°, others at" in dataset.notes[0]
    assert "taken as a wound start" in dataset.notes[0]


def test_a_torque_that_begins_elsewhere_is_a_wound_start(tmp_path: Path) -> None:
    dataset = read_dataset(_moved(tmp_path, {2: 0.08}))
    assert dataset.trials[3].start == "wound"
    assert "the torque starts at 0.08" in dataset.notes[0]


def test_an_unknown_twist_and_the_turns_that_made_it_are_refused_together(tmp_path: Path) -> None:
    shutil.copytree(PRACTICE / "none", tmp_path / "set")
    file = tmp_path / "set" / "dataset.yaml"
    told = yaml.safe_load(file.read_text())
    told["trials"][2] |= {"start": "wound", "turns_before_deg": [70.0, -20.0]}
    file.write_text(yaml.safe_dump(told))
    with pytest.raises(
        BadInput, match="start wound is an unknown twist, and turns_before_deg tells it; keep"
    ):
        read_dataset(tmp_path / "set")


@pytest.mark.parametrize("came_s", [[3.0], [3.0, 5.0], [3.0, 3.0]])
def test_times_that_do_not_fit_their_turns_are_refused(tmp_path: Path, came_s: list[float]) -> None:
    shutil.copytree(PRACTICE / "none", tmp_path / "set")
    file = tmp_path / "set" / "dataset.yaml"
    told = yaml.safe_load(file.read_text())
    told["trials"][2] |= {"turns_before_deg": [70.0, -20.0], "turns_before_s": came_s}
    file.write_text(yaml.safe_dump(told))
    with pytest.raises(BadInput, match=r"turns_before_s is how long before .*; give 2 falling numbers"):
        read_dataset(tmp_path / "set")
    told["trials"][2]["turns_before_s"] = [3.0, 0.0]
    file.write_text(yaml.safe_dump(told))
    with pytest.raises(BadInput, match="turns_before_s"):
        read_dataset(tmp_path / "set")
    told["trials"][2]["turns_before_s"] = [5.0, 3.0]
    file.write_text(yaml.safe_dump(told))
    assert read_dataset(tmp_path / "set").trials[2].turns_before_s == (5.0, 3.0)


def test_a_declared_start_is_kept_wherever_the_base_stands_and_written_again(tmp_path: Path) -> None:
    shutil.copytree(PRACTICE / "none", tmp_path / "set")
    file = tmp_path / "set" / "trials" / "01.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([lines[0], *lines[100:]]))
    described = tmp_path / "set" / "dataset.yaml"
    assert len(read_dataset(tmp_path / "set").trials) == 7
    told = "file: trials/01.csv\n"
    text = described.read_text()
    assert told in text
    described.write_text(text.replace(told, f"{told}  start: zeroed\n"))
    dataset = read_dataset(tmp_path / "set")
    assert [t.start for t in dataset.trials] == ["zeroed", *["relaxed"] * 7]
    again = read_dataset(write_dataset(dataset, tmp_path / "again"))
    assert [t.start for t in again.trials] == ["zeroed", *["relaxed"] * 7]


def test_three_samples(folder: Path) -> None:
    save(folder, rows(folder)[:4])
    dataset = read_dataset(folder)
    assert len(dataset.trials) == 1
    assert "01.csv:4: left out: 3 samples" in dataset.notes[0]
    (folder / "trials/07.csv").write_text("\n".join((folder / "trials/07.csv").read_text().splitlines()[:4]))
    assert "no trial is left that can be used" in refused(folder)


def test_byte_order_mark_semicolons_and_decimal_comma(folder: Path) -> None:
    expected = read_dataset(folder).trials[0]
    text = (folder / "trials/01.csv").read_text().replace(",", ";").replace(".", ",")
    (folder / "trials/01.csv").write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    dataset = read_dataset(folder)
    assert np.array_equal(dataset.trials[0].torque_nm, expected.torque_nm)
    assert dataset.trials[0].phase.tolist() == expected.phase.tolist()
    assert "byte order mark" in dataset.notes[0]
    assert "semicolons between columns and a decimal comma" in dataset.notes[1]


def test_utf16_from_a_spreadsheet(folder: Path) -> None:
    expected = read_dataset(folder).trials[0]
    text = (folder / "trials/01.csv").read_text().replace(",", "\t")
    (folder / "trials/01.csv").write_text(text, encoding="utf-16")
    dataset = read_dataset(folder)
    assert np.array_equal(dataset.trials[0].hall_rad, expected.hall_rad)
    assert "UTF-16" in dataset.notes[0]


def test_a_truncated_file_loses_its_last_row_only(folder: Path) -> None:
    whole = (folder / "trials/01.csv").read_text()
    (folder / "trials/01.csv").write_text(whole[:-20])
    dataset = read_dataset(folder)
    assert len(dataset.trials[0].trial.time_s) == len(whole.splitlines()) - 2
    assert "01.csv:956: the file ends in the middle of this row; it is left out" in "\n".join(dataset.notes)


def test_repeated_times_are_said(folder: Path) -> None:
    table = rows(folder)
    table.insert(100, table[99])
    save(folder, table)
    assert "01.csv:101: 1 rows repeat the time before them; left out" in notes_of(folder)


def test_missing_phases_are_told_from_the_motion(folder: Path) -> None:
    expected = read_dataset(folder).trials[0].phase
    save(folder, [r[:-1] for r in rows(folder)])
    dataset = read_dataset(folder)
    assert "no column `phase`" in "\n".join(dataset.notes)
    assert np.mean(dataset.trials[0].phase == expected) > 0.97
    assert list(dict.fromkeys(dataset.trials[1].phase.tolist())) == [
        "rest",
        *(f"step_{k}" for k in range(1, 12)),
    ]


def test_unknown_keys_are_said(folder: Path) -> None:
    text = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(text.replace("name: none", "name: none\noperator: me", 1))
    assert "operator: not used" in notes_of(folder)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "target_deg: 45",
            "target_rad: 1.5",
            "target_rad: only tells its command from others",
        ),
        ("target_deg: 45", "target_rad: 1.5", "did you mean target_deg: 85.9437?"),
        ("position_mm: 220.0", "position_mm: 220.0\n    serial: 7", "serial: not used"),
        ("kind: staircase", "kind: stairs", "kind stairs makes another command than compensate, staircase"),
        ("kind: staircase", "kind: stairs", "did you mean staircase?"),
    ],
)
def test_what_a_trial_says_and_nobody_reads_is_said(folder: Path, old: str, new: str, says: str) -> None:
    text = (folder / "dataset.yaml").read_text()
    assert old in text
    (folder / "dataset.yaml").write_text(text.replace(old, new, 1))
    assert says in notes_of(folder)


def test_the_kind_of_another_strategy_is_no_mistake(folder: Path) -> None:
    text = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(text.replace("kind: staircase", "kind: halves", 1))
    assert "halves" not in notes_of(folder)


def test_stated_uncertainty(folder: Path) -> None:
    text = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(
        text.replace("density_g_cm3: 6.45", "density_g_cm3: 6.45\n    uncertainty_percent: 0.5")
    )
    assert read_dataset(folder).needle.rigidity_sigma == 0.005


@pytest.mark.whole
def test_a_long_file_is_thinned_and_said(folder: Path) -> None:
    """A tenth of the 10⁷ samples that must pass; the same chunks serve both."""
    table = rows(folder)
    count = 1_000_000
    base = np.array([[float(x) for x in r[:-1]] for r in table[1:]])
    time_s = np.linspace(0, base[-1, 0], count)
    columns = [np.interp(time_s, base[:, 0], base[:, k]) for k in range(1, 7)]
    phase = np.array([r[-1] for r in table[1:]])[np.searchsorted(base[:, 0], time_s, "right") - 1]
    with (folder / "trials/01.csv").open("w") as file:
        file.write(",".join(table[0]) + "\n")
        for start in range(0, count, 50_000):
            part = slice(start, start + 50_000)
            block = zip(
                time_s[part].tolist(), *(c[part].tolist() for c in columns), phase[part].tolist(), strict=True
            )
            file.writelines(
                f"{r[0]:.7f}," + ",".join(f"{v:.5f}" for v in r[1:-1]) + f",{r[-1]}\n" for r in block
            )
    before = time.process_time()
    dataset = read_dataset(folder)
    assert time.process_time() - before < 5.0
    trial = dataset.trials[0]
    assert 10_000 < len(trial.trial.time_s) <= 21_000
    assert "one in " in dataset.notes[0]
    assert (
        np.degrees(
            np.abs(
                np.interp(base[:, 0], trial.trial.time_s, trial.trial.base_angle_rad) - np.radians(base[:, 1])
            )
        ).max()
        < 0.15
    )


@pytest.mark.parametrize("row", [60_001, 60_002])
def test_rows_of_a_long_file_that_are_not_used_are_whole_and_in_order(folder: Path, row: int) -> None:
    header, first = rows(folder)[:2]
    table = [header, *([f"{n * 1e-3:.3f}", *first[1:]] for n in range(100_000))]
    save(folder, [*table[:row], table[row][:4], *table[row + 1 :]])
    assert f"01.csv:{row + 1}: 4 fields where the header has 8" in refused(folder)
    save(folder, [*table[:row], table[row - 2], *table[row + 1 :]])
    assert f"01.csv:{row + 1}: time goes back from" in refused(folder)


@pytest.mark.parametrize("separator", [",", ";"])
def test_numbers_are_exact_to_the_last_bit(folder: Path, separator: str) -> None:
    table = rows(folder)
    numbers = [
        "0.1",
        "1e-5",
        "9007199254740993",
        "0.30000000000000004441",
        "123456789.123456789e-7",
        "-.5",
        "5.",
    ]
    draws = np.random.default_rng(1).normal(size=len(table)).tolist()
    for row, draw in zip(table[1:], draws, strict=False):
        row[6] = f"{draw:.20f}"
    for row, text in zip(table[10:], numbers, strict=False):
        row[6] = text
    expected = [float(row[6]) for row in table[1:]]
    for row in table if separator == ";" else []:
        row[:] = [field.replace(".", ",") for field in row]
    trial = folder / "trials/01.csv"
    save(folder, table, separator)
    assert read_table(trial, folder, "", "phase", "time").values[:, 6].tolist() == expected
    table[20][6] = f'"{table[20][6]}"'  # field by field
    save(folder, table, separator)
    assert read_table(trial, folder, "", "phase", "time").values[:, 6].tolist() == expected


@pytest.mark.parametrize("word", ["", '""', "-", "nan", "NaN", "-nan", "NA", "n/a", "null", "None", " "])
def test_a_field_that_says_that_there_is_no_value(folder: Path, word: str) -> None:
    table = rows(folder)
    table[41][3] = word
    save(folder, table)
    values = read_table(folder / "trials/01.csv", folder, "", "phase", "time").values
    assert np.argwhere(np.isnan(values)).tolist() == [[40, 3]]


@pytest.mark.parametrize(
    "word", ["inf", "-Infinity", "1e999", "1_0", "0x10", "1,5", "+", "nothing", "１", "1 2"]
)
def test_what_is_no_number(folder: Path, word: str) -> None:
    table = rows(folder)
    table[41][3] = word
    save(folder, table, ";")
    assert f"01.csv:42: hall_1_deg: '{word}' is no number" in refused(folder)
    table[41][3], table[41][0] = table[40][3], word
    save(folder, table, ";")
    assert f"01.csv:42: time_s: '{word}' is no number" in refused(folder)


def test_a_header_without_end_has_no_rows(folder: Path) -> None:
    (folder / "trials/01.csv").write_text("time_s," + "a" * 100_000 + "\n1,2\n")
    assert "01.csv:1: no rows below the header" in refused(folder)


# The base's path without the encoder's noise.


def driven(
    targets_deg: list[float], speed_deg_s: float, settle_s: float, step_s: float, lag_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """A base that ramps to each target through a first-order lag, and holds."""
    fine = 1e-3
    path, here, value = [0.0] * round(0.5 / fine), 0.0, 0.0
    for target in targets_deg:
        ramp = abs(target - here) / speed_deg_s
        for k in range(round((ramp + settle_s) / fine)):
            told = here + math.copysign(min(abs(target - here), speed_deg_s * k * fine), target - here)
            value += fine * (told - value) / lag_s
            path.append(value)
        here = target
    every = round(step_s / fine)
    clean = np.radians(np.array(path)[::every])
    return np.arange(len(clean)) * step_s, clean


def reversals(path: np.ndarray) -> int:
    moves = np.sign(np.diff(path))
    moves = moves[moves != 0]
    return int(np.count_nonzero(moves[1:] != moves[:-1]))


@given(
    st.lists(st.integers(-9, 9).map(lambda k: 10.0 * k), min_size=1, max_size=5),
    st.sampled_from([10.0, 30.0, 60.0, 90.0]),
    st.sampled_from([0.6, 1.5, 3.0]),
    st.sampled_from([0.005, 0.02]),
    st.integers(0, 2**31),
)
def test_noise_makes_no_reversal(
    targets: list[float], speed: float, settle: float, step: float, seed: int
) -> None:
    time_s, clean = driven(targets, speed, settle, step, 0.1)
    noise = math.radians(0.02)
    measured = clean + noise * np.random.default_rng(seed).standard_normal(len(clean))
    path = denoised_base(time_s, measured)
    assert reversals(path.angle_rad) == reversals(np.round(clean, 6))
    assert np.degrees(np.abs(path.angle_rad - clean)).max() < 0.12
    drawn = float(np.sqrt(np.mean((measured - clean) ** 2)))
    assert path.residual_rad < 1.15 * drawn
    if len(clean) > 300:
        assert path.noise_rad == pytest.approx(drawn, rel=0.3)


def test_a_clean_path_stays_as_it_is() -> None:
    time_s, clean = driven([45, 20, 45], 45, 3, 0.02, 0.12)
    path = denoised_base(time_s, clean)
    np.testing.assert_allclose(path.angle_rad, clean, atol=math.radians(0.005))


def test_a_small_true_overshoot_stays() -> None:
    time_s, clean = driven([45], 45, 3, 0.02, 0.08)
    bump = math.radians(0.4) * np.exp(-(((time_s - 2.2) / 0.15) ** 2))
    rng = np.random.default_rng(3)
    path = denoised_base(time_s, clean + bump + math.radians(0.02) * rng.standard_normal(len(clean)))
    assert reversals(path.angle_rad) == 1
    assert np.degrees(path.angle_rad.max()) == pytest.approx(45.4, abs=0.05)


def test_a_slow_drift_is_no_hold() -> None:
    time_s = np.arange(0, 20, 0.02)
    clean = np.radians(0.15) * time_s
    rng = np.random.default_rng(4)
    path = denoised_base(time_s, clean + math.radians(0.02) * rng.standard_normal(len(clean)))
    assert np.degrees(np.abs(path.angle_rad - clean)).max() < 0.06
    assert reversals(path.angle_rad) == 0


@given(st.lists(st.floats(-170, 170), min_size=3, max_size=60))
def test_unwrapping_undoes_wrapping(steps: list[float]) -> None:
    angle = np.cumsum(np.radians(np.array(steps) / 6))
    wrapped = (angle + math.pi) % (2 * math.pi) - math.pi
    again, _ = unwrapped(wrapped)
    turns = (again - angle) / (2 * math.pi)
    np.testing.assert_allclose(turns, turns[0], atol=1e-9)


def test_a_single_outlier_is_no_wrap() -> None:
    angle = np.zeros(50)
    angle[20] = math.radians(250)
    again, place = unwrapped(angle)
    assert place is None
    assert np.array_equal(again, angle)


def test_a_way_of_several_turns_between_samples_is_no_wrap() -> None:
    angle = np.cumsum(2 * math.pi * np.array([0.0, 4.6, 5.1, 6.0, 5.9, 0.0, -3.0, -1.6]))
    again, place = unwrapped(angle)
    assert place is None
    assert np.array_equal(again, angle)


def test_notes_stay_with_their_trial(folder: Path) -> None:
    table = rows(folder)
    table[10][2] = ""
    save(folder, table)
    dataset = read_dataset(folder)
    assert len(dataset.trials[0].notes) == 1
    assert dataset.trials[1].notes == ()
    assert dataset.notes == dataset.trials[0].notes
