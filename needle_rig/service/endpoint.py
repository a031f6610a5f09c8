"""The daemon's socket: where it is, who may use it, and that only one daemon holds it."""

from __future__ import annotations

import fcntl
import os
import shutil
import socket
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from needle_rig.errors import BadInput, RigFault

_NAME = "daemon.sock"
_SYSTEM_FOLDER = Path("/run/needle-rig")


def socket_for_daemon(environment: Mapping[str, str] = os.environ) -> Path:
    """Where a daemon listens when it is not told: systemd's folder, the user's own, or the system's."""
    if folder := environment.get("RUNTIME_DIRECTORY"):
        return Path(folder.split(":")[0]) / _NAME
    if folder := environment.get("XDG_RUNTIME_DIR"):
        return Path(folder) / "needle-rig" / _NAME
    return _SYSTEM_FOLDER / _NAME


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
    try:
        path.parent.mkdir(mode=0o755, parents=True, exist_ok=True)
        lock = os.open(path.with_name(path.name + ".lock"), os.O_CREAT | os.O_RDWR | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise BadInput(
            f"{path}: cannot make the daemon's socket ({error.strerror}); choose --socket"
        ) from None
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise RigFault(
                f"{path}: another daemon listens there; use it, stop it, or choose another --socket"
            ) from None
        path.unlink(missing_ok=True)
        before = os.umask(0o117)
        try:
            listener.bind(str(path))
        except OSError as error:
            raise BadInput(f"{path}: cannot make the daemon's socket ({error}); choose --socket") from None
        finally:
            os.umask(before)
        if group is not None:
            _give_to_group(path, group)
        listener.listen(16)
        listener.setblocking(False)
        yield listener
        path.unlink(missing_ok=True)
    finally:
        listener.close()
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
