"""A generic shaft and what is written tell the roles of columns; what neither tells is asked."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest

from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset
from needle_rig.dataset.description import RigPart, read_description
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, dataset_of, guess, read_recording
from needle_rig.importing.guess.assignment import ASKED_BELOW, CLEAR, WRONG
from needle_rig.importing.guess.generic_shaft import Driver
from needle_rig.importing.guess.series import Series, series_of
from needle_rig.importing.mapping import BASE, TORQUE
from needle_rig.importing.recording import Column
from needle_rig.numerics import Array

PRACTICE = Path(__file__).parents[2] / "tests/data/practice"
NAMES = ("Time [s]", "Motor [deg]", "Torque [mNm]", *(f"Hall {k} [deg]" for k in (1, 2, 3, 4)))


@pytest.fixture(scope="module")
def rig() -> RigPart:
    return read_description(PRACTICE / "elastic")[0].rig


def table(name: str = "elastic", trial: int = 0) -> Array:
    """Time s, base °, torque N·mm, four angles °."""
    found = read_dataset(PRACTICE / name).trials[trial]
    known = np.isfinite(found.base_measured_rad)
    angles = np.degrees(np.column_stack((found.base_measured_rad, found.hall_rad)))
    columns = (found.trial.time_s, angles[:, 0], found.torque_nm * 1e3, angles[:, 1:])
    return np.column_stack(columns)[known]


def guessed(path: Path, names: tuple[str, ...], values: Array, rig: RigPart | None) -> Mapping:
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(names)
        rows.writerows([f"{v:.6f}" if np.isfinite(v) else "" for v in row] for row in values)
    return guess([read_recording(path)], "mine", rig, Path())


def source_of(mapping: Mapping, role: str) -> str:
    return next(c.source for c in mapping.channels if c.role == role)


@pytest.mark.parametrize("name", ["backlash", "bias", "elastic", "layers", "none", "two"])
def test_a_base_explains_what_follows_it_better_than_that_explains_it(name: str) -> None:
    for trial in (0, 3, 6):
        values = table(name, trial)
        every = [series_of(Column("", "", v), "daq", values[:, 0]) for v in values.T[1:]]
        base, torque = every[:2]
        for follower in every[2:]:
            assert Driver(base).gain(follower) > Driver(follower).gain(base) + CLEAR
        assert Driver(base).gain(torque, torque=True) > Driver(base).gain(torque) + CLEAR


def test_noise_explains_nothing_and_nothing_explains_it() -> None:
    random = np.random.default_rng(1)
    time_s = np.linspace(0.0, 20.0, 2000)

    def series(values: Array) -> Series:
        return series_of(Column("", "", values), "daq", time_s)

    swings = [np.sin(time_s), np.cumsum(random.standard_normal(2000))]
    for _ in range(40):
        noise = series(random.standard_normal(2000))
        assert all(Driver(series(swing)).gain(noise) < CLEAR for swing in swings)
        assert all(Driver(noise).gain(series(swing), torque=True) < CLEAR for swing in swings)


def test_one_error_rate_decides_alike_wherever_it_lies_below_what_is_asked() -> None:
    assert 1.0 / (1.0 + WRONG) > ASKED_BELOW, "one piece of evidence suffices"
    assert WRONG / (WRONG + WRONG) < ASKED_BELOW, "two that contradict each other are asked"


@pytest.mark.whole
def test_a_name_that_the_motion_contradicts_is_asked_with_both_named(tmp_path: Path, rig: RigPart) -> None:
    names = list(NAMES)
    names[1], names[3] = names[3], names[1]
    mapping = guessed(tmp_path / "log.csv", tuple(names), table(), rig)
    base = next(c for c in mapping.channels if c.role == BASE)
    assert "Motor" in base.source + base.doubt
    assert "Hall 1" in base.source + base.doubt
    assert base.doubt


def joints(moving: tuple[int, ...]) -> tuple[tuple[str, ...], Array]:
    """Three joints of an arm, those `moving` with friction in their torque; the torques of the others are
    loads of what moves.
    """
    random = np.random.default_rng(3)
    time_s = np.arange(0.0, 20.0, 0.01)
    angle = 1e-4 * random.standard_normal((3, len(time_s)))
    torque = 0.02 * random.standard_normal((3, len(time_s)))
    for k in moving:
        phase = 2.0 * np.pi * time_s / (4.0 + k)
        angle[k] += 0.47 * np.sin(phase)
        torque[k] += 0.2 * np.tanh(np.cos(phase) / 0.05) + 0.1 * np.cos(phase)
        torque[k - 1] += 0.3 * np.cos(angle[k])
    names = ("time [s]", *(f"q.{k} [rad]" for k in (1, 2, 3)), *(f"tau.{k} [Nm]" for k in (1, 2, 3)))
    return names, np.column_stack((time_s, angle.T, torque.T))


@pytest.mark.parametrize("moving", [0, 1, 2])
def test_of_several_joints_the_one_that_moves_is_taken_with_its_torque(moving: int, tmp_path: Path) -> None:
    names, values = joints((moving,))
    mapping = guessed(tmp_path / "arm.csv", names, values, None)
    assert source_of(mapping, BASE) == names[1 + moving]
    assert source_of(mapping, TORQUE) == names[4 + moving]
    assert not next(c for c in mapping.channels if c.role == BASE).doubt


def test_two_joints_that_both_move_are_asked(tmp_path: Path) -> None:
    names, values = joints((0, 2))
    mapping = guessed(tmp_path / "arm.csv", names, values, None)
    base = next(c for c in mapping.channels if c.role == BASE)
    assert {"q.1 [rad]", "q.3 [rad]"} == {name for name in names if name in base.source + base.doubt}
    assert "turns a shaft of its own" in base.doubt


def test_sheets_with_the_same_columns_are_trials(tmp_path: Path, rig: RigPart) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    for trial in (0, 1):
        sheet = book.create_sheet(f"current {60 + trial}")
        sheet.append(list(NAMES))
        for row in table("elastic", trial):
            sheet.append([float(v) if np.isfinite(v) else None for v in row])
    book.remove(book.active)
    book.save(tmp_path / "series.xlsx")
    mapping = guess([read_recording(tmp_path / "series.xlsx")], "mine", rig, tmp_path)
    (clock,) = mapping.clocks.values()
    assert [file.table for file in clock.files] == ["current 60", "current 61"]
    assert mapping.doubts() == []
    assert len(dataset_of(mapping, tmp_path).trials) == 2


def test_sheets_are_imported_again_from_their_mapping(
    tmp_path: Path, rig: RigPart, capsys: pytest.CaptureFixture[str]
) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    for sheet in (book.active, book.create_sheet("again")):
        sheet.append(list(NAMES))
        for row in table():
            sheet.append([float(v) if np.isfinite(v) else None for v in row])
    book.save(tmp_path / "series.xlsx")
    layout = str(PRACTICE / "elastic")
    line = ["import", str(tmp_path / "series.xlsx"), "--guess", "--layout", layout]
    assert command([*line, "--out", str(tmp_path / "one")]) == 0
    assert command(["import", str(tmp_path / "one/import.yaml"), "--out", str(tmp_path / "two")]) == 0
    assert "two: 2 trials, 1 commands" in capsys.readouterr().out
    kept = (tmp_path / "one/import.yaml").read_text(encoding="utf-8")
    (tmp_path / "three.yaml").write_text(kept.replace("table: again", "table: gone"), encoding="utf-8")
    (tmp_path / "three.yaml").write_text(
        (tmp_path / "three.yaml").read_text(encoding="utf-8").replace("../series", "series"), encoding="utf-8"
    )
    assert command(["import", str(tmp_path / "three.yaml"), "--out", str(tmp_path / "three")]) == 2
    assert "series.xlsx: has no table gone; it has Sheet, again" in capsys.readouterr().err


def test_a_recording_without_an_angle_is_a_sentence(tmp_path: Path) -> None:
    values = table()[:, [0, 2]]
    with pytest.raises(BadInput, match="no column can be the base's angle"):
        guessed(tmp_path / "log.csv", ("Time [s]", "Torque [mNm]"), values, None)


@pytest.mark.parametrize("moves", [True, False])
def test_what_moves_as_a_torque_in_a_unit_that_nobody_knows_is_asked(
    tmp_path: Path, rig: RigPart, moves: bool
) -> None:
    values = table()
    if not moves:
        values[:, 2] = np.random.default_rng(0).standard_normal(len(values))
    names = ("time [s]", "F [deg]", "A [torqs]", "D [deg]", "B [deg]", "E [deg]", "C [deg]")
    doubts = guessed(tmp_path / "log.csv", names, values, rig).doubts()
    assert any("A [torqs] moves as one would: its unit 'torqs'" in doubt for doubt in doubts) == moves


def test_the_smallest_numbers_there_are_explain_as_others_do() -> None:
    values = table()
    base, torque = (series_of(Column("", "", v), "daq", values[:, 0]) for v in values.T[1:3])
    tiny = series_of(Column("", "", values[:, 2] * 1e-300), "daq", values[:, 0])
    assert Driver(base).gain(tiny, torque=True) == pytest.approx(Driver(base).gain(torque, torque=True))


@pytest.mark.parametrize("kept", [4, 3])
def test_a_sensor_of_the_layout_that_a_damaged_column_may_have_held_is_asked(
    tmp_path: Path, rig: RigPart, kept: int
) -> None:
    values = table()
    names = ("time_s", "motor_deg", "torque_nmm", *(f"hall_{k}" for k in range(1, kept + 1)))
    mapping = guessed(tmp_path / "log.csv", names, values[:, : len(names)], rig)
    lost = Column("hall_4", "", np.empty(0), fault="holds no numbers")
    read = read_recording(tmp_path / "log.csv")
    again = guess([dataclasses.replace(read, columns=(*read.columns, lost))], "mine", rig, Path())
    told = "hall_4 is not there, and hall_4 holds no numbers; shall it be imported without?"
    assert any(told in doubt for doubt in again.doubts()) == (kept == 3)
    assert not any(told in doubt for doubt in mapping.doubts())
