"""What somebody who was not there needs to find a fault of a rig: collected into one file for an issue.

Values that look like secrets are left out of every text; the last run is left out where its rig file has one.
"""

from __future__ import annotations

import json
import platform
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from importlib.metadata import distributions
from pathlib import Path

from needle_rig.errors import NeedleRigError
from needle_rig.recording import RunFile, list_runs
from needle_rig.service.client import find_daemon
from needle_rig.service.installed.installation import Installation
from needle_rig.service.installed.systemd import UNIT
from needle_rig.service.setup.archive import Packing, packing
from needle_rig.version import VERSION

KIND = "report"
LEFT_OUT = "(left out)"
_LOG_LINES = 5000
_TIMEOUT_S = 30.0
_CHECK_TIMEOUT_S = 90.0
_TEXT_BYTES = 1_000_000
_SECRET_NAME = r"[\w.-]*(?:passw|passphrase|secret|token|credential|api_?key|private_?key)[\w.-]*"
_SECRET = re.compile(rf"(?im)\b({_SECRET_NAME}[\"']?\s*[:=]\s*)[^\s,}}\]][^\n,}}\]]*")
_LOGIN = re.compile(r"(://)[^/\s:@]+:[^/\s@]+@")


def without_secrets(text: str) -> str:
    """`text` without the values of keys such as password and token, and without logins in addresses."""
    return _LOGIN.sub(rf"\1{LEFT_OUT}@", _SECRET.sub(rf"\1{LEFT_OUT}", text))


def write_report(place: Installation, path: Path, runs: Path | None) -> list[str]:
    """Collect it into `path`; returns a line for each file in it. `runs` is where the last run lies."""
    told: list[str] = []
    about = {"made_utc": datetime.now(UTC).isoformat(timespec="seconds"), "rig": platform.node()}
    with packing(path, KIND, about) as pack:
        for name, text in _texts(place):
            shown = without_secrets(text)
            pack.add_text(name, shown)
            note = ", values that look like secrets left out" if shown != text else ""
            told.append(f"{name}: {len(shown.splitlines())} lines{note}")
        if runs is not None:
            told.append(_add_run(pack, runs))
    return told


def _add_run(pack: Packing, runs: Path) -> str:
    last = next((run for run in reversed(list_runs(runs)) if run.complete), None)
    if last is None:
        return f"no run that ended lies in {runs}"
    try:
        config = str(RunFile(last.path).attributes.get("config", ""))
    except NeedleRigError as error:
        return f"the last run is left out: {error}"
    if without_secrets(config) != config:
        return f"the last run, {last.name}, is left out: its rig file holds what looks like a secret"
    pack.add(f"run/{last.path.name}", last.path)
    return f"run/{last.path.name}: {last.path.stat().st_size / 1e6:.3g} MB"


def _texts(place: Installation) -> Iterator[tuple[str, str]]:
    yield "versions.txt", _versions()
    yield "status.json", _status()
    if place.rig_file.exists():
        command = [sys.executable, "-m", "needle_rig", "check", "--json"]
        yield "check.json", _said(command, _CHECK_TIMEOUT_S)
    yield (
        "journal.txt",
        _said(["journalctl", "-u", UNIT, "-n", str(_LOG_LINES), "--no-pager", "-o", "short-iso"]),
    )
    yield "unit.txt", _said(["systemctl", "cat", UNIT]) + _said(["systemctl", "show", UNIT])
    yield "interfaces.txt", _said(["ip", "-details", "-statistics", "link", "show"])
    folder = place.rig_file.parent
    for source in sorted(folder.rglob("*")) if folder.is_dir() else ():
        if source.suffix in (".yaml", ".yml", ".py") and source.is_file():
            yield f"rig/{source.relative_to(folder).as_posix()}", _read(source)


def _versions() -> str:
    try:
        system = platform.freedesktop_os_release().get("PRETTY_NAME", "")
    except OSError:
        system = ""
    packages = sorted({f"{each.name} {each.version}" for each in distributions()}, key=str.lower)
    head = [f"needle-rig {VERSION} in {sys.prefix}", f"Python {platform.python_version()}"]
    head += [f"{platform.system()} {platform.release()} {platform.machine()}, {system}"]
    return "\n".join([*head, "", *packages, ""])


def _status() -> str:
    try:
        client = find_daemon()
        return "no daemon answers\n" if client is None else json.dumps(client.state(), indent=1) + "\n"
    except NeedleRigError as error:
        return f"{error}\n"


def _said(command: Sequence[str], timeout_s: float = _TIMEOUT_S) -> str:
    """What a command of the system says; why it says nothing, where it does not."""
    try:
        done = subprocess.run(command, capture_output=True, timeout=timeout_s, stdin=subprocess.DEVNULL)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"{' '.join(command)}: {error}\n"
    return (done.stdout + done.stderr).decode("utf-8", "replace")


def _read(source: Path) -> str:
    try:
        with open(source, "rb") as file:
            return file.read(_TEXT_BYTES).decode("utf-8", "replace")
    except OSError as error:
        return f"{source}: {error.strerror}\n"
