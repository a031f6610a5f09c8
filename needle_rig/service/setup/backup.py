"""What is needed to have a rig again after its computer is lost: packed into one file, and put back.

A backup holds the folder of the rig file (`rig/`: rig file, calibration, models, devices of one's own), files
that the rig file names elsewhere (`elsewhere/`), and the runs if they are asked for (`runs/`). What
`needle-rig install-service` writes is not in it: that command writes it again.
"""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from needle_rig.config.files import parameters_path
from needle_rig.config.loader import load_rig_config, parse_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.folders import temporary_folder
from needle_rig.recording.journal import SUFFIX
from needle_rig.recording.liveness import being_written
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup.archive import Entry, Packed, packed, packing, sha256_of

KIND = "backup"
_RIG, _RUNS, _ELSEWHERE = "rig/", "runs/", "elsewhere/"
_RIG_FILE = f"{_RIG}rig.yaml"
_AT_WORKING_DIRECTORY, _EXCHANGE = -100, 2
"""AT_FDCWD and RENAME_EXCHANGE of renameat2(2)."""


@dataclass(frozen=True)
class Backed:
    """What went into a backup, or came out of it."""

    files: int
    runs: int
    size_bytes: int
    told: tuple[str, ...]
    """Sentences on what a person might miss."""


def back_up(place: Installation, path: Path, *, with_runs: bool) -> Backed:
    """Pack the rig of this computer into `path`; gives counts and bytes of what went in.

    Raises BadInput without a rig, or over a running run.
    """
    if not place.rig_file.is_file():
        raise BadInput(f"there is no {place.rig_file}: no rig is set up here; needle-rig install-service")
    left_out: list[str] = []
    try:
        config: RigConfig | None = load_rig_config(place.rig_file)
    except BadInput as error:
        # a rig file that is being worked on is worth keeping as well
        config = None
        left_out.append(f"the rig file cannot be used as it is: {error}")
    runs = place.runs if config is None else place.runs_of(config.recording.directory)
    if with_runs:
        refuse_over_a_run(runs)
    folder = place.rig_file.parent.resolve()
    about = {
        "made_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "rig": "" if config is None else config.name,
    }
    with packing(path, KIND, about) as pack:
        for prefix, top in ((_RIG, folder), *([(_RUNS, runs)] if with_runs else [])):
            for source in _files(top, left_out):
                pack.add(f"{prefix}{source.relative_to(top).as_posix()}", source)
        for source in _named_elsewhere(config, folder):
            pack.add(f"{_ELSEWHERE}{source.as_posix().lstrip('/')}", source)
            left_out.append(
                f"{source}: is in the backup, but restore does not put it back; better keep it in {folder}"
            )
    return _backed(pack.entries, left_out)


def restore(place: Installation, path: Path) -> Backed:
    """Put the rig of the backup at `path` in place: all of it, or nothing.

    Every file is unpacked beside its place and held against its hash before the first one is put there. The
    folder of the rig file is exchanged as a whole; what stood there is kept as `needle-rig.replaced`. A run
    that is there already stays. Raises BadInput for a damaged backup, for runs of the same name with other
    contents, and over a running run.
    """
    with packed(path, KIND) as pack:
        config = _usable(pack)
        runs = place.runs_of(config.recording.directory)
        refuse_over_a_run(runs)
        folder = place.rig_file.parent.resolve()
        with _beside(folder) as new_folder, _beside(runs) as new_runs:
            taken, kept = [], 0
            for entry in pack.entries:
                prefix, _, rest = entry.name.partition("/")
                if prefix == "elsewhere":
                    continue
                if prefix == "runs" and (there := runs / rest).exists():
                    if there.suffix == ".h5":
                        _refuse_another(there, entry)
                        kept += 1
                    continue
                target = (new_folder if prefix == "rig" else new_runs) / rest
                _make_folders(target.parent)
                pack.take(entry, target)
                taken.append(entry)
            refuse_over_a_run(runs)
            _exchange(new_folder, folder)
            _move_in(new_runs, runs)
    told = [f"{kept} runs of it were there already"] if kept else []
    told += [
        f"/{entry.name.removeprefix(_ELSEWHERE)}: is in the backup, but was not put back; unzip it from there"
        for entry in pack.entries
        if entry.name.startswith(_ELSEWHERE)
    ]
    return _backed(taken, told)


def _backed(entries: Sequence[Entry], told: Sequence[str]) -> Backed:
    runs = [entry for entry in entries if entry.name.startswith(_RUNS) and entry.name.endswith(".h5")]
    return Backed(len(entries), len(runs), sum(entry.size_bytes for entry in entries), tuple(told))


def _refuse_another(there: Path, entry: Entry) -> None:
    """Raise BadInput where the run that is there is not the one of this name in the backup."""
    if sha256_of(there) != entry.sha256:
        raise BadInput(f"{there}: is another run than the one of this name in the backup; move it away")


def refuse_over_a_run(runs: Path) -> None:
    """Raise BadInput while a run is being recorded in this folder."""
    for journal in sorted(runs.glob(f"*{SUFFIX}")):
        if being_written(journal.with_suffix(".h5")):
            raise BadInput(f"{journal.stem}: this run goes on; wait for its end, or: needle-rig stop")


def _usable(pack: Packed) -> RigConfig:
    """The rig of the backup, which this version must be able to read."""
    if _RIG_FILE not in {entry.name for entry in pack.entries}:
        raise pack.damaged("it has no rig file")
    for entry in pack.entries:
        if not entry.name.startswith((_RIG, _RUNS, _ELSEWHERE)):
            raise pack.damaged(f"it holds {entry.name}, which belongs to no rig")
    try:
        return parse_rig_config(pack.text(_RIG_FILE), _RIG_FILE)
    except BadInput as error:
        raise BadInput(
            f"{error}; the backup is of needle-rig {pack.about.get('version')}, nothing was changed"
        ) from None


def _files(top: Path, left_out: list[str]) -> Iterator[Path]:
    """Every regular file below `top`, links followed; others are listed in `left_out`."""
    if not top.is_dir():
        return
    for folder, names, files in os.walk(top, onerror=_unlistable):
        # what is being packed or unpacked
        names[:] = sorted(name for name in names if not name.startswith(".needle-rig-"))
        left_out += [f"{link}: is a link to a folder, which is not kept" for link in _links(folder, names)]
        for name in sorted(files):
            source = Path(folder, name)
            if source.is_file():
                yield source
            else:
                left_out.append(f"{source}: is no file that can be kept")


def _links(folder: str, names: list[str]) -> list[Path]:
    return [link for name in names if (link := Path(folder, name)).is_symlink()]


def _unlistable(error: OSError) -> None:
    raise BadInput(f"{error.filename}: cannot be listed: {error.strerror}; run it as root")


def _named_elsewhere(config: RigConfig | None, folder: Path) -> Iterator[Path]:
    """The model file that the rig file names, where it lies outside of the folder."""
    watch = None if config is None else config.recording.watch
    if watch is not None and watch.model is not None and os.sep in watch.model:
        named = parameters_path(watch.model)
        if named.is_file() and not named.resolve().is_relative_to(folder.resolve()):
            yield named.absolute()


@contextmanager
def _beside(place: Path) -> Iterator[Path]:
    """An empty folder beside `place`, on the same disk, that is gone at the end."""
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(".needle-rig-restore-", place.parent) as folder:
            new = folder / "new"
            new.mkdir()
            yield new
    except PermissionError as error:
        raise BadInput(
            f"{error.filename}: cannot be changed: {error.strerror}; sudo needle-rig restore"
        ) from None


def _move_in(new: Path, place: Path) -> None:
    """Move every file below `new` to the same place below `place`, for the owner of that folder."""
    place.mkdir(parents=True, exist_ok=True)
    owner = place.stat()
    for source in sorted(each for each in new.rglob("*") if each.is_file()):
        target = place / source.relative_to(new)
        if not target.parent.is_dir():
            target.parent.mkdir(parents=True)
            os.chown(target.parent, owner.st_uid, owner.st_gid)
        os.chown(source, owner.st_uid, owner.st_gid)
        source.replace(target)


def _make_folders(folder: Path) -> None:
    """Make it and what is above it, for everybody to enter whatever the umask is."""
    if not folder.is_dir():
        _make_folders(folder.parent)
        folder.mkdir()
        folder.chmod(0o755)


def _exchange(new: Path, place: Path) -> None:
    """Put the folder `new` at `place` in one step; what stood there is kept beside it."""
    new.chmod(0o755)
    if not place.exists():
        new.replace(place)
        return
    replaced = place.with_name(f"{place.name}.replaced")
    renameat2 = ctypes.CDLL(None, use_errno=True).renameat2
    names = [os.fsencode(each) for each in (new, place)]
    if renameat2(_AT_WORKING_DIRECTORY, names[0], _AT_WORKING_DIRECTORY, names[1], _EXCHANGE):
        reason = os.strerror(ctypes.get_errno())
        raise NeedleRigError(f"{place}: cannot be exchanged with what was unpacked: {reason}")
    shutil.rmtree(replaced, ignore_errors=True)
    new.replace(replaced)
