"""What a daemon leaves for the next one to tell: since when it ran, and how it ended."""

from __future__ import annotations

import datetime
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Self

from needle_rig.service.installed.systemd import LOG

_NAME = ".daemon.json"
_ENDING = ".ending"
"""Written by the unit after every end: systemd's SERVICE_RESULT, EXIT_CODE and EXIT_STATUS."""
_LIMIT_BYTES = 4096
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


class Logbook:
    """The daemons of one service, one at a time; without a folder nothing is kept."""

    def __init__(self, folder: Path | None, boot_id: str | None = None) -> None:
        self._folder = folder
        self._boot_id = _read(_BOOT_ID).strip() if boot_id is None else boot_id
        self.since_utc = ""
        """When this daemon began."""
        self.before = ""
        """How the one before ended; empty where none was."""

    @classmethod
    def of_service(cls, environment: Mapping[str, str] = os.environ) -> Self:
        """That of the folder which systemd gives a service; without one for a daemon started by hand."""
        folder = environment.get("STATE_DIRECTORY")
        return cls(Path(folder.split(":")[0]) if folder else None)

    def begin(self) -> None:
        """A daemon starts."""
        self.since_utc = _now()
        if self._folder is not None and (before := _document(self._folder / _NAME)):
            self.before = _told(before, _read(self._folder / _ENDING), self._boot_id)
        self._write({"since_utc": self.since_utc, "boot_id": self._boot_id})

    def end(self, how: str) -> None:
        """It ends in order, for a reason."""
        self._write(
            {"since_utc": self.since_utc, "boot_id": self._boot_id, "ended_utc": _now(), "how": how[:300]}
        )

    @property
    def last_end(self) -> str:
        """How the newest daemon of this folder ended; empty while it runs, or where it said nothing."""
        return "" if self._folder is None else _document(self._folder / _NAME).get("how", "")

    def _write(self, document: dict[str, str]) -> None:
        if self._folder is None:
            return
        made = self._folder / f"{_NAME}.new"
        with suppress(OSError):  # a full disk must not keep a daemon from starting or ending
            self._folder.mkdir(parents=True, exist_ok=True)
            made.write_text(json.dumps(document), encoding="utf-8")
            made.replace(self._folder / _NAME)
        # what systemd wrote of the one before is reported now
        with suppress(OSError):
            (self._folder / _ENDING).unlink()


def _told(before: dict[str, str], ending: str, boot_id: str) -> str:
    """The end of the daemon before, in one sentence."""
    if "how" in before:
        return f"{before.get('ended_utc', '')}: {before['how']}"
    since = f"the daemon of {before.get('since_utc', '')}"
    if before.get("boot_id") != boot_id:
        return f"{since} ended with its computer: a power cut, or a restart that did not let it end"
    result, code, status = [*ending.split(), "", "", ""][:3]
    if result == "watchdog":
        return f"{since} was ended by its watchdog: it hung, or its ticks came late; {LOG}"
    if result in ("signal", "core-dump"):
        return f"{since} was killed (signal {status}); {LOG}"
    if result == "timeout":
        return f"{since} did not start or end in time; {LOG}"
    if code == "exited" and status != "0":
        return f"{since} failed (exit {status}); {LOG}"
    return f"{since} ended without a word; {LOG} may know why"


def _document(path: Path) -> dict[str, str]:
    with suppress(ValueError):
        found = json.loads(_read(path))
        if isinstance(found, dict):
            return {str(key): str(value) for key, value in found.items()}
    return {}


def _read(path: Path) -> str:
    """At most a few lines; empty where there is nothing to be read."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return ""
    with os.fdopen(descriptor, "rb") as file, suppress(OSError):
        return file.read(_LIMIT_BYTES).decode("utf-8", "replace")
    return ""


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
