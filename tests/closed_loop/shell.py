"""Runs `needle-rig` as a person does, and knows every process that it starts."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import sys
import tempfile
import uuid
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[2]
PROGRAM = (sys.executable, "-m", "needle_rig")
MARK = "NEEDLE_RIG_TEST_MARK"


@dataclass
class Shell:
    """A working folder, and an environment by which every process of the test can be told."""

    folder: Path
    mark: str = field(default_factory=lambda: uuid.uuid4().hex)
    temporary: str = field(default_factory=tempfile.gettempdir)

    @property
    def environment(self) -> dict[str, str]:
        known = {name: value for name, value in os.environ.items() if name != "NOTIFY_SOCKET"}
        return {
            **known,
            "PYTHONPATH": str(ROOT),
            "TMPDIR": self.temporary,
            "XDG_RUNTIME_DIR": str(self.folder / "run"),
            MARK: self.mark,
        }

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [*PROGRAM, *arguments],
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=110,
        )

    @contextmanager
    def start(self, *arguments: str, before: Sequence[str] = ()) -> Iterator[subprocess.Popen[str]]:
        # of tests that run under nohup a child would inherit that a closed terminal is ignored
        hangup = signal.signal(signal.SIGHUP, signal.SIG_DFL)
        try:
            process = subprocess.Popen(
                [*before, *PROGRAM, *arguments],
                cwd=self.folder,
                env=self.environment,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        finally:
            signal.signal(signal.SIGHUP, hangup)
        try:
            yield process
        finally:
            process.kill()
            process.communicate()

    def processes(self) -> dict[int, str]:
        """Command lines of the processes of this test that live now, by id."""
        found = {}
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                if f"{MARK}={self.mark}".encode() in (folder / "environ").read_bytes():
                    found[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
            except OSError:
                continue
        return found

    def compensate(self, *arguments: str) -> dict[str, Any]:
        done = self.run("compensate", "--target", "45", "--json", *arguments)
        assert done.returncode == 0, done.stderr
        result: dict[str, Any] = json.loads(done.stdout)
        return result


def all_gone(processes: dict[int, str], within_s: float = 20.0) -> None:
    """Wait until these have ended; those that have not are named."""
    for pid, line in processes.items():
        try:
            descriptor = os.pidfd_open(pid)
        except ProcessLookupError:
            continue
        try:
            assert select.select([descriptor], [], [], within_s)[0], f"still there: {line}"
        finally:
            os.close(descriptor)


def wait_for_line(process: subprocess.Popen[str], wanted: Callable[[str], bool]) -> str:
    assert process.stderr is not None
    for line in process.stderr:
        if wanted(line):
            return line
    raise AssertionError(f"it ended without saying so (exit {process.wait()})")
