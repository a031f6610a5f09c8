"""Another version for the service, and the way back: each version in a folder of its own, side by side.

`/opt/needle-rig/VERSION` holds an environment, the link `current` names the one that unit and command use,
and `previous` the one before it. To switch is to exchange one link: after a power cut at any instant the
computer starts with one version or the other.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.service.client import find_daemon
from needle_rig.service.installed.installation import Installation
from needle_rig.service.installed.systemd import LOG, UNIT
from needle_rig.service.setup.backup import back_up, refuse_over_a_run

Tell = Callable[[str], None]

_WHOLE = ".whole"
"""In an environment whose installation came to its end."""
_REST_S = 3600.0
_START_S = 600.0
"""The first start of a version compiles the needle's equations."""
_CHECK_S = 120.0
_LINKS_S = 30.0
"""A rig that is on is found within seconds of a start."""
_AGAIN_S = 1.0
_WHEEL = re.compile(r"needle_rig-([0-9][A-Za-z0-9.+!]*)-.*\.whl")
_VERSION = re.compile(r"[0-9][A-Za-z0-9.+!]*")


@dataclass(frozen=True)
class Versions:
    """The environments of a computer's service."""

    folder: Path

    @property
    def current(self) -> Path | None:
        """The environment that the service uses; None before the first upgrade."""
        return self._named("current")

    @property
    def previous(self) -> Path | None:
        """The one before it."""
        return self._named("previous")

    @property
    def python(self) -> Path:
        """The interpreter of the environment that the service uses, by its lasting name."""
        return self.folder / "current/bin/python"

    def _named(self, name: str) -> Path | None:
        link = self.folder / name
        return link.resolve() if link.is_symlink() and link.is_dir() else None

    def switch(self, to: Path, back_to: Path) -> None:
        """Let `current` be `to` in one step, and `previous` be `back_to`."""
        for name, target in (("previous", back_to), ("current", to)):
            made = self.folder / f".{name}.new"
            made.unlink(missing_ok=True)
            made.symlink_to(target)
            made.replace(self.folder / name)


def versions_of(place: Installation) -> Versions:
    """Those of the service that is set up at `place`."""
    return Versions(place.root / "opt/needle-rig")


def upgrade(place: Installation, wanted: str, tell: Tell) -> None:
    """Let the service run `wanted`, a wheel or a version, and go back where more fails than before.

    A run that goes on is waited for. Raises BadInput before anything is changed, and RigFault when the old
    version runs again.
    """
    versions, old = versions_of(place), _in_use(place)
    version, requirement = _wanted(wanted)
    new = versions.folder / version
    if new.resolve() == old:
        raise BadInput(f"--upgrade {wanted}: the service runs {version} already")
    with _alone(versions):
        tell(f"install {requirement} in {new}")
        _install(new, requirement)
        _refuse_unusable(new, version, place)
        backup = (
            versions.folder / "backups" / f"{datetime.now(UTC):%Y-%m-%d_%H-%M-%S.%fZ}-before-{version}.zip"
        )
        backup.parent.mkdir(exist_ok=True)
        back_up(place, backup, with_runs=False)
        tell(f"backup {backup}")
        _change(place, versions, old, new, tell)
    tell(f"The service runs {version}. Back to the version before: needle-rig install-service --rollback")


def roll_back(place: Installation, tell: Tell) -> None:
    """Let the service run the version before the present one; raises as `upgrade`."""
    versions, now = versions_of(place), _in_use(place)
    old = versions.previous
    if old is None or old == now:
        raise BadInput(
            f"--rollback: there is no version before {now.name}; needle-rig install-service --upgrade"
        )
    with _alone(versions):
        _refuse_unusable(old, None, place)
        _change(place, versions, now, old, tell)
    tell(f"The service runs the version in {old}.")


def _change(place: Installation, versions: Versions, old: Path, new: Path, tell: Tell) -> None:
    """Switch to `new`, and back to `old` where that fails in any way."""
    failed_before, before_old = _failures(old), versions.previous or old
    try:
        _use(place, versions, new, old, tell)
        reason = _worse(new, failed_before)
    except NeedleRigError as error:
        reason = str(error)
    except BaseException:
        _use(place, versions, old, before_old, tell)
        raise
    if reason:
        tell(f"{new.name} fails ({reason}); back to {old.name}")
        _use(place, versions, old, before_old, tell)
        raise RigFault(f"{new.name} was taken back: {reason}; the service runs as before; its log: {LOG}")


def _use(place: Installation, versions: Versions, new: Path, old: Path, tell: Tell) -> None:
    """Switch the link, let that version write unit and command, and start it when nothing moves."""
    versions.switch(new, old)
    _run([str(versions.python), "-m", "needle_rig", "install-service", "--no-start"], _CHECK_S)
    with _at_rest(place, tell):
        _run(["systemctl", "restart", UNIT], _START_S)


def _worse(environment: Path, failed_before: Mapping[str, str]) -> str:
    """What fails that did not fail before, when the links had time to open; empty where nothing does."""
    end_s = time.monotonic() + _LINKS_S
    while True:
        failed = _failures(environment)
        worse = "; ".join(f"{name}: {text}" for name, text in failed.items() if name not in failed_before)
        if not worse or time.monotonic() > end_s:
            return worse
        time.sleep(_AGAIN_S)


@contextmanager
def _alone(versions: Versions) -> Iterator[None]:
    """Keep a second one from changing the versions meanwhile. Raises BadInput where one does."""
    versions.folder.mkdir(parents=True, exist_ok=True)
    with open(versions.folder / ".lock", "w", encoding="ascii") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BadInput(f"{versions.folder}: another upgrade goes on; wait for its end") from None
        yield


def _in_use(place: Installation) -> Path:
    """The environment of the unit's program. Raises BadInput where no service is set up."""
    program = place.program
    if program is None or not place.rig_file.exists():
        raise BadInput("no service is set up here; needle-rig install-service")
    return program.parent.parent.resolve()


def _wanted(wanted: str) -> tuple[str, str]:
    """Version and pip's requirement of a wheel or a version."""
    path = Path(wanted)
    if path.suffix == ".whl":
        found = _WHEEL.fullmatch(path.name)
        if found is None or not path.is_file():
            raise BadInput(f"--upgrade {wanted}: is no wheel of needle-rig that is there")
        return found[1], str(path.absolute())
    if not _VERSION.fullmatch(wanted):
        raise BadInput(f"--upgrade {wanted}: give a wheel (needle_rig-VERSION-….whl) or a version")
    return wanted, f"needle-rig=={wanted}"


def _install(new: Path, requirement: str) -> None:
    """Make the environment, unless it is there as a whole; one that was cut off is made anew."""
    if (new / _WHOLE).exists():
        return
    shutil.rmtree(new, ignore_errors=True)
    try:
        _run([sys.executable, "-m", "venv", str(new)], None)
        _run([str(new / "bin/python"), "-m", "pip", "install", "--quiet", requirement], None)
        (new / _WHOLE).touch()
    except BaseException:
        shutil.rmtree(new, ignore_errors=True)
        raise


def _refuse_unusable(new: Path, version: str | None, place: Installation) -> None:
    """Raise BadInput where this environment is of another version, or cannot read the rig file."""
    program = str(new / "bin/needle-rig")
    said = _run([program, "--version"], _CHECK_S).split()[-1:]
    if version is not None and said != [version]:
        raise BadInput(f"{program}: is of version {' '.join(said)}, not {version}; nothing was changed")
    read = "import sys; from needle_rig.config.loader import load_rig_config; load_rig_config(sys.argv[1])"
    try:
        _run([str(new / "bin/python"), "-c", read, str(place.rig_file)], _CHECK_S)
    except NeedleRigError as error:
        why = str(error).rpartition("BadInput: ")[2]
        raise BadInput(f"{' '.join(said)} cannot use the rig file: {why}; nothing was changed") from None


def _failures(environment: Path) -> dict[str, str]:
    """What `check` of this version finds to fail, by name."""
    command = [str(environment / "bin/needle-rig"), "check", "--json"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_CHECK_S)
        findings = json.loads(done.stdout)["findings"]
        return {each["name"]: each["text"] for each in findings if each["verdict"] == "fail"}
    except (OSError, subprocess.TimeoutExpired, ValueError, LookupError) as error:
        return {"check": f"it did not say what it found ({type(error).__name__})"}


@contextmanager
def _at_rest(place: Installation, tell: Tell) -> Iterator[None]:
    """Wait until nothing moves, and keep others from commanding the rig meanwhile."""
    end_s, told = time.monotonic() + _REST_S, ""
    with contextlib.ExitStack() as held:
        while True:
            try:
                refuse_over_a_run(place.runs_directory() or place.runs)
                if (client := find_daemon()) is not None:
                    held.enter_context(client.lease("an upgrade"))
                break
            except RigFault:  # it does not answer: nothing waits for its restart
                break
            except BadInput as reason:
                if time.monotonic() > end_s:
                    raise
                if told != str(reason):
                    told = str(reason)
                    tell(f"wait: {told}")
                time.sleep(_AGAIN_S)
        yield


def _run(command: Sequence[str], timeout_s: float | None) -> str:
    shown = " ".join(command)
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s)
    except FileNotFoundError:
        raise NeedleRigError(f"{shown}: there is no {command[0]}") from None
    except subprocess.TimeoutExpired:
        raise NeedleRigError(f"{shown}: did not end within {timeout_s:g} s") from None
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split())[-400:]
        raise NeedleRigError(f"{shown}: failed (exit {done.returncode}): {said}")
    return done.stdout
