"""Where the machine code of this package is kept, and for how long: until any of its files changes.

numba's own index stamps a function with the file it stands in, and not with the files of what it calls.
"""

from __future__ import annotations

import hashlib
from importlib import resources
from pathlib import Path
from typing import Any

from numba.core import config as numba_config
from numba.core.caching import (
    CacheImpl,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
    _CacheLocator,
)

FOLDER = Path(__file__).parent


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


def keep_by_package() -> None:
    """Let numba ask the locators of this package before its own, which serve everything else."""
    ours = [f"{__name__}.{locator.__name__}" for locator in (ProvidedFolder, PackageFolder, UserFolder)]
    config: Any = numba_config
    theirs = config.CACHE_LOCATOR_CLASSES or ",".join(each.__name__ for each in CacheImpl._locator_classes)
    config.CACHE_LOCATOR_CLASSES = ",".join([*ours, theirs])
