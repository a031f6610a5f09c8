"""Recordings of other laboratories: read, mapped, refused where no needle does what they show."""

from __future__ import annotations

import dataclasses
import importlib.util
import math
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest
import scipy.io

from campaigns.files import import_files
from needle_rig.cli.main import run as command
from needle_rig.config.places import write_yaml
from needle_rig.dataset import Dataset, read_dataset, write_dataset
from needle_rig.dataset.description import RigPart, read_description
from needle_rig.errors import BadInput
from needle_rig.importing import (
    Mapping,
    Recordings,
    dataset_of,
    guess,
    read_mapping,
    read_recording,
    reader,
    signals,
    write_mapping,
)
from needle_rig.importing.guess.trials import LEAST_OF_A_STROKE, MOST_OF_A_STROKE
from needle_rig.importing.mapping import TrialsPart
from needle_rig.importing.recording import Recording
from needle_rig.importing.unit_text import split_name, unit_of
from needle_rig.workbench.observations.binning import MOVING_BINS, MOVING_BLOCKS
from needle_rig.workbench.observations.measured_noise import SMOOTH_WINDOW

ROOT = Path(__file__).parents[2]
PRACTICE = ROOT / "tests/data/practice/elastic"
DAVINCI = ROOT / "tests/data/real/davinci.yaml"
NAMES = ("time_s", "motor_deg", "torque_nmm", "hall_1_deg", "hall_2_deg", "hall_3_deg", "hall_4_deg")


@pytest.fixture(scope="module")
def rig() -> RigPart:
    return read_description(PRACTICE)[0].rig


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    """Time s, base °, torque N·mm, four angles °: a trial of another code's needle."""
    trial = read_dataset(PRACTICE).trials[0]
    angles = np.degrees(np.column_stack((trial.base_measured_rad, trial.hall_rad)))
    return np.column_stack((trial.trial.time_s, angles[:, 0], trial.torque_nm * 1e3, angles[:, 1:]))


def written(path: Path, table: np.ndarray, names: tuple[str, ...] = NAMES) -> Path:
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.6f")
    return path


def mapped(path: Path, rig: RigPart | None) -> Mapping:
    return guess([read_recording(path)], "mine", rig, Path())


def with_channel(mapping: Mapping, role: str, **changes: object) -> Mapping:
    channels = tuple(c.model_copy(update=changes) if c.role == role else c for c in mapping.channels)
    return mapping.model_copy(update={"channels": channels})


@pytest.mark.parametrize(
    ("text", "meant"),
    [
        ("[deg]", "deg"), ("°", "deg"), ("N·mm", "N·mm"), ("Nmm", "N·mm"), ("mNm", "mN·m"), ("N-m", "N·m"),
        ("uNm", "µN·m"), ("oz-in", "ozf·in"), ("usec", "µs"), ("rev", "turn"),
        ("cNm", "cN·m"), ("in-lbs", "lbf·in"), ("ft-lb", "lbf·ft"), ("º", "deg"),
        ("rads", "rad"), ("degs", "deg"),
        ("MNm", None), ("grad", None), ("NM·M", None), ("counts?", None), ("S1", None), ("motor", None),
    ],
)  # fmt: skip
def test_a_unit_is_read_as_people_write_it_and_never_by_halves(text: str, meant: str | None) -> None:
    unit = unit_of(text)
    assert (None if unit is None else unit.text) == meant


def test_units_of_torque_have_their_size() -> None:
    sizes = {
        text: unit.si for text in ("N·m", "N·cm", "mN·m", "N·mm", "µN·m", "oz-in") if (unit := unit_of(text))
    }
    assert sizes == pytest.approx(
        {"N·m": 1.0, "N·cm": 1e-2, "mN·m": 1e-3, "N·mm": 1e-3, "µN·m": 1e-6, "oz-in": 0.00706155}, rel=1e-6
    )


def test_a_letter_at_the_end_of_a_name_is_no_unit() -> None:
    assert split_name("hall_A") == ("hall_A", "")
    assert split_name("Torque (N·mm)") == ("Torque", "N·mm")


@pytest.mark.whole
def test_a_recording_becomes_the_dataset_it_was_written_from(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    made = table.copy()
    made[:, 2] *= -1.0
    mapping = mapped(written(tmp_path / "log.csv", made), rig)
    assert mapping.doubts() == []
    assert next(c.sign for c in mapping.channels if c.role == "base_torque") == -1
    trial = dataset_of(mapping, Path()).trials[0]
    assert np.degrees(trial.base_measured_rad) == pytest.approx(table[:, 1] - table[:20, 1].mean(), abs=0.05)
    assert trial.torque_nm * 1e3 == pytest.approx(table[:, 2] - table[:20, 2].mean(), abs=3e-4)


@pytest.mark.whole
def test_an_import_from_its_mapping_alone_is_the_same_bit_for_bit(tmp_path: Path, table: np.ndarray) -> None:
    log = written(tmp_path / "log.csv", table)
    line = ["import", str(log), "--guess", "--layout", str(PRACTICE), "--out", str(tmp_path / "one")]
    assert command(line) == 0
    assert command(["import", str(tmp_path / "one/import.yaml"), "--out", str(tmp_path / "deep/two")]) == 0
    for name in ("trials/01.csv",):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "deep/two" / name).read_bytes()
    assert (tmp_path / "one/import.png").stat().st_size > 10_000
    mapping, _ = read_mapping(tmp_path / "deep/two/import.yaml")
    part = next(iter(mapping.clocks.values())).files[0]
    assert (tmp_path / "deep/two" / part.path).resolve() == log.resolve()
    assert part.sha256 is not None


def test_an_import_reads_each_file_once(
    tmp_path: Path, table: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    read: list[Path] = []

    def counted(path: Path, dbc: Path | None) -> Recording:
        read.append(path)
        return read_recording(path, dbc)

    monkeypatch.setattr(reader, "read_recording", counted)
    log = written(tmp_path / "log.csv", table)
    line = ["import", str(log), "--guess", "--layout", str(PRACTICE), "--out", str(tmp_path / "one")]
    assert command(line) == 0
    assert read == [log]


def test_what_is_too_large_to_be_kept_is_read_again(
    tmp_path: Path, table: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = written(tmp_path / "log.csv", table)
    recordings = Recordings()
    assert recordings.read(log).columns[0].values is recordings.read(log).columns[0].values
    monkeypatch.setattr(reader, "KEPT_BYTES", table.nbytes - 1)
    recordings = Recordings()
    assert recordings.read(log).columns[0].values is not recordings.read(log).columns[0].values


def test_a_file_that_changed_since_the_mapping_is_refused(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table), rig)
    written(tmp_path / "log.csv", table[:-1])
    with pytest.raises(BadInput, match="SHA-256 differs"):
        dataset_of(mapping, Path())


@pytest.mark.parametrize(
    ("role", "changes", "said"),
    [
        ("base_torque", {"sign": -1}, "falls while the base winds up"),
        ("hall_1", {"unit": "rad"}, "57.3 times"),
        ("hall_1", {"scale": 1 / 57.3}, "in radians where the mapping says degrees"),
        ("base_angle", {"unit": "rad"}, "57.3 times too large"),
        ("hall_2", {"sign": -1}, "turns against the base"),
        ("base_torque", {"unit": "N·m"}, "base_torque spans"),
        ("base_torque", {"unit": "µN·m"}, "base_torque spans"),
    ],
)
def test_what_no_needle_does_is_a_sentence(
    role: str, changes: dict[str, object], said: str, tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping = with_channel(mapped(written(tmp_path / "log.csv", table), rig), role, **changes)
    with pytest.raises(BadInput, match=said):
        dataset_of(mapping, Path())


def test_a_base_that_lags_its_needle_is_refused(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table), rig)
    mapping = with_channel(mapping, "base_angle", source="hall_1_deg")
    mapping = with_channel(mapping, "hall_1", source="motor_deg")
    with pytest.raises(BadInput, match=r"hall_1 (moves before the base|turns 1)"):
        dataset_of(mapping, Path())


@pytest.mark.parametrize(("column", "factor"), [(1, math.pi / 180), (2, 1e-3), (3, math.pi / 180), (0, 1e3)])
def test_a_unit_that_the_name_gets_wrong_is_asked(
    column: int, factor: float, tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    wrong = table.copy()
    wrong[:, column] *= factor
    assert mapped(written(tmp_path / "log.csv", wrong), rig).doubts()


def test_a_unit_that_nothing_tells_is_not_guessed(tmp_path: Path, table: np.ndarray) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table[:, :3], ("t", "q1", "Mz")), None)
    torque = next(c for c in mapping.channels if c.role == "base_torque")
    assert torque.unit is None
    assert any("Mz" in lack for lack in mapping.lacks())


def test_what_is_doubted_is_written_to_a_file_and_taken_once_confirmed(
    tmp_path: Path, table: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    wrong = table.copy()
    wrong[:, 3] *= math.pi / 180
    log = written(tmp_path / "log.csv", wrong)
    out = tmp_path / "mine"
    line = ["import", str(log), "--guess", "--layout", str(PRACTICE), "--out", str(out)]
    assert command(line) == 2
    assert "hall_1" in capsys.readouterr().err
    assert not out.exists()
    assert (tmp_path / "mine.png").exists()
    assert command(["import", str(tmp_path / "mine.yaml"), "--out", str(out)]) == 2
    mapping, _ = read_mapping(tmp_path / "mine.yaml")
    sure = with_channel(mapping, "hall_1", unit="rad", doubt="")
    write_mapping(sure, tmp_path / "mine.yaml", tmp_path)
    assert command(["import", str(tmp_path / "mine.yaml"), "--out", str(out)]) == 0
    assert np.ptp(read_dataset(out).trials[0].hall_rad[:, 0]) == pytest.approx(
        np.radians(np.ptp(table[:, 3])), rel=0.02
    )


def test_two_files_with_clocks_of_their_own_are_brought_together(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    daq = written(tmp_path / "daq.csv", table[:, :3], NAMES[:3])
    camera = table[::5][:, [0, 1, 3, 4, 5, 6]].copy()
    camera[:, 0] -= 2.75
    seen = written(tmp_path / "camera.csv", camera, ("time_s", "chuck_deg", *NAMES[3:]))
    mapping = guess([read_recording(daq), read_recording(seen)], "mine", rig, Path())
    assert mapping.doubts() == []
    assert mapping.clocks["camera"].files[0].offset_s == pytest.approx(2.75, abs=0.01)
    trial = dataset_of(mapping, Path()).trials[0]
    known = np.isfinite(trial.hall_rad[:, 0])
    assert np.count_nonzero(known) == pytest.approx(len(camera), abs=2)
    assert np.isfinite(trial.torque_nm).all()


def test_one_long_recording_is_cut_where_the_shaft_is_as_it_was(tmp_path: Path, rig: RigPart) -> None:
    rows, begin_s = [], 0.0
    for trial in read_dataset(PRACTICE).trials[:3]:
        time_s = trial.trial.time_s
        rest = np.zeros((100, 7))
        rest[:, 0] = begin_s + 0.02 * np.arange(100)
        rest[:, 1] = 0.02 * np.sin(np.arange(100) * 7.0)
        angles = np.degrees(np.column_stack((trial.base_measured_rad, trial.hall_rad)))
        told = np.column_stack(
            (time_s + rest[-1, 0] + 0.02, angles[:, 0], trial.torque_nm * 1e3, angles[:, 1:])
        )
        rows += [rest, told]
        begin_s = float(told[-1, 0]) + 0.02
    mapping = mapped(written(tmp_path / "long.csv", np.concatenate(rows)), rig)
    dataset = dataset_of(mapping, Path())
    assert len(dataset.trials) == 3
    assert [len(places) for places in dataset.replicates.values()] == [2, 1]


def test_what_earlier_turns_left_in_the_shaft_goes_before_a_trial_unless_it_was_let_go(
    tmp_path: Path, rig: RigPart
) -> None:
    time_s = np.arange(0.0, 12.0, 0.02)
    corners_s = [0.0, 1.0, 3.0, 5.0, 6.0, 8.5, 9.5, 10.5, 12.0]
    base_deg = np.interp(time_s, corners_s, [0.0, 0.0, 60.0, -20.0, 0.0, 0.0, 45.0, 45.0, 45.0])
    random = np.random.default_rng(2)
    for twist_deg in (1.5, 0.0):
        shaft = np.interp(time_s, corners_s, [0.0, 0.0, 30.0, 5.0, *[twist_deg] * 2, 20.0, 20.0, 20.0])
        halls = shaft[:, None] + 0.05 * random.standard_normal((len(time_s), 4))
        torque = 2e-3 * (base_deg - shaft) + 1e-4 * random.standard_normal(len(time_s))
        noisy = base_deg + 0.01 * random.standard_normal(len(time_s))
        table = np.column_stack((time_s, noisy, torque, halls))
        log = written(tmp_path / f"log{twist_deg:g}.csv", table)
        mapping = mapped(log, rig).model_copy(update={"trials": TrialsPart(at="rests")})
        data = dataset_of(mapping, Path())
        assert len(data.trials) == 2
        assert data.trials[0].turns_before_rad == ()
        turns = np.degrees(data.trials[1].turns_before_rad)
        assert turns == pytest.approx([60.0, -20.0, 0.0][: 3 if twist_deg else 0], abs=0.5)
        came_s = data.trials[1].turns_before_s
        assert came_s == pytest.approx([4.25, 2.25, 1.25][: 3 if twist_deg else 0], abs=0.1)
        assert any("earlier ones left" in note for note in data.notes) is bool(twist_deg)
        again = read_dataset(write_dataset(data, tmp_path / f"data{twist_deg:g}"))
        assert again.trials[1].turns_before_rad == pytest.approx(data.trials[1].turns_before_rad, abs=1e-5)
        assert again.trials[1].turns_before_s == pytest.approx(came_s, abs=1e-5)


@pytest.mark.parametrize(("zero", "start"), [("start", "zeroed"), (0.0, "wound")])
def test_a_recording_that_began_late_says_how_the_shaft_was(
    tmp_path: Path, rig: RigPart, table: np.ndarray, zero: float | str, start: str
) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table), rig)
    written(tmp_path / "log.csv", table[100:])
    late = mapping.model_copy(
        update={
            "clocks": {
                name: clock.model_copy(
                    update={"files": tuple(f.model_copy(update={"sha256": None}) for f in clock.files)}
                )
                for name, clock in mapping.clocks.items()
            },
            "channels": tuple(c.model_copy(update={"zero": zero}) for c in mapping.channels),
        }
    )
    wound = late.model_copy(update={"trials": TrialsPart(start="wound")})
    (trial,) = dataset_of(wound, Path()).trials
    assert trial.start == start
    first = 0.0 if start == "zeroed" else table[100, 2]
    assert trial.torque_nm[0] * 1e3 == pytest.approx(first, abs=0.004)


def test_a_faster_recording_is_averaged_down(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    time_s = np.arange(0.0, table[-1, 0], 5e-4)
    fine = np.column_stack([time_s, *(np.interp(time_s, table[:, 0], c) for c in table.T[1:])])
    mapping = mapped(written(tmp_path / "fast.csv", fine), rig)
    assert mapping.rate_hz is not None
    trial = dataset_of(mapping, Path()).trials[0]
    assert len(trial.trial.time_s) <= 20_000
    assert np.ptp(trial.base_measured_rad) == pytest.approx(np.radians(np.ptp(table[:, 1])), rel=0.01)


def hour_of(tmp_path: Path, rig: RigPart, table: np.ndarray, stroke_s: float) -> tuple[Mapping, Dataset]:
    """The mapping and the dataset of an hour of a base to and fro, 20 samples a second."""
    time_s = np.arange(0.0, 3600.0, 0.05)
    base_deg = 30.0 * np.sin(np.pi * time_s / stroke_s)
    torque_nmm = 0.1 * np.tanh(np.gradient(base_deg, time_s))
    base_deg += np.random.default_rng(0).normal(0.0, 0.05, len(base_deg))
    long = np.column_stack([time_s, base_deg, torque_nmm, *[0.9 * base_deg] * (table.shape[1] - 3)])
    mapping = mapped(written(tmp_path / "hour.csv", long), rig)
    return mapping, dataset_of(mapping.model_copy(update={"trials": TrialsPart(start="wound")}), Path())


@pytest.mark.whole
def test_fast_strokes_of_an_hour_are_kept_finely_and_not_to_the_end(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping, dataset = hour_of(tmp_path, rig, table, 2.5)
    assert mapping.rate_hz == 20.0
    (trial,) = dataset.trials
    assert trial.trial.time_s[-1] == pytest.approx(999.95)
    assert [n for n in dataset.notes if "the first 1000 s of 3600 s are used" in n]
    two = TrialsPart(at="times", times_s=((0.0, 500.0), (2000.0, 3500.0)), start="wound")
    cut = dataset_of(mapping.model_copy(update={"trials": two}), Path())
    # a trial loses its own end alone
    assert [float(t.trial.time_s[-1]) for t in cut.trials] == pytest.approx([499.95, 999.95], abs=0.1)
    assert [n for n in cut.notes if "trial 2: the first 1000 s of 1500 s are used" in n]


@pytest.mark.whole
def test_slow_strokes_of_an_hour_are_averaged_and_kept_to_the_end(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping, dataset = hour_of(tmp_path, rig, table, 5.0)
    assert mapping.rate_hz == 5.0
    assert dataset.trials[0].trial.time_s[-1] > 3599.0
    assert not [n for n in dataset.notes if "are used" in n]


def test_a_stroke_keeps_what_the_workbench_bins_and_reads_noise_from() -> None:
    assert LEAST_OF_A_STROKE == MOVING_BINS
    assert MOST_OF_A_STROKE == 4 * SMOOTH_WINDOW >= MOVING_BLOCKS


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.04])
@pytest.mark.parametrize("stroke", [7.0, 50.0, 400.0])
def test_strokes_are_counted_beside_noise_and_holds(stroke: float, noise: float) -> None:
    k = np.arange(12_000)
    path = np.sin(np.pi * k / stroke) + noise * np.random.default_rng(3).normal(size=k.size)
    assert signals.stroke_samples(path) == pytest.approx(stroke, rel=0.1)
    with_holds = np.repeat(path, np.where(k % stroke == 0, 100, 1))
    assert signals.stroke_samples(with_holds) == pytest.approx(stroke + 99, rel=0.1)
    assert signals.stroke_samples(np.arange(100.0)) == math.inf
    assert signals.stroke_samples(np.zeros(100)) == math.inf


def test_a_row_that_lost_a_field_does_not_shift_the_others(tmp_path: Path, table: np.ndarray) -> None:
    path = written(tmp_path / "log.csv", table)
    lines = path.read_text().splitlines()
    lines[40] = lines[40].replace(",", "", 1)
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(BadInput, match=r"log\.csv:41: 6 fields where the table has 7"):
        read_recording(path)


def test_decimal_commas_between_commas_are_refused_and_not_read_as_twice_the_columns(
    tmp_path: Path, table: np.ndarray
) -> None:
    path = tmp_path / "log.csv"
    rows = [",".join(f"{value:.6f}".replace(".", ",") for value in row) for row in table]
    path.write_text("\n".join([",".join(NAMES), *rows]) + "\n")
    with pytest.raises(BadInput, match=r"log\.csv:2: 14 fields below 7 names: decimal commas between commas"):
        read_recording(path)


def test_a_field_values_has_the_unit_of_what_is_named_before_it(tmp_path: Path, table: np.ndarray) -> None:
    signals = np.zeros(2, dtype=[("values", object), ("label", object)])
    for k, name in enumerate(("base_angle_rad", "torque_mNm")):
        signals[k] = (table[:, k + 1 : k + 2], name)
    scipy.io.savemat(tmp_path / "sim.mat", {"out": {"time": table[:, 0], "signals": signals}})
    units = {column.name: column.unit for column in read_recording(tmp_path / "sim.mat").columns}
    assert units["signals/base_angle_rad/values"] == "rad"
    assert units["signals/torque_mNm/values"] == "mNm"


@pytest.mark.parametrize("rows", [slice(100, 120), slice(0, 1), slice(-1, None)])
def test_rows_without_a_time_are_left_out(
    tmp_path: Path, rig: RigPart, table: np.ndarray, rows: slice
) -> None:
    holes = table.copy()
    holes[rows, 0] = np.nan
    mapping = guess([read_recording(written(tmp_path / "log.csv", holes))], "mine", rig, Path())
    (trial,) = dataset_of(mapping, Path()).trials
    assert len(trial.trial.time_s) == np.isfinite(holes[:, 0]).sum()


def test_a_recording_without_any_time_asks_for_its_rate(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    holes = table.copy()
    holes[:, 0] = np.nan
    mapping = guess([read_recording(written(tmp_path / "log.csv", holes))], "mine", rig, Path())
    with pytest.raises(BadInput, match="neither a column with its unit nor rate_hz is known"):
        dataset_of(mapping, Path())


def test_a_guess_taken_with_its_doubts_takes_what_is_written_says_so_and_keeps_them(
    tmp_path: Path, table: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    large = table.copy()
    large[:, 2] *= 1e4
    log = written(tmp_path / "log.csv", large)
    out = tmp_path / "mine"
    line = ["import", str(log), "--guess", "--layout", str(PRACTICE), "--out", str(out)]
    assert command(line) == 2
    assert command([*line, "--yes"]) == 0
    said = capsys.readouterr().err
    assert "taken as it is: base_torque" in said
    assert "taken as confirmed: base_torque spans" in said
    mapping, _ = read_mapping(out / "import.yaml")
    torque = next(c for c in mapping.channels if c.role == "base_torque")
    assert (torque.unit, torque.sure) == ("N·mm", True)
    assert "confirmed: in N·mm, as written, it spans" in torque.why
    assert np.ptp(read_dataset(out).trials[0].torque_nm) == pytest.approx(
        1e-3 * np.ptp(large[:, 2]), rel=0.02
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"rate_hz": 1e9}, "is more than the"),
        ({"trials": {"at": "times", "times_s": [[900, 950]]}}, "lies outside"),
    ],
)
def test_a_mapping_that_asks_for_what_is_not_there_is_refused(
    changes: dict[str, object], said: str, tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table), rig)
    asked = Mapping.model_validate({**mapping.model_dump(), **changes})
    with pytest.raises(BadInput, match=said):
        dataset_of(asked, Path())


def test_a_real_machine_is_imported_by_the_mapping_in_the_repository(tmp_path: Path) -> None:
    mapping, places = read_mapping(DAVINCI)
    trial = dataset_of(mapping, DAVINCI.parent, places).trials[0]
    assert math.degrees(np.ptp(trial.base_measured_rad)) == pytest.approx(58.1, abs=0.2)
    assert np.ptp(trial.torque_nm) == pytest.approx(0.135, abs=0.003)
    recording = read_recording(DAVINCI.parent / mapping.clocks["log"].files[0].path)
    doubts = " ".join(guess([recording], "davinci", None, Path()).doubts())
    assert "written as ms, which makes 1e+06 samples a second" in doubts
    assert "counts" in doubts


def test_work_and_loop_tell_what_drives() -> None:
    t = np.linspace(0.0, 4 * math.pi, 400)
    base, late = np.sin(t), 0.7 * np.sin(t - 0.2)
    assert signals.lag_share(base, late) > 0.0 > signals.lag_share(late, base)
    assert signals.lag_share(base, -late) > 0.0
    torque = np.sign(np.gradient(base))
    assert signals.work_share(base, torque) == pytest.approx(1.0)
    assert signals.work_share(base, -torque) == pytest.approx(-1.0)


def test_a_mapping_with_a_mistake_says_where(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    mapping = mapped(written(tmp_path / "log.csv", table), rig)
    told = mapping.model_dump(mode="json")
    for change, said in (
        ({"unit": "kelvin"}, "is no unit of angle or rate or length or speed"),
        ({"unit": "rad/s", "zero": "start"}, "is a speed, whose zero no start shows"),
        ({"clock": "wall"}, "wall is no clock of this file"),
        ({"role": "hall_9"}, "hall_9 is none of"),
        ({"colour": "red"}, "unknown key"),
    ):
        broken = {**told, "channels": [{**told["channels"][0], **change}, *told["channels"][1:]]}
        (tmp_path / "m.yaml").write_text(write_yaml(broken), encoding="utf-8")
        with pytest.raises(BadInput, match=said):
            read_mapping(tmp_path / "m.yaml")


@pytest.mark.whole
@pytest.mark.filterwarnings("ignore")  # of packages that write the files
def test_a_sample_of_files_is_guessed_right_and_of_its_mutations_none_wrong() -> None:
    for module in (
        "pandas",
        "openpyxl",
        "rosbags",
        "python_calamine",
        "polars",
        "nptdms",
        "asammdf",
        "matio",
    ):
        if importlib.util.find_spec(module) is None:
            pytest.skip(f"{module} writes the files")
    given = Namespace(size=50, first_seed=3, keep=None)
    tasks = import_files.plan(given)
    sample = [*tasks[: -given.size : 5], *tasks[-given.size :]]
    rows = [{**task, **import_files.ask(task, given)} for task in sample]
    files = len(sample) - given.size
    assert files > 10
    assert not [row for row in rows if import_files.failed([row])]
    assert f"{files} files: " in import_files.table(rows, given)


def test_a_recording_keeps_its_columns_apart_from_its_tables(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["daq/t"], file["daq/q"] = np.arange(50.0), np.arange(50.0)
        file["camera/t"], file["camera/x"] = np.arange(20.0), np.arange(20.0)
    tables = read_recording(tmp_path / "run.h5").tables()
    assert {table: len(columns) for table, columns in tables.items()} == {"daq": 2, "camera": 2}
    assert dataclasses.is_dataclass(tables["daq"][0])
