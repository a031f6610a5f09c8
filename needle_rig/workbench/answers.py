"""Answers of tasks, kept on disk until the question that they belong to is answered.

A question that was stopped and is re-run goes on from them. An answer is found by its task alone: the
function, its arguments, and the source of all that they name. What cannot be read is worked again.
"""

from __future__ import annotations

import hashlib
import os
import pickle
import shutil
import stat
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib.metadata import version
from io import BytesIO
from pathlib import Path
from types import FunctionType
from typing import Any

from pydantic import BaseModel

from needle_rig.config.python_file import PACKAGE as OWN
from needle_rig.folders import cache_folder

LIVES_S = 7 * 86_400.0
"""Age at which answers of a stopped question are removed: who comes back to it does so within a week."""
LIMIT_BYTES = 500_000_000
"""Of one question, and of all that were stopped before it: `learn` on eight trials keeps 38 MB."""
_DIGEST_BYTES = 32
_NUMERIC = ("numpy", "scipy", "numba")
"""Packages whose version can change a last digit."""

Say = Callable[[str], None]


@contextmanager
def answers_of(asked: str, say: Say, tell: Say) -> Iterator[Answers | None]:
    """The answers that belong to the question `asked`; they go when it is answered.

    None where they cannot be kept. `tell` hears that, and how many stay where KeyboardInterrupt ends it.
    """
    with ExitStack() as stack:
        answers = None
        try:
            name = _digest(_stamp(), os.fsencode(os.getcwd()), asked.encode()).hex()
            whole = _own_folder(cache_folder() / "answers")
            stack.callback(os.close, whole)
            _tidy(whole, name)
            with suppress(FileExistsError):
                os.mkdir(name, 0o700, dir_fd=whole)
            folder = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=whole)
            stack.callback(os.close, folder)
            stack.callback(_remove_empty, whole, name)
            answers = Answers(folder, say, tell)
        except (OSError, RuntimeError) as error:
            tell(_cannot_keep(error))
        try:
            yield answers
        except KeyboardInterrupt:
            if answers is not None and answers.kept:
                tell(f"{answers.kept} tasks are done: the same, re-run within a week, goes on from there")
            raise
        if answers is not None:
            shutil.rmtree(name, ignore_errors=True, dir_fd=whole)


class Answers:
    """Of one question, in an open folder that is its user's alone."""

    def __init__(self, folder: int, say: Say, tell: Say) -> None:
        self._folder, self._say, self._tell = folder, say, tell
        entries = list(os.scandir(folder))
        self._done = self.kept = sum("." not in entry.name for entry in entries)
        self._room_bytes = LIMIT_BYTES - sum(_size(entry) for entry in entries)
        self._told = self._full = False

    def key(self, shared: str, function: Callable[..., Any], task: tuple[Any, ...]) -> str:
        """What the answer of a task is found by."""
        return digest_of((shared, function, task))

    def find(self, key: str) -> tuple[Any] | None:
        """The answer of the task with this key, alone in a tuple; None where it is not known."""
        try:
            with open(key, "rb", opener=self._open) as file:
                kept = file.read(LIMIT_BYTES)
        except OSError:
            return None
        answer = kept[_DIGEST_BYTES:]
        if kept[:_DIGEST_BYTES] != _digest(key.encode(), answer):
            return None
        if self._done and not self._told:  # one of this run's own is no earlier one
            self._told = True
            self._say(f"going on after {self._done} tasks that were done before this was stopped")
        return (pickle.loads(answer),)

    def keep(self, key: str, answer: bytes) -> None:
        """Keep a pickled answer. A machine that loses power loses those of the last half minute, unsynced."""
        if self._full:
            return
        self._room_bytes -= len(answer)
        try:
            if self._room_bytes < 0:
                raise OSError(0, f"they take more than {LIMIT_BYTES / 1e6:.0f} MB")
            fresh = f"{key}.{os.getpid()}"
            with open(fresh, "wb", opener=self._open) as file:
                file.write(_digest(key.encode(), answer) + answer)
            os.replace(fresh, key, src_dir_fd=self._folder, dst_dir_fd=self._folder)
            self.kept += 1
        except FileNotFoundError:
            self._full = True  # the same question, asked twice at once, was answered there and tidied up
        except OSError as error:
            self._full = True
            self._tell(_cannot_keep(error))

    def _open(self, name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW, 0o600, dir_fd=self._folder)


def digest_of(thing: Any) -> str:
    """Of all that a thing holds, and of the source of the classes and functions that it names."""
    stream = BytesIO()
    pickler = _Stated(stream, protocol=pickle.HIGHEST_PROTOCOL)
    pickler.dump(thing)
    return _digest(_stamp(), stream.getbuffer(), *map(_stamp_of, sorted(pickler.modules))).hex()


class _Stated(pickle.Pickler):
    """Notes the modules of classes and functions, which are pickled by their names alone."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.modules: set[str] = set()

    def reducer_override(self, thing: Any) -> Any:
        if isinstance(thing, type | FunctionType):
            self.modules.add(thing.__module__)
        if isinstance(thing, BaseModel):
            # which fields were given is a set, whose order differs from process to process
            reduced: Any = thing.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
            made, arguments, state, *_ = reduced
            return made, arguments, {**state, "__pydantic_fields_set__": sorted(thing.model_fields_set)}
        return NotImplemented


def _own_folder(place: Path) -> int:
    """The folder, open, for its user alone: what is unpickled from it runs. Raises OSError."""
    place.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    found = os.fstat(folder)
    if found.st_uid != os.geteuid() or stat.S_IMODE(found.st_mode) & 0o077:
        os.close(folder)
        raise PermissionError(0, f"{place} is open to others; remove it")
    return folder


def _remove_empty(whole: int, name: str) -> None:
    """Leave nothing of a question that ended before any task was done."""
    with suppress(OSError):
        os.rmdir(name, dir_fd=whole)


def _tidy(whole: int, name: str) -> None:
    """Remove answers of other questions that are old, or too many."""
    oldest_s, room_bytes = time.time() - LIVES_S, LIMIT_BYTES
    for entry in sorted(os.scandir(whole), key=_changed_s, reverse=True):
        if entry.name != name:
            room_bytes -= _size_within(whole, entry.name)
            if _changed_s(entry) < oldest_s or room_bytes < 0:
                shutil.rmtree(entry.name, ignore_errors=True, dir_fd=whole)


def _changed_s(entry: os.DirEntry[str]) -> float:
    with suppress(OSError):  # another process may just have removed it
        return entry.stat(follow_symlinks=False).st_mtime
    return 0.0


def _size_within(whole: int, name: str) -> int:
    with suppress(OSError):
        folder = os.open(name, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=whole)
        try:
            return sum(map(_size, os.scandir(folder)))
        finally:
            os.close(folder)
    return 0


def _size(entry: os.DirEntry[str]) -> int:
    with suppress(OSError):  # another process may just have put it in its place
        return entry.stat(follow_symlinks=False).st_size
    return 0


def _cannot_keep(error: OSError | RuntimeError) -> str:
    reason = error.strerror if isinstance(error, OSError) else "there is no home folder"
    return (
        f"warning: what is done is not kept ({reason}): if this is stopped, it begins anew;"
        " XDG_CACHE_HOME names another folder"
    )


def _digest(*parts: bytes | memoryview) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(f"{len(part)} ".encode())
        digest.update(part)
    return digest.digest()


@cache
def _stamp() -> bytes:
    """Of this package's source and of what it computes with."""
    package = Path(__file__).parent.parent
    versions = [each.encode() for each in (sys.version, *map(version, _NUMERIC))]
    return _digest(*versions, *(file.read_bytes() for file in sorted(package.rglob("*.py"))))


@cache
def _stamp_of(module: str) -> bytes:
    """Of another module's source; one without a file is the same to this process alone."""
    known = module.partition(".")[0] in {"needle_rig", *_NUMERIC, *sys.stdlib_module_names}
    if known and module != "__main__" and not module.startswith(OWN):
        return module.encode()
    file = getattr(sys.modules.get(module), "__file__", None)
    return os.urandom(_DIGEST_BYTES) if file is None else Path(file).read_bytes()
