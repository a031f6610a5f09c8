"""Waiting for what still runs as the service's user, before the user is taken away."""

from __future__ import annotations

import os
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from needle_rig.errors import NeedleRigError
from needle_rig.service.setup.steps import AwaitProcesses, LeaveToAll

ENDING, OBEYING, STUBBORN = "games", "news", "uucp"
"""Accounts of Debian's base system, and nobody's in tests: one a test, as all processes of an account are
waited for, and tests run side by side."""

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root starts a process of another user")


@contextmanager
def running(account: str, script: str) -> Iterator[subprocess.Popen[bytes]]:
    """A shell of the account, reaped as soon as it ends, as init does with what a service leaves."""
    process = subprocess.Popen(["sh", "-c", f"{script}"], user=account, stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"ready\n"
    reaper = threading.Thread(target=process.wait)
    reaper.start()
    try:
        yield process
    finally:
        process.kill()
        reaper.join()
        process.stdout.close()


def test_it_waits_for_a_process_that_ends_by_itself() -> None:
    with running(ENDING, "echo ready; sleep 0.5") as process:
        step = AwaitProcesses(ENDING, patience_s=10.0)
        assert not step.is_done()
        step.do()
        assert step.is_done()
        assert process.wait(10) == 0


def test_what_goes_on_is_told_to_end() -> None:
    with running(OBEYING, "echo ready; exec sleep 60") as process:
        AwaitProcesses(OBEYING, patience_s=0.3).do()
        assert process.wait(10) == -15


def test_what_a_user_leaves_is_roots_and_readable_but_not_what_it_links_to(tmp_path: Path) -> None:
    other = tmp_path / "other"
    run = tmp_path / "runs/.read/run.h5"
    run.parent.mkdir(parents=True)
    for path in (other, run):
        path.write_text("")
        path.chmod(0o640)
        os.chown(path, 12345, 12345)
    (tmp_path / "runs/link").symlink_to(other)
    LeaveToAll(tmp_path / "runs").do()
    found = run.stat()
    assert (found.st_uid, found.st_gid, found.st_mode & 0o777) == (0, 0, 0o644)
    assert (other.stat().st_uid, other.stat().st_mode & 0o777) == (12345, 0o640)


def test_what_does_not_obey_is_named() -> None:
    with (
        running(STUBBORN, "trap '' TERM; echo ready; while :; do sleep 0.1; done"),
        pytest.raises(NeedleRigError, match=r"process \d+ of uucp still runs; kill -KILL"),
    ):
        AwaitProcesses(STUBBORN, patience_s=0.3).do()
