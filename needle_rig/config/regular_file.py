"""Opening files that people name: regular ones alone, up to a size, never outside of where they belong."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from needle_rig.errors import BadInput

NAME_SHOWN = 80
"""Letters of a name that no file can have which are repeated in the error."""

_KINDS = (
    (stat.S_ISDIR, "folder"),
    (stat.S_ISFIFO, "pipe"),
    (stat.S_ISSOCK, "socket"),
    (stat.S_ISCHR, "device"),
    (stat.S_ISBLK, "device"),
)


def open_regular(
    path: str | os.PathLike[str],
    shown: str,
    limit_bytes: int,
    *,
    inside: str | os.PathLike[str] | None = None,
    missing: Callable[[], str] = str,
) -> BinaryIO:
    """The regular file at `path`, opened for reading, of at most `limit_bytes`; `shown` names it in errors.

    With `inside` it must lie below that folder, links followed. Raises BadInput, without waiting for a pipe,
    without touching a device and before a byte is read; `missing` says more of a file that is not there.
    """
    try:
        # What a pipe's other end or a driver does at an open is none of our business: look before.
        real = os.path.realpath(path, strict=True)
        if inside is not None and not Path(real).is_relative_to(os.path.realpath(inside)):
            raise BadInput(
                f"{shown}: lies outside of the folder {os.fspath(inside)}, where a link or .. leads it;"
                " copy the file into the folder"
            )
        _refuse_special(os.stat(real), shown)
        descriptor = os.open(real, os.O_RDONLY | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_NOCTTY | os.O_CLOEXEC)
    except (OSError, ValueError) as error:
        raise BadInput(_refusal(error, shown, missing)) from None
    file = os.fdopen(descriptor, "rb")
    try:
        found = os.fstat(descriptor)
        _refuse_special(found, shown)
        if found.st_size > limit_bytes:
            raise BadInput(
                f"{shown}: has {_size(found.st_size)}, more than the {_size(limit_bytes)} that are read here;"
                " is it the right file?"
            )
    except BaseException:
        file.close()
        raise
    return file


def read_regular(
    path: str | os.PathLike[str],
    shown: str,
    limit_bytes: int,
    *,
    inside: str | os.PathLike[str] | None = None,
    missing: Callable[[], str] = str,
) -> bytes:
    """What `open_regular` opens, read whole; BadInput too when the file changes its size meanwhile."""
    with open_regular(path, shown, limit_bytes, inside=inside, missing=missing) as file:
        size_bytes = os.fstat(file.fileno()).st_size
        try:
            content = file.read(size_bytes + 1)
        except OSError as error:
            raise BadInput(_refusal(error, shown, missing)) from None
    if len(content) != size_bytes:
        raise BadInput(
            f"{shown}: changed its size while it was read; wait until it is written, then try again"
        )
    return content


def _refuse_special(found: os.stat_result, shown: str) -> None:
    if stat.S_ISREG(found.st_mode):
        return
    kind = next((word for test, word in _KINDS if test(found.st_mode)), "special file")
    raise BadInput(f"{shown}: is a {kind}, not a file that can be read; name a regular file")


def _refusal(error: OSError | ValueError, shown: str, missing: Callable[[], str]) -> str:
    if isinstance(error, FileNotFoundError | NotADirectoryError):
        return f"{shown}: there is no such file{missing()}"
    if isinstance(error, PermissionError):
        return f"{shown}: you may not read this file; change its rights (chmod u+r)"
    if isinstance(error, ValueError):
        return f"{shown!r}: cannot be read: no file's name has a null character; correct the name"
    if error.errno == errno.ENAMETOOLONG:
        name = shown if len(shown) <= NAME_SHOWN else f"{shown[:NAME_SHOWN]}…"
        return f"{name}: cannot be read: File name too long ({len(shown)} letters); correct the name"
    if error.errno == errno.ELOOP:
        return f"{shown}: is a link that leads back to itself; replace it by the file"
    return f"{shown}: cannot be read: {error.strerror or error}"


def _size(size_bytes: int) -> str:
    return f"{size_bytes / 1e6:.4g} MB" if size_bytes >= 1e5 else f"{size_bytes} bytes"
