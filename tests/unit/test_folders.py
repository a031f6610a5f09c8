import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from needle_rig.folders import temporary_folder

PREFIX = "needle-rig-test-"
HOLD = f"""
import sys
from needle_rig.folders import temporary_folder
with temporary_folder({PREFIX!r}) as folder:
    print(folder, flush=True)
    sys.stdin.read()
"""


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)


def test_it_is_its_owners_alone_and_gone_at_the_end(tmp_path: Path) -> None:
    with temporary_folder(PREFIX) as folder:
        assert folder.parent == tmp_path
        assert folder.stat().st_mode & 0o777 == 0o700
        (folder / "file").touch()
    assert not list(tmp_path.iterdir())


def test_what_a_killed_process_left_is_removed_and_what_a_living_one_holds_is_not(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", HOLD], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None
        theirs = Path(other.stdout.readline().strip())
        (theirs / "port").symlink_to("/dev/null")
        with temporary_folder(PREFIX):
            assert theirs.exists()
        os.kill(other.pid, signal.SIGKILL)
        other.wait()
    assert theirs.exists()
    with temporary_folder(PREFIX) as folder:
        assert list(tmp_path.iterdir()) == [folder]


def test_only_folders_are_taken_for_left_behind(tmp_path: Path) -> None:
    (tmp_path / "aim").mkdir()
    (tmp_path / f"{PREFIX}link").symlink_to(tmp_path / "aim")
    (tmp_path / f"{PREFIX}file").touch()
    with temporary_folder(PREFIX):
        pass
    assert {each.name for each in tmp_path.iterdir()} == {"aim", f"{PREFIX}link", f"{PREFIX}file"}
