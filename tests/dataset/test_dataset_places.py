"""A dataset's own files lie in its folder and are files: nothing else is opened, nothing of it is quoted."""

from __future__ import annotations

import os
import shutil
import socket
from pathlib import Path

import pytest

from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset, table
from needle_rig.dataset.settled import read_settled
from needle_rig.errors import BadInput

PRACTICE = Path(__file__).resolve().parent.parent / "data/practice/none"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    copy = tmp_path / "set"
    shutil.copytree(PRACTICE, copy)
    (tmp_path / "secret.csv").write_text("the,password\n1,2\n")
    return copy


def name_trial(folder: Path, file: str) -> None:
    text = (folder / "dataset.yaml").read_text(encoding="utf-8")
    assert "trials/01.csv" in text
    (folder / "dataset.yaml").write_text(text.replace("trials/01.csv", f'"{file}"'), encoding="utf-8")


@pytest.mark.parametrize(
    ("file", "says"),
    [
        ("/etc/passwd", "lies outside of the folder"),
        ("../../../../../../../../../../../../etc/passwd", "lies outside of the folder"),
        ("../secret.csv", "lies outside of the folder"),
        ("trials/outside.csv", "lies outside of the folder"),
        ("trials/loop.csv", "is a link that leads back to itself"),
        ("trials/pipe.csv", "is a pipe, not a file"),
        ("trials/zero.csv", "lies outside of the folder"),
        ("trials/socket.csv", "is a socket, not a file"),
        ("trials", "is a folder, not a file"),
        ("trials/a\\0.csv", r"character U+0000 may not stand in a key or value"),
        ("a" * 5000, "File name too long"),
        ("b" * 300, "File name too long"),
        ("trials/01.csv/more", "there is no such file; correct `file` in dataset.yaml"),
    ],
)
def test_a_trial_that_is_no_file_of_the_dataset(
    file: str, says: str, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder / "trials")
    Path("outside.csv").symlink_to(folder.parent / "secret.csv")
    Path("loop.csv").symlink_to("loop.csv")
    Path("zero.csv").symlink_to("/dev/zero")
    os.mkfifo("pipe.csv")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket.csv")
    name_trial(folder, file)
    assert command(["compare", str(folder)]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said) < 500
    assert len(said.splitlines()) == 1
    assert "password" not in said.replace("etc/passwd", "")
    assert "daemon:" not in said


def test_a_trial_within_the_folder_may_be_a_link(folder: Path) -> None:
    (folder / "trials/01.csv").rename(folder / "kept.csv")
    (folder / "trials/01.csv").symlink_to("../kept.csv")
    assert len(read_dataset(folder).trials) == len(read_dataset(PRACTICE).trials)


@pytest.mark.parametrize("name", ["dataset.yaml", "settled.yaml"])
def test_a_description_that_leads_outside(name: str, tmp_path: Path) -> None:
    folder = tmp_path / "set"
    folder.mkdir()
    (folder / name).symlink_to("/etc/passwd")
    with pytest.raises(BadInput, match="lies outside of the folder") as refused:
        (read_dataset if name == "dataset.yaml" else read_settled)(folder)
    assert "root:" not in str(refused.value)


@pytest.mark.parametrize("words", [["compare", "NAME"], ["compare", "NAME.h5"], ["export", "NAME", "--csv"]])
@pytest.mark.parametrize("name", ["n" * 300, "n" * 5000, "loop"])
def test_a_name_that_no_file_has(
    words: list[str],
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for suffix in ("", ".h5"):
        Path(f"loop{suffix}").symlink_to(f"loop{suffix}")
    assert command([word.replace("NAME", name) for word in words]) == 2
    assert "Traceback" not in capsys.readouterr().err


def test_a_table_of_too_many_columns(folder: Path) -> None:
    trial = folder / "trials/01.csv"
    lines = trial.read_text(encoding="utf-8").splitlines()
    extra = ",".join(f"c{n}" for n in range(table.MAX_COLUMNS))
    trial.write_text("\n".join([f"{lines[0]},{extra}", *lines[1:]]), encoding="utf-8")
    with pytest.raises(BadInput, match=r"01\.csv:1: 1008 columns, more than 1000"):
        read_dataset(folder)


def test_utf_16_that_is_none(folder: Path) -> None:
    (folder / "trials/01.csv").write_bytes(b"\xff\xfe" + b"\x00\xd8" * 100 + b"a")
    with pytest.raises(BadInput, match="begins as UTF-16 but is none"):
        read_dataset(folder)


def test_rows_are_counted_not_guessed_from_the_first(folder: Path) -> None:
    """Long lines first would let a guess keep every row of a long file."""
    trial = folder / "trials/01.csv"
    lines = trial.read_text(encoding="utf-8").splitlines()
    last = lines[-1].split(",")
    more = (",".join([f"{1000 + n * 1e-3:.3f}", *last[1:]]) for n in range(60_000))
    padded = [f"{lines[1]}{' ' * 70_000}", *lines[2:]]
    trial.write_text("\n".join([lines[0], *padded, *more, ""]), encoding="utf-8")
    found = table.read_table(trial, folder, "01.csv", "phase", "time")
    assert len(found.values) <= table.MAX_SAMPLES


@pytest.mark.parametrize(
    ("name", "code", "says"),
    [
        ("[/b] [red]none", 0, "[/b] [red]none against the model"),
        ("\\x1b[2J", 2, "dataset.yaml:2:7: character U+001B may not stand in a key or value"),
        ("\\ud800", 2, "dataset.yaml:2:7: character U+D800 may not stand in a key or value"),
    ],
)
def test_a_name_is_shown_as_it_is_written(
    name: str, code: int, says: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (folder / "dataset.yaml").read_text(encoding="utf-8")
    (folder / "dataset.yaml").write_text(text.replace("name: none\n", f'name: "{name}"\n'), encoding="utf-8")
    assert command(["compare", str(folder)]) == code
    said = capsys.readouterr()
    assert says in said.out + said.err


def test_a_column_that_a_terminal_obeys(folder: Path) -> None:
    trial = folder / "trials/01.csv"
    trial.write_text(trial.read_text(encoding="utf-8").replace("hall_1", "hall\x1b[2J"), encoding="utf-8")
    with pytest.raises(BadInput, match=r"01\.csv:1: column 'hall\\x1b\[2J_deg' has characters"):
        read_dataset(folder)
