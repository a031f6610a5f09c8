"""A rig is packed into one file and comes back whole, or not at all."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import subprocess
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.cli.main import run
from needle_rig.config.files import shipped_file
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup import archive, backup
from needle_rig.service.setup.backup import back_up, restore
from needle_rig.version import VERSION


def put(path: Path, content: bytes) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def a_rig(root: Path) -> Installation:
    """A rig with calibration, a model and two runs."""
    place = Installation(root)
    text = shipped_file("rig.hardware.yaml").read_text(encoding="utf-8")
    put(place.rig_file, text.replace("directory: runs", "directory: /var/lib/needle-rig").encode())
    put(place.calibration / "torque.yaml", b"worst_residual_nmm: 0.001\n").chmod(0o600)
    put(place.rig_file.parent / "models/friction.yaml", b"a model")
    put(place.runs / "2026-01-01.h5", b"one" * 1000)
    put(place.runs / "2026-01-02.h5", b"two" * 1000)
    put(place.runs / ".read/2026-01-01", b"")
    return place


def contents(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture
def place(tmp_path: Path) -> Installation:
    return a_rig(tmp_path / "old")


def test_a_rig_comes_back_on_a_new_computer(place: Installation, tmp_path: Path) -> None:
    packed = back_up(place, tmp_path / "rig.zip", with_runs=True)
    assert (packed.files, packed.runs) == (6, 2)
    new = Installation(tmp_path / "new")
    back = restore(new, tmp_path / "rig.zip")
    assert (back.files, back.runs) == (6, 2)
    assert contents(new.root) == contents(place.root)
    assert (new.calibration / "torque.yaml").stat().st_mode & 0o777 == 0o600
    assert new.rig_file.parent.stat().st_mode & 0o777 == 0o755


def test_the_folder_of_the_rig_file_is_exchanged_and_kept_and_runs_are_added(
    place: Installation, tmp_path: Path
) -> None:
    back_up(place, tmp_path / "rig.zip", with_runs=True)
    kept = contents(place.rig_file.parent)
    put(place.rig_file, b"broken")
    put(place.rig_file.parent / "later.yaml", b"later")
    (place.runs / "2026-01-01.h5").unlink()
    put(place.runs / "2026-01-03.h5", b"three")
    back = restore(place, tmp_path / "rig.zip")
    assert back.runs == 1
    assert back.told == ("1 runs of it were there already",)
    assert contents(place.rig_file.parent) == kept
    replaced = place.rig_file.parent.with_name("needle-rig.replaced")
    assert (replaced / "rig.yaml").read_bytes() == b"broken"
    assert (replaced / "later.yaml").exists()
    assert sorted(path.name for path in place.runs.glob("*.h5")) == [f"2026-01-0{n}.h5" for n in (1, 2, 3)]
    # and again, over what was replaced
    restore(place, tmp_path / "rig.zip")
    assert contents(replaced) == kept


def test_without_runs_they_are_not_in_it(place: Installation, tmp_path: Path) -> None:
    assert back_up(place, tmp_path / "rig.zip", with_runs=False).runs == 0
    restore(Installation(tmp_path / "new"), tmp_path / "rig.zip")
    assert not list((tmp_path / "new/var").rglob("*.h5"))


def test_a_run_that_goes_on_forbids_both(place: Installation, tmp_path: Path) -> None:
    back_up(place, tmp_path / "rig.zip", with_runs=True)
    before = contents(place.root)
    with open(put(place.runs / "now.journal", b"NRJRNL1"), "rb") as journal:
        fcntl.flock(journal, fcntl.LOCK_EX)
        with pytest.raises(BadInput, match="now: this run goes on"):
            back_up(place, tmp_path / "second.zip", with_runs=True)
        with pytest.raises(BadInput, match="now: this run goes on"):
            restore(place, tmp_path / "rig.zip")
    (place.runs / "now.journal").unlink()
    assert contents(place.root) == before
    assert not (tmp_path / "second.zip").exists()


def test_a_run_of_the_same_name_with_other_contents_is_never_overwritten(
    place: Installation, tmp_path: Path
) -> None:
    back_up(place, tmp_path / "rig.zip", with_runs=True)
    put(place.runs / "2026-01-02.h5", b"another")
    before = contents(place.root)
    with pytest.raises(BadInput, match="is another run than the one of this name"):
        restore(place, tmp_path / "rig.zip")
    assert contents(place.root) == before


def rewritten(source: Path, target: Path, change: dict[str, bytes | None], **more: bytes) -> Path:
    """The archive with members changed (None: left out) or added."""
    with zipfile.ZipFile(source) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            content = change.get(name, old.read(name))
            if content is not None:
                new.writestr(name, content)
        for name, content in more.items():
            new.writestr(name, content)
    return target


def listed(source: Path, **changes: object) -> bytes:
    with zipfile.ZipFile(source) as old:
        return json.dumps(json.loads(old.read("contents.json")) | changes).encode()


def test_what_is_damaged_changes_nothing(place: Installation, tmp_path: Path) -> None:
    good = tmp_path / "rig.zip"
    back_up(place, good, with_runs=True)
    content = good.read_bytes()
    escaping = [{"name": "rig/../../x", "size_bytes": 1, "sha256": "", "mode": 0o644}]
    damaged = {
        "cut": put(tmp_path / "cut", content[: len(content) // 2]),
        "empty": put(tmp_path / "empty", b""),
        "text": put(tmp_path / "text", b"format: needle-rig/1\n"),
        "flipped": put(tmp_path / "flipped", content[:500] + bytes([content[500] ^ 1]) + content[501:]),
        "another file": rewritten(good, tmp_path / "a", {"rig/calibration/torque.yaml": b"worst: 0\n"}),
        "a file less": rewritten(good, tmp_path / "b", {"runs/2026-01-02.h5": None}),
        "a file more": rewritten(good, tmp_path / "c", {}, **{"etc/shadow": b"root::"}),
        "no list": rewritten(good, tmp_path / "d", {"contents.json": None}),
        "a list of nothing": rewritten(good, tmp_path / "e", {"contents.json": b"[]"}),
        "a way out": rewritten(
            good, tmp_path / "f", {"contents.json": listed(good, files=escaping)}, **{"rig/../../x": b"x"}
        ),
        "wrong types": rewritten(good, tmp_path / "g", {"contents.json": listed(good, files=[{"name": 3}])}),
    }
    before = contents(place.root)
    for what, path in damaged.items():
        with pytest.raises(BadInput, match=r"is damaged|is no backup") as refused:
            restore(place, path)
        assert str(path) in str(refused.value), what
        assert contents(place.root) == before, what
    assert not (tmp_path.parent / "x").exists()


def test_a_backup_of_a_newer_format_names_the_version_that_wrote_it(
    place: Installation, tmp_path: Path
) -> None:
    back_up(place, tmp_path / "rig.zip", with_runs=False)
    newer = listed(tmp_path / "rig.zip", format="needle-rig-backup/2", version="9.1.0")
    path = rewritten(tmp_path / "rig.zip", tmp_path / "newer.zip", {"contents.json": newer})
    says = rf"a backup written by needle-rig 9\.1\.0, format 2; needle-rig {VERSION} reads up to 1"
    with pytest.raises(BadInput, match=says):
        restore(place, path)


def test_a_rig_file_that_this_version_cannot_use_is_refused_with_its_line(
    place: Installation, tmp_path: Path
) -> None:
    good = place.rig_file.read_bytes()
    put(place.rig_file, good + b"new_key: 1\n")
    packed = back_up(place, tmp_path / "rig.zip", with_runs=False)
    assert "new_key" in packed.told[0]
    put(place.rig_file, good)
    with pytest.raises(BadInput, match=r"rig/rig\.yaml:\d+:1: new_key: .*nothing was changed"):
        restore(place, tmp_path / "rig.zip")
    assert place.rig_file.read_bytes() == good


def test_a_model_that_lies_elsewhere_is_kept_and_told(place: Installation, tmp_path: Path) -> None:
    model = put(tmp_path / "home/model.yaml", b"a model")
    text = place.rig_file.read_text(encoding="utf-8")
    put(place.rig_file, text.replace("reference_runs: 20", f"model: {model}").encode())
    packed = back_up(place, tmp_path / "rig.zip", with_runs=False)
    assert f"{model}: is in the backup, but restore does not put it back" in packed.told[0]
    model.unlink()
    back = restore(place, tmp_path / "rig.zip")
    assert f"{model}: is in the backup, but was not put back" in back.told[0]
    assert not model.exists()


def test_odd_files_are_told_and_a_pipe_does_not_hang_it(place: Installation, tmp_path: Path) -> None:
    os.mkfifo(place.rig_file.parent / "pipe")
    (place.rig_file.parent / "elsewhere").symlink_to(tmp_path)
    packed = back_up(place, tmp_path / "rig.zip", with_runs=False)
    assert sorted(sentence.partition(": ")[2] for sentence in packed.told) == [
        "is a link to a folder, which is not kept",
        "is no file that can be kept",
    ]


def test_a_backup_into_the_folder_that_is_packed_does_not_hold_itself(place: Installation) -> None:
    path = place.rig_file.parent / "rig.zip"
    assert back_up(place, path, with_runs=False).files == 3
    assert sorted(each.name for each in place.rig_file.parent.iterdir()) == [
        "calibration",
        "models",
        "rig.yaml",
        "rig.zip",
    ]


def test_what_is_there_is_not_overwritten(place: Installation, tmp_path: Path) -> None:
    put(tmp_path / "rig.zip", b"precious")
    with pytest.raises(BadInput, match="exists already"):
        back_up(place, tmp_path / "rig.zip", with_runs=False)
    assert (tmp_path / "rig.zip").read_bytes() == b"precious"


def test_a_killed_restore_leaves_the_rig_as_it_was(
    place: Installation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    back_up(place, tmp_path / "rig.zip", with_runs=True)
    put(place.rig_file, place.rig_file.read_bytes() + b"# changed\n")
    before = contents(place.root)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(backup, "_exchange", killed)
    with pytest.raises(KeyboardInterrupt):
        restore(place, tmp_path / "rig.zip")
    assert contents(place.root) == before


@pytest.fixture
def small_disk(tmp_path: Path) -> Path:
    """A disk of 64 kB."""
    disk = tmp_path / "disk"
    disk.mkdir()
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", disk], capture_output=True)
    if mounted.returncode:
        pytest.skip("a small disk needs the right to mount one")
    return disk


@pytest.mark.parametrize("kind", ["backup", "restore"])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(
    place: Installation, tmp_path: Path, small_disk: Path, kind: str
) -> None:
    try:
        put(place.runs / "long.h5", os.urandom(100_000))
        if kind == "backup":
            with pytest.raises(NeedleRigError, match="No space left on device; make room"):
                back_up(place, small_disk / "rig.zip", with_runs=True)
            assert list(small_disk.iterdir()) == []
        else:
            back_up(place, tmp_path / "rig.zip", with_runs=True)
            there = Installation(small_disk)
            put(there.rig_file, b"as it was")
            with pytest.raises(NeedleRigError, match="No space left on device; make room"):
                restore(there, tmp_path / "rig.zip")
            assert contents(small_disk) == {"etc/needle-rig/rig.yaml": b"as it was"}
    finally:
        subprocess.run(["umount", small_disk], check=True)


def test_the_commands_say_what_they_did(
    place: Installation, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = str(tmp_path / "rig.zip")
    assert run(["backup", path, "--root", str(place.root)]) == 0
    assert "3 files" in (said := capsys.readouterr().out)
    assert "the runs are not in it" in said
    shutil.rmtree(place.root)
    assert run(["restore", path, "--root", str(place.root)]) == 0
    assert f"the rig file is {place.rig_file}" in (said := capsys.readouterr().out)
    assert "Next: needle-rig install-service" in said
    assert run(["backup", path, "--root", str(tmp_path / "none")]) == 2
    assert "no rig is set up here" in capsys.readouterr().err
    assert run(["restore", str(tmp_path / "none.zip")]) == 2
    assert "cannot be read: No such file" in capsys.readouterr().err


def test_a_file_that_goes_while_others_are_packed_is_left_out(
    place: Installation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(place.runs / ".watch/a.new", b"of a watch that writes just now")
    found = backup._files

    def going(top: Path, left_out: list[str]) -> Iterator[Path]:
        for source in found(top, left_out):
            if source.suffix == ".new":
                source.unlink()
            yield source

    monkeypatch.setattr(backup, "_files", going)
    packed = back_up(place, tmp_path / "rig.zip", with_runs=True)
    assert (packed.files, packed.runs) == (6, 2)
    restore(Installation(tmp_path / "new"), tmp_path / "rig.zip")


def test_a_file_that_grows_while_it_is_packed_is_whole_as_far_as_it_was_read(tmp_path: Path) -> None:
    source = put(tmp_path / "file", b"x" * 10)
    with archive.packing(tmp_path / "a.zip", "report", {}) as pack:
        pack.add("file", source)
        put(source, b"y" * 20)
    with archive.packed(tmp_path / "a.zip", "report") as opened:
        (entry,) = opened.entries
        opened.take(entry, tmp_path / "out")
    assert (tmp_path / "out").read_bytes() == b"x" * 10
