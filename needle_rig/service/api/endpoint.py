"""The daemon's socket: where it is, who may use it, and that only one daemon holds it."""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from needle_rig.errors import BadInput, RigFault

_NAME = "daemon.sock"
_SYSTEM_FOLDER = Path("/run/needle-rig")
QUEUE = 1024
"""Connections that may wait to be accepted; a client that meets a full queue is turned away at once."""
_LAST_BREATH_S = 1.0
"""So long the children of a killed daemon may hold its socket."""
_PROBE_EVERY_S = 0.05


def socket_for_daemon(environment: Mapping[str, str] = os.environ) -> Path:
    """Where a daemon listens when it is not told: systemd's folder, the user's own, or the system's."""
    if folder := environment.get("RUNTIME_DIRECTORY"):
        return Path(folder.split(":")[0]) / _NAME
    if folder := environment.get("XDG_RUNTIME_DIR"):
        return Path(folder) / "needle-rig" / _NAME
    return _SYSTEM_FOLDER / _NAME


def private_socket(folder: Path) -> Path:
    """Where a daemon listens that one client starts for itself, in a folder of the client's."""
    return folder / "socket" / _NAME


def sockets_for_client(environment: Mapping[str, str] = os.environ) -> list[Path]:
    """Where a client looks for a daemon: first the user's own, then the system's."""
    folder = environment.get("XDG_RUNTIME_DIR")
    own = [Path(folder) / "needle-rig" / _NAME] if folder else []
    return [*own, _SYSTEM_FOLDER / _NAME]


@contextmanager
def listening(path: Path, group: str | None) -> Iterator[socket.socket]:
    """A listening Unix socket at `path`, for its owner and `group` only (mode 0660); removed at the end.

    A socket that a killed daemon left behind is replaced. Raises RigFault when another daemon holds it and
    BadInput when the place or the group cannot be used.
    """
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        try:
            path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
            with _folder_alone(path.parent):
                _make_room(path)
                before = os.umask(0o117)
                try:
                    listener.bind(str(path))
                finally:
                    os.umask(before)
                made = Made.at(path)
                listener.listen(QUEUE)
        except OSError as error:
            raise BadInput(
                f"{path}: cannot make the daemon's socket ({error.strerror or error}); choose --socket"
            ) from None
        listener.setblocking(False)
        try:
            if group is not None:
                _give_to_group(path, group)
            yield listener
        finally:
            made.remove()
    finally:
        listener.close()


@dataclass(frozen=True)
class Made:
    """A socket's file, told from others that stand at the same place later, which may get the same inode."""

    path: Path
    device: int
    inode: int
    made_ns: int

    @classmethod
    def at(cls, path: Path) -> Made:
        """The file that stands at `path` now."""
        status = path.lstat()
        return cls(path, status.st_dev, status.st_ino, status.st_mtime_ns)

    def remove(self) -> None:
        """Remove it, unless another stands there now; safe to call twice."""
        with suppress(OSError), _folder_alone(self.path.parent):
            if Made.at(self.path) == self:
                self.path.unlink()


def _make_room(path: Path) -> None:
    """Remove a socket that nobody listens at; anything else at `path` stays."""
    deadline_s = time.monotonic() + _LAST_BREATH_S
    while True:
        try:
            if not stat.S_ISSOCK(path.lstat().st_mode):
                raise BadInput(f"{path}: is there already and is no socket; choose another --socket")
        except FileNotFoundError:
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.setblocking(False)
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
                return
            except OSError:  # a queue that is full, a socket of another type: somebody is there
                pass
        if time.monotonic() > deadline_s:
            raise RigFault(
                f"{path}: another daemon listens there; use it, stop it, or choose another --socket"
            )
        time.sleep(_PROBE_EVERY_S)


@contextmanager
def _folder_alone(folder: Path) -> Iterator[None]:
    """Nobody else makes or removes a socket in `folder` meanwhile; leaves no lock file behind.

    Raises OSError when another process holds the folder for longer than that takes.
    """
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        deadline_s = time.monotonic() + 3 * _LAST_BREATH_S
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() > deadline_s:
                    raise
            time.sleep(_PROBE_EVERY_S)
        yield
    finally:
        os.close(lock)


def _give_to_group(path: Path, group: str) -> None:
    try:
        shutil.chown(path, group=group)
    except LookupError:
        raise BadInput(f"group {group!r} does not exist; make it with `groupadd {group}`") from None
    except PermissionError:
        raise BadInput(
            f"{path}: you may not give it to group {group!r}, of which you are no member"
        ) from None
