"""What the disk refuses is a sentence with exit code 3, not a defect."""

from __future__ import annotations

from pathlib import Path

import pytest

from needle_rig.cli.main import run as command


@pytest.mark.parametrize("place", ["file/made", "n" * 300, "/dev/full/made"])
def test_a_place_that_cannot_be_written(
    place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("", encoding="utf-8")
    assert command(["simulate", "--rate-hz", "5", "--out", place]) == 3
    said = capsys.readouterr().err.removeprefix("simulating a series …\n")
    assert "cannot be read or written: " in said
    assert len(said) < 400
    assert len(said.splitlines()) == 1


def test_a_full_disk_without_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_given: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("needle_rig.recording.list_runs", full)
    assert command(["runs", "--dir", str(tmp_path)]) == 3
    assert (
        capsys.readouterr().err == "cannot be read or written: No space left on device; name another place\n"
    )


def test_another_error_of_the_system_stays_a_defect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_given: object) -> None:
        raise OSError(9, "Bad file descriptor")

    monkeypatch.setattr("needle_rig.recording.list_runs", broken)
    assert command(["runs", "--dir", str(tmp_path)]) == 70
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("named", "said"),
    [
        ("loop", "loop: this link leads to itself"),
        ("a", "a: this link leads to itself"),
        ("a/below", "a: this link leads to itself"),
        ("text", "text: cannot be listed (Not a directory)"),
    ],
)
def test_a_folder_of_runs_that_leads_nowhere_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], named: str, said: str
) -> None:
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    (tmp_path / "text").write_text("no folder")
    assert command(["runs", "--dir", str(tmp_path / named)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert said in err
    assert "folder of runs" in err
    assert len(err.splitlines()) == 1
