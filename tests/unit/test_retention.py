"""Old runs go by age and by space, as configured, and never one that nobody read."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from needle_rig.cli.main import run as needle_rig
from needle_rig.recording import mark_read, retain
from needle_rig.recording.retention import was_read

NOW_S = 1_000_000_000.0
DAY_S = 86_400.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Five runs of 40 MB, sparse, made 1 to 5 days ago, all read."""
    retain(tmp_path, 1.0, None)
    for age in range(1, 6):
        path = tmp_path / f"run_{age}.h5"
        with path.open("wb") as file:
            file.truncate(40_000_000)
        os.utime(path, (NOW_S, NOW_S - age * DAY_S))
        mark_read(path)
    return tmp_path


def left(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.h5"))


def test_without_a_limit_every_run_stays(folder: Path) -> None:
    assert retain(folder, None, None, NOW_S).removed == ()
    assert len(left(folder)) == 5


def test_runs_older_than_the_limit_go_with_their_pictures(folder: Path) -> None:
    (folder / "run_5.png").touch()
    kept = retain(folder, 3.5, None, NOW_S)
    assert [path.stem for path in kept.removed] == ["run_5", "run_4"]
    assert left(folder) == ["run_1", "run_2", "run_3"]
    assert not (folder / "run_5.png").exists()


def test_the_oldest_go_until_the_rest_fits(folder: Path) -> None:
    kept = retain(folder, None, 0.12, NOW_S)
    assert left(folder) == ["run_1", "run_2", "run_3"]
    assert kept.unread_bytes == 0


def test_a_run_that_nobody_read_stays_whatever_its_age_and_size(folder: Path) -> None:
    for age in (4, 5):
        (folder / ".read" / f"run_{age}").unlink()
    kept = retain(folder, 1.5, 0.05, NOW_S)
    assert left(folder) == ["run_1", "run_4", "run_5"]
    assert kept.unread_bytes == 70_000_000


def test_the_newest_run_and_one_that_is_not_closed_stay(folder: Path) -> None:
    (folder / "run_5.journal").touch()
    retain(folder, 1.0, 0.01, NOW_S + 100 * DAY_S)
    assert left(folder) == ["run_1", "run_5"]


def test_a_folder_that_takes_no_marks_loses_no_run(tmp_path: Path) -> None:
    path = tmp_path / "run_1.h5"
    path.touch()
    (tmp_path / "run_2.h5").touch()
    os.utime(path, (0, 0))
    mark_read(path)
    assert not was_read(path)
    (tmp_path / ".read").touch()
    mark_read(path)
    assert retain(tmp_path, 1.0, None).removed == ()


def test_who_exports_a_run_has_read_it_and_who_lists_it_has_not(
    run_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mine = tmp_path / "runs" / run_path.name
    mine.parent.mkdir()
    mine.write_bytes(run_path.read_bytes())
    retain(mine.parent, 1.0, None)
    assert needle_rig(["runs"]) == 0
    assert not was_read(mine)
    assert needle_rig(["export", "last", "--csv"]) == 0
    assert was_read(mine)
