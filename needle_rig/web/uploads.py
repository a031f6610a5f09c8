"""Files that a person drops on the page: bounded in size, count and time, kept as data and nothing else."""

from __future__ import annotations

import asyncio
import errno
import re
import secrets
import shutil
import stat
import time
import zipfile
import zlib
from collections.abc import AsyncIterator, Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.recording import RunFile

FILE_BYTES = 64 << 20
"""A trial of ten minutes with six columns at 1000 samples a second has 40 MB as text."""
UPLOAD_BYTES = 256 << 20
FILES = 2000
DEPTH = 6
NAME_LETTERS = 120
UPLOAD_S = 60.0
"""So long one file may take to come; 64 MiB over loopback take a second."""
UNPACK_S = 30.0
UPLOADS = 20
_CHUNK_BYTES = 1 << 16
HEAD_BYTES = 4096
"""Of a YAML file in which its format is looked for; it is the first key of a file that was written here."""
_A_MODEL = re.compile(rb"^format:\s*['\"]?needle-rig-model/", re.MULTILINE)
SUFFIXES = frozenset(
    [
        ".csv",
        ".tsv",
        ".txt",
        ".dat",
        ".yaml",
        ".yml",
        ".h5",
        ".hdf5",
        ".mat",
        ".npz",
        ".npy",
        ".mcap",
        ".xlsx",
        ".xls",
        ".ods",
        ".db3",
        ".md",
        ".png",
        ".json",
        ".gz",
        ".bag",
        ".lvm",
        ".log",
        ".asc",
        ".blf",
        ".trc",
        ".dbc",
        ".tdms",
        ".mf4",
        ".mdf",
        ".parquet",
        ".feather",
        ".arrow",
        ".jsonl",
        ".ndjson",
        ".zip",
    ]
)
"""What a dataset, a run or a recording is made of. An effect's Python is no data and is never taken."""


_FULL = (errno.ENOSPC, errno.EDQUOT)


class TooMuch(BadInput):
    """More than is taken."""


class NoRoom(NeedleRigError):
    """The disk of this computer takes no more."""


@dataclass
class Upload:
    """One drop: a folder of its own, and how much has come."""

    name: str
    folder: Path
    bytes_taken: int = 0
    kind: str = "recording"
    """upload, for datasets or runs; model; or recording, of which it is not known yet what is what."""
    files: list[str] = field(default_factory=list)

    def place(self, path: str) -> Path:
        """Where the file of this relative path goes, below the folder; raises BadInput for any other path."""
        parts = PurePosixPath(path).parts
        shown = path[:NAME_LETTERS]
        if not parts or len(parts) > DEPTH or any(not _harmless(part) for part in parts):
            raise BadInput(
                f"{shown!r}: is no plain file name of up to {DEPTH} folders; rename it and drop it again"
            )
        suffix = PurePosixPath(path).suffix.lower()
        if suffix not in SUFFIXES:
            raise BadInput(
                f"{shown}: files that end in {suffix or 'nothing'} are not taken; give data"
                f" ({', '.join(sorted(SUFFIXES))})"
            )
        if len(self.files) >= FILES:
            raise TooMuch(f"{shown}: more than {FILES} files; drop one dataset at a time")
        return self.folder.joinpath(*parts)

    def count(self, taken: int, shown: str) -> None:
        """Count bytes that came; raises TooMuch past the limit of an upload."""
        self.bytes_taken += taken
        if self.bytes_taken > UPLOAD_BYTES:
            raise TooMuch(
                f"{shown}: this upload is larger than {UPLOAD_BYTES >> 20} MiB; drop less at a time"
            )


def _harmless(part: str) -> bool:
    plain = part not in ("", ".", "..", "/") and not part.startswith(".") and part.isprintable()
    return plain and len(part) <= NAME_LETTERS and not set(part) & set('/\\:*?"|')


class Uploads:
    """The newest uploads, below `folder`; `forgotten` hears the key of one that goes."""

    def __init__(self, folder: Path, forgotten: Callable[[str], None] = lambda _: None) -> None:
        self._folder, self._forgotten = folder, forgotten
        self._uploads: dict[str, Upload] = {}

    def begin(self, name: str) -> str:
        """A new, empty upload called `name`: its key."""
        while len(self._uploads) >= UPLOADS:
            # one that holds nothing goes before one that does, the oldest first
            self.forget(min(self._uploads, key=lambda one: bool(self._uploads[one].files)))
        key = secrets.token_hex(8)
        folder = self._folder / key / "data"
        folder.mkdir(parents=True)
        self._uploads[key] = Upload(
            "".join(c for c in name if c.isprintable())[:NAME_LETTERS] or "upload", folder
        )
        return key

    def restore(self, key: str, name: str, kind: str, files: list[str], bytes_taken: int) -> None:
        """One that an earlier server took, if its files are still there."""
        folder = self._folder / key / "data"
        if folder.is_dir():
            self._uploads[key] = Upload(name, folder, bytes_taken, kind, files)

    def forget(self, key: str) -> None:
        """Remove an upload with its files; raises BadInput."""
        folder = self.get(key).folder
        del self._uploads[key]
        shutil.rmtree(folder.parent, ignore_errors=True)
        self._forgotten(key)

    def all(self) -> dict[str, Upload]:
        """By key, the oldest first."""
        return dict(self._uploads)

    def get(self, key: str) -> Upload:
        """The upload of this key; raises BadInput."""
        if key not in self._uploads:
            raise BadInput("this upload is not there any more; drop the files again")
        return self._uploads[key]

    async def take(self, key: str, path: str, content: AsyncIterator[bytes]) -> None:
        """Write one file; a ZIP is unpacked and not kept. What is refused leaves nothing behind."""
        upload = self.get(key)
        place = upload.place(path)
        place.parent.mkdir(parents=True, exist_ok=True)
        if place.exists():
            raise BadInput(f"{path}: came already in this upload")
        try:
            async with asyncio.timeout(UPLOAD_S):
                with place.open("xb") as file:
                    size = 0
                    async for chunk in content:
                        size += len(chunk)
                        if size > FILE_BYTES:
                            raise TooMuch(f"{path}: is larger than {FILE_BYTES >> 20} MiB; thin it out first")
                        upload.count(len(chunk), path)
                        file.write(chunk)
            upload.files.append(path)
            if place.suffix.lower() == ".zip":
                await asyncio.to_thread(unpack, upload, place)
        except OSError as error:
            place.unlink(missing_ok=True)
            if isinstance(error, TimeoutError):
                raise TooMuch(f"{path}: did not come within {UPLOAD_S:g} s; drop it again") from None
            raise NoRoom(
                f"{path}: cannot be written ({error.strerror}); make room on this computer's disk"
            ) from None
        except BaseException:
            place.unlink(missing_ok=True)
            raise
        finally:
            upload.files[:] = [file for file in upload.files if upload.folder.joinpath(file).exists()]
        if place.suffix.lower() == ".zip":
            place.unlink()


def unpack(upload: Upload, path: Path) -> None:
    """Unpack a ZIP into its upload's folder, within an upload's limits, whatever its directory claims."""
    deadline_s = time.monotonic() + UNPACK_S
    written: list[Path] = []
    try:
        with zipfile.ZipFile(path) as packed:
            entries = [entry for entry in packed.infolist() if not entry.is_dir()]
            if len(entries) > FILES:
                raise TooMuch(f"{path.name}: holds {len(entries)} files, more than {FILES}; pack one dataset")
            for entry in entries:
                if stat.S_ISLNK(entry.external_attr >> 16) or entry.flag_bits & 1:
                    raise BadInput(
                        f"{path.name}: {entry.filename[:60]} is a link or encrypted; pack plain files"
                    )
                if _of_no_data(entry.filename):
                    continue
                place = upload.place(entry.filename)
                if place.suffix.lower() == ".zip":
                    raise BadInput(
                        f"{path.name}: holds another ZIP, {entry.filename[:60]}; unpack that first"
                    )
                place.parent.mkdir(parents=True, exist_ok=True)
                with packed.open(entry) as source, place.open("xb") as target:
                    written.append(place)
                    while chunk := source.read(_CHUNK_BYTES):
                        upload.count(len(chunk), path.name)
                        if time.monotonic() > deadline_s:
                            raise TooMuch(
                                f"{path.name}: takes longer than {UNPACK_S:g} s to unpack; pack less"
                            )
                        target.write(chunk)
                upload.files.append(entry.filename)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, FileExistsError, OSError) as error:
        _remove(written)
        if isinstance(error, OSError) and error.errno in _FULL:
            raise
        raise BadInput(f"{path.name}: cannot be unpacked ({type(error).__name__}); pack it again") from None
    except BadInput:
        _remove(written)
        raise


def _of_no_data(name: str) -> bool:
    """What packers of other systems add."""
    return name.startswith("__MACOSX/") or PurePosixPath(name).name in (".DS_Store", "Thumbs.db")


def _remove(paths: list[Path]) -> None:
    for path in paths:
        path.unlink(missing_ok=True)


def data_in(folder: Path) -> list[Path]:
    """The datasets (their folders) and run files below `folder`; empty where there is none."""
    named = {"dataset.yaml", "settled.yaml"}
    found = sorted({path.parent for path in folder.rglob("*.yaml") if path.name in named})
    if found:
        return found
    named_so = (path for path in folder.rglob("*") if path.suffix.lower() in (".h5", ".hdf5"))
    return sorted(path for path in named_so if _is_run(path))


def model_in(folder: Path) -> Path | None:
    """The first model file below `folder`, by the format that it states; None where there is none."""
    for path in sorted(path for path in folder.rglob("*") if path.suffix.lower() in (".yaml", ".yml")):
        with path.open("rb") as file:
            if _A_MODEL.search(file.read(HEAD_BYTES)):
                return path
    return None


def _is_run(path: Path) -> bool:
    """Whether a file is a recorded run, and not some other HDF5."""
    try:
        RunFile(path)
    except NeedleRigError:
        return False
    return True
