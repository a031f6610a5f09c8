"""Where the machine code of this package is kept, and for how long: until any of its files changes.

numba's own index stamps a function with the file it stands in, and not with the files of what it calls.
"""

from __future__ import annotations

import hashlib
import os
import sys
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

from numba import njit
from numba.core import config as numba_config
from numba.core.caching import (
    CacheImpl,
    CompileResultCacheImpl,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
    _CacheLocator,
)

FOLDER = Path(__file__).parent
TOLD = "NEEDLE_RIG_TOLD_OF_NO_CACHE"
"""Variable of the environment that is set when a person was warned."""


def _stamp() -> str:
    """Digest of all sources of the package; of their content, so that copies and checkouts keep the code."""
    digest = hashlib.sha256()
    files = [file for file in resources.files(__package__).iterdir() if file.name.endswith(".py")]
    for file in sorted(files, key=lambda file: file.name):
        content = file.read_bytes()
        digest.update(f"{file.name} {len(content)}\n".encode() + content)
    return digest.hexdigest()


STAMP = _stamp()


class _WholePackage(_CacheLocator):
    """A locator of numba for functions of this package alone, stamped with all of it."""

    def get_source_stamp(self) -> str:
        return STAMP

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> Any:
        here = Path(py_file).parent == FOLDER
        return super().from_function(py_func, py_file) if here else None


class ProvidedFolder(_WholePackage, UserProvidedCacheLocator):
    """NUMBA_CACHE_DIR."""


class PackageFolder(_WholePackage, InTreeCacheLocator):
    """__pycache__ beside the sources, where that can be written."""


class UserFolder(_WholePackage, UserWideCacheLocator):
    """The user's folder for caches."""


def kept(*signature: Any, **options: Any) -> Callable[[Any], Any]:
    """`njit` of a function whose machine code is kept, or made anew by each process that cannot keep it."""

    def decorated(function: Any) -> Any:
        decorator: Any = njit
        make = decorator(*signature, cache=_can_be_kept(function), **options)
        try:
            return make(function)
        except Exception:
            # numba writes its files without a sync: a power cut may empty them, and each start would fail
            if not _forgotten(function):
                raise
            return make(function)

    return decorated


def _forgotten(function: Any) -> bool:
    """Whether there was kept code of `function`, which is removed."""
    try:
        cache = CompileResultCacheImpl(function)
        kept_files = list(Path(cache.locator.get_cache_path()).glob(f"{cache.filename_base}.*nb[ci]"))
        for file in kept_files:
            file.unlink()
    except (OSError, RuntimeError):
        return False
    return bool(kept_files)


def _can_be_kept(function: Any) -> bool:
    """Whether a locator has a folder for `function` that can be written; says so once where none has."""
    try:
        CompileResultCacheImpl(function)
    except RuntimeError:
        if TOLD not in os.environ:
            os.environ[TOLD] = "1"  # the processes that this one starts are of the same use
            sys.stderr.write(
                "compiled code cannot be kept: no folder can be written for it, neither"
                " NUMBA_CACHE_DIR nor the package's nor the user's. Each process compiles it anew, up to a"
                " quarter of a minute; set NUMBA_CACHE_DIR to a folder that you can write.\n"
            )
        return False
    return True


def keep_by_package() -> None:
    """Let numba ask the locators of this package before its own, which serve everything else."""
    ours = [f"{__name__}.{locator.__name__}" for locator in (ProvidedFolder, PackageFolder, UserFolder)]
    config: Any = numba_config
    theirs = config.CACHE_LOCATOR_CLASSES or ",".join(each.__name__ for each in CacheImpl._locator_classes)
    config.CACHE_LOCATOR_CLASSES = ",".join([*ours, theirs])
