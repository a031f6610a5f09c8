"""One file that holds others: a ZIP archive with a list of what is in it, each with its SHA-256.

It is written whole or not at all. What is taken out of it is held against the list before anything is put in
place.
"""

from __future__ import annotations

import errno
import hashlib
import io
import json
import os
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from pydantic import TypeAdapter

from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.places import Places, show_path
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.folders import temporary_folder
from needle_rig.version import VERSION

_LIST = "contents.json"
_LIST_BYTES = 64_000_000
_CHUNK_BYTES = 1 << 20
_NO_DATE = (1980, 1, 1, 0, 0, 0)
_KEPT_MODE = 0o777
_BROKEN = (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError)
"""What a member that is damaged, encrypted or packed in another way raises."""
_FORMAT = "needle-rig-{kind}/1"


@dataclass(frozen=True)
class Entry:
    """One file in the archive."""

    name: str
    """Its place there, with forward slashes."""
    size_bytes: int
    sha256: str
    mode: int


_ENTRIES = TypeAdapter(list[Entry])


class Packing:
    """An archive that is being written."""

    def __init__(self, into: zipfile.ZipFile) -> None:
        self._into = into
        self.entries: list[Entry] = []
        """What is in it so far."""

    def add(self, name: str, source: Path) -> None:
        """Copy a file in as it is now; raises BadInput for one that cannot be read.

        One that is gone by now, as a file that was written anew or a run that was too old, is left out.
        """
        try:
            descriptor = os.open(source, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except FileNotFoundError:
            return
        except OSError as error:
            raise BadInput(f"{show_path(source)}: cannot be read: {error.strerror}; run it as root") from None
        with os.fdopen(descriptor, "rb") as file:
            self._copy(name, file, os.fstat(descriptor).st_mode & _KEPT_MODE)

    def add_text(self, name: str, text: str) -> None:
        """Write a text in."""
        self._copy(name, io.BytesIO(text.encode("utf-8", "replace")), 0o644)

    def _copy(self, name: str, file: IO[bytes], mode: int) -> None:
        told = zipfile.ZipInfo(name, _NO_DATE)
        told.compress_type = zipfile.ZIP_DEFLATED
        told.external_attr = mode << 16
        digest, size_bytes = hashlib.sha256(), 0
        with self._into.open(told, "w", force_zip64=True) as member:
            while chunk := file.read(_CHUNK_BYTES):
                digest.update(chunk)
                size_bytes += len(chunk)
                member.write(chunk)
        self.entries.append(Entry(name, size_bytes, digest.hexdigest(), mode))

    def close(self, kind: str, about: Mapping[str, str]) -> None:
        """Write the list, which makes the archive whole."""
        files = [vars(entry) for entry in self.entries]
        content = {"format": _FORMAT.format(kind=kind), "version": VERSION, **about, "files": files}
        self._into.writestr(zipfile.ZipInfo(_LIST, _NO_DATE), json.dumps(content, indent=1))


@contextmanager
def packing(path: Path, kind: str, about: Mapping[str, str]) -> Iterator[Packing]:
    """An archive of this `kind` to be filled; it appears at `path` when the block ends, and only then.

    Raises BadInput where something is at `path` already, and NeedleRigError for a disk that is full.
    """
    if os.path.lexists(path):
        raise BadInput(f"{show_path(path)}: exists already; name another file")
    with _told(path), temporary_folder(".needle-rig-packing-", path.absolute().parent) as folder:
        made = folder / path.name
        with open(made, "w+b", opener=_private) as file:
            with zipfile.ZipFile(file, "w", compresslevel=1) as into:
                archive = Packing(into)
                yield archive
                archive.close(kind, about)
            file.flush()
            os.fsync(file.fileno())
        os.replace(made, path)


class Packed:
    """An archive that is read; `about` is its list without the files."""

    def __init__(self, path: Path, file: zipfile.ZipFile, kind: str) -> None:
        self._path, self._file = path, file
        self.about = self._read_list(kind)
        self.entries = _ENTRIES.validate_python(self.about.pop("files"))
        listed = [entry.name for entry in self.entries]
        if sorted([*listed, _LIST]) != sorted(file.namelist()):
            raise self.damaged("it holds other files than it lists")

    def _read_list(self, kind: str) -> dict[str, Any]:
        try:
            member = self._file.getinfo(_LIST)
            if member.file_size > _LIST_BYTES:
                raise ValueError(_LIST)
            content = json.loads(self._file.read(member))
            writer, places = content["version"], Places(show_path(self._path))
            content = as_read_here(content, places, _FORMAT.format(kind=kind), writer=writer)
            for entry in _ENTRIES.validate_python(content["files"]):
                _check_name(entry.name)
        except (KeyError, TypeError, ValueError, *_BROKEN):
            raise self.damaged("its list of files cannot be read") from None
        found: dict[str, Any] = content
        return found

    def damaged(self, why: str) -> BadInput:
        """The error for an archive that is not as it was written."""
        return BadInput(f"{show_path(self._path)}: is damaged: {why}; take another backup")

    def text(self, name: str) -> str:
        """A text file of the archive."""
        return self._file.read(name).decode("utf-8", "replace")

    def take(self, entry: Entry, target: Path) -> None:
        """Write one file to `target` and the disk; raises BadInput when it is not the one that was packed."""
        digest, size_bytes = hashlib.sha256(), 0
        with _told(target), open(target, "xb") as file:
            try:
                with self._file.open(entry.name) as member:
                    # a byte more than was packed shows that it is another
                    while size_bytes <= entry.size_bytes and (chunk := member.read(_CHUNK_BYTES)):
                        digest.update(chunk)
                        size_bytes += len(chunk)
                        file.write(chunk)
            except _BROKEN:
                raise self.damaged(f"{entry.name} cannot be unpacked") from None
            if (size_bytes, digest.hexdigest()) != (entry.size_bytes, entry.sha256):
                raise self.damaged(f"{entry.name} is not the file that was packed")
            file.flush()
            os.fchmod(file.fileno(), entry.mode & _KEPT_MODE)
            os.fsync(file.fileno())


@contextmanager
def packed(path: Path, kind: str) -> Iterator[Packed]:
    """The archive of this `kind` at `path`; raises BadInput for anything else."""
    try:
        with zipfile.ZipFile(path) as file:
            yield Packed(path, file, kind)
    except zipfile.BadZipFile:
        raise BadInput(f"{show_path(path)}: is no {kind} of needle-rig, or was cut off") from None
    except OSError as error:
        if error.filename is not None and Path(error.filename) == path:
            raise BadInput(f"{show_path(path)}: cannot be read: {error.strerror}") from None
        raise


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _check_name(name: str) -> None:
    """Raises ValueError for a name that would lead out of the folder that it is unpacked in."""
    parts = name.split("/")
    if not all(parts) or {".", ".."} & set(parts) or "\\" in name or "\0" in name:
        raise ValueError(name)


def _private(path: str, flags: int) -> int:
    """Runs and configuration are for those who may read them already."""
    return os.open(path, flags | os.O_CLOEXEC, 0o640)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tells an OSError of what is written at `path` in one sentence."""
    try:
        yield
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            next_step = "make room, or name another place"
        else:
            next_step = "name another place, or run it as root"
        raise NeedleRigError(f"{show_path(path)}: cannot be written: {error.strerror}; {next_step}") from None
