"""A folder of recordings is one import: asked once, and again without a question."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset

PRACTICE = Path(__file__).parents[2] / "tests/data/practice/elastic"
NAMES = ("Time [s]", "Motor [deg]", "Torque [mNm]", *(f"Hall {k} [deg]" for k in (1, 2, 3, 4)))


def saved(path: Path, trial: int, names: tuple[str, ...] = NAMES) -> None:
    found = read_dataset(PRACTICE).trials[trial]
    angles = np.degrees(np.column_stack((found.base_measured_rad, found.hall_rad)))
    table = np.column_stack((found.trial.time_s, angles[:, 0], found.torque_nm * 1e3, angles[:, 1:]))
    path.parent.mkdir(exist_ok=True)
    np.savetxt(path, table, delimiter=",", header=",".join(names), comments="", fmt="%.6f")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for number, trial in ((1, 0), (2, 1), (10, 2)):
        saved(tmp_path / f"campaign/run_{number}.csv", trial)
    return tmp_path / "campaign"


def imported(folder: Path, out: str, *more: str) -> int:
    return command(["import", str(folder), *more, "--out", str(folder.parent / out)])


def test_a_folder_is_imported_and_later_files_of_its_kind_need_no_question(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(folder, "first", "--layout", str(PRACTICE)) == 0
    assert "first: 3 trials" in capsys.readouterr().out
    kept = (folder / "import.yaml").read_text(encoding="utf-8")
    places = [kept.index(f"run_{number}.csv") for number in (1, 2, 10)]
    assert places == sorted(places)
    saved(folder / "run_11.csv", 3)
    assert imported(folder, "second") == 0
    told = capsys.readouterr().out
    assert "second: 4 trials" in told
    assert "base_angle" not in told
    assert (folder / "import.yaml").read_text(encoding="utf-8") == kept


@pytest.mark.whole
def test_what_was_confirmed_once_is_not_asked_again(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, trial in ((1, 0), (2, 1), (10, 2)):
        path = folder / f"run_{number}.csv"
        saved(path, trial)
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        header = ",".join((*NAMES, "Torque again [mNm]"))
        np.savetxt(path, table[:, [*range(7), 2]], delimiter=",", header=header, comments="", fmt="%.6f")
    assert imported(folder, "first", "--layout", str(PRACTICE)) == 2
    assert "could be it as well" in capsys.readouterr().err
    assert not (folder / "import.yaml").exists()
    assert imported(folder, "first", "--layout", str(PRACTICE), "--yes") == 0
    assert "taken as it is" in capsys.readouterr().err
    assert imported(folder, "second") == 0
    told = capsys.readouterr()
    assert "second: 3 trials" in told.out
    assert "could be it as well" not in told.out + told.err


def test_what_does_not_belong_to_a_folder_is_left_aside_with_its_reason(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "notes.txt").write_text("needle 3, new grease\n", encoding="utf-8")
    (folder / "plot.png").write_bytes(b"\x89PNG")
    saved(folder / "calibration.csv", 4, ("t [s]", "a [deg]", "b [mNm]", *NAMES[3:]))
    saved(folder / "day 2/run_1.csv", 4)
    (folder / "day 2/round").symlink_to(folder)
    assert imported(folder, "first", "--layout", str(PRACTICE)) == 0
    told = capsys.readouterr()
    assert "first: 4 trials" in told.out
    assert "notes.txt" in told.err
    assert "calibration.csv: 1 of 5 files have its columns; import it alone" in told.err
    assert "plot.png" not in told.err


def test_a_file_of_another_kind_and_an_empty_folder_are_sentences(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert imported(folder, "first", "--layout", str(PRACTICE)) == 0
    for number in (1, 2, 10):
        saved(folder / f"run_{number}.csv", 0, (*NAMES[:2], "Moment [mNm]", *NAMES[3:]))
    assert imported(folder, "second") == 2
    assert "has no column Torque [mNm], which the mapping names" in capsys.readouterr().err.replace("\n", " ")
    assert imported(folder, "third", "--guess") == 2
    assert "leave --guess out, or remove it" in capsys.readouterr().err
    (folder.parent / "empty").mkdir()
    assert imported(folder.parent / "empty", "fourth") == 2
    assert "holds no recording" in capsys.readouterr().err
