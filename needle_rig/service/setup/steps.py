"""What setting up and taking away a service is made of: steps that know whether they are done."""

from __future__ import annotations

import contextlib
import os
import pwd
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from needle_rig.errors import BadInput, NeedleRigError

_TIMEOUT_S = 60.0


class Step(Protocol):
    """One change of the system."""

    def describe(self) -> str:
        """What it does, for a person; lines of a file are indented."""

    def is_done(self) -> bool:
        """Whether nothing is left to do."""

    def do(self) -> None:
        """Do it; raises NeedleRigError in one sentence."""


@dataclass(frozen=True)
class WriteFile:
    """A text file of root's that everybody may read."""

    path: Path
    text: str

    def describe(self) -> str:
        """See Step."""
        return f"write {self.path}\n" + "".join(f"    {line}\n" for line in self.text.splitlines())

    def is_done(self) -> bool:
        """See Step."""
        try:
            return self.path.read_text(encoding="utf-8") == self.text
        except (OSError, ValueError):
            return False

    def do(self) -> None:
        """See Step."""
        with _told(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            made = self.path.with_name(f".{self.path.name}.new")
            made.write_text(self.text, encoding="utf-8")
            made.chmod(0o644)
            made.replace(self.path)


@dataclass(frozen=True)
class MakeLink:
    """A symbolic link; one to `instead_of` is changed, and what else stands at its place stays."""

    path: Path
    target: Path
    instead_of: Path | None = None

    def describe(self) -> str:
        """See Step."""
        return f"link  {self.path} → {self.target}"

    def is_done(self) -> bool:
        """See Step."""
        return os.path.lexists(self.path) and not (
            self.instead_of not in (None, self.target) and links_to(self.path, self.instead_of)
        )

    def do(self) -> None:
        """See Step."""
        with _told(self.path):
            self.path.parent.mkdir(parents=True, exist_ok=True)
            made = self.path.with_name(f".{self.path.name}.new")
            made.unlink(missing_ok=True)
            made.symlink_to(self.target)
            made.replace(self.path)


def links_to(path: Path, target: Path | None) -> bool:
    """Whether `path` is a symbolic link to `target`, there or not."""
    return path.is_symlink() and path.readlink() == target


@dataclass(frozen=True)
class Remove:
    """A file that is taken away."""

    path: Path

    def describe(self) -> str:
        """See Step."""
        return f"remove {self.path}"

    def is_done(self) -> bool:
        """See Step."""
        return not os.path.lexists(self.path)

    def do(self) -> None:
        """See Step."""
        with _told(self.path):
            self.path.unlink()


@dataclass(frozen=True)
class RemoveFolder:
    """A folder that is taken away with all that is in it."""

    path: Path

    def describe(self) -> str:
        """See Step."""
        return f"remove {self.path}/"

    def is_done(self) -> bool:
        """See Step."""
        return not os.path.lexists(self.path)

    def do(self) -> None:
        """See Step."""
        with _told(self.path):
            shutil.rmtree(self.path)


@dataclass(frozen=True)
class LeaveToAll:
    """Files whose owner is taken away: root's from now on, and readable for everybody."""

    folder: Path

    def describe(self) -> str:
        """See Step."""
        return f"leave {self.folder} to root, readable for everybody"

    def is_done(self) -> bool:
        """See Step."""
        return not os.path.lexists(self.folder)

    def do(self) -> None:
        """See Step."""
        with _told(self.folder):
            for path in (self.folder, *self.folder.rglob("*")):
                if path.is_symlink():
                    continue
                os.chown(path, 0, 0)
                readable = 0o555 if path.is_dir() else 0o444
                path.chmod((path.stat().st_mode & 0o777) | readable)


@dataclass(frozen=True)
class Rename:
    """A file that is kept under another name, in place of what had it."""

    path: Path
    new: Path

    def describe(self) -> str:
        """See Step."""
        return f"keep  {self.path} as {self.new}"

    def is_done(self) -> bool:
        """See Step."""
        return not os.path.lexists(self.path)

    def do(self) -> None:
        """See Step."""
        with _told(self.path):
            self.path.replace(self.new)


@dataclass(frozen=True)
class Run:
    """A command of the system; `done` tells whether it is needed."""

    command: Sequence[str]
    done: Callable[[], bool]

    def describe(self) -> str:
        """See Step."""
        return f"run   {' '.join(self.command)}"

    def is_done(self) -> bool:
        """See Step."""
        return self.done()

    def do(self) -> None:
        """See Step."""
        shown = " ".join(self.command)
        try:
            ended = subprocess.run(self.command, capture_output=True, text=True, timeout=_TIMEOUT_S)
        except FileNotFoundError:
            raise BadInput(
                f"{shown}: there is no {self.command[0]} here; this needs a Linux with systemd"
            ) from None
        except subprocess.TimeoutExpired:
            raise NeedleRigError(
                f"{shown}: did not end within {_TIMEOUT_S:g} s; look at: journalctl -xe"
            ) from None
        if ended.returncode:
            said = " ".join((ended.stderr or ended.stdout).split())[-400:]
            raise NeedleRigError(f"{shown}: failed (exit {ended.returncode}): {said}")


@dataclass(frozen=True)
class AwaitProcesses:
    """The end of what still runs as `account`: a recorder outlives its daemon until the run is closed.

    What goes on after `patience_s`, such as a watch over the runs, is ordered to end.
    """

    account: str
    patience_s: float = 20.0

    def describe(self) -> str:
        """See Step."""
        return f"wait  until no process of {self.account} runs"

    def is_done(self) -> bool:
        """See Step."""
        return not self._processes()

    def do(self) -> None:
        """See Step."""
        if self._ended_within(self.patience_s):
            return
        for process in self._processes():
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, signal.SIGTERM)
        if not self._ended_within(self.patience_s):
            left = self._processes()[0]
            raise NeedleRigError(
                f"process {left} of {self.account} still runs; kill -KILL {left}, then run this again"
            )

    def _ended_within(self, seconds: float) -> bool:
        end_s = time.monotonic() + seconds
        while (running := bool(self._processes())) and time.monotonic() < end_s:
            time.sleep(0.1)
        return not running

    def _processes(self) -> list[int]:
        try:
            owner = pwd.getpwnam(self.account).pw_uid
        except KeyError:
            return []
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if folder.stat().st_uid == owner:
                    found.append(int(folder.name))
        return sorted(found)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tells an OSError of what happens at `path` in one sentence."""
    try:
        yield
    except OSError as error:
        raise BadInput(
            f"{path}: cannot be changed: {error.strerror}; run it as root: sudo needle-rig install-service"
        ) from None
