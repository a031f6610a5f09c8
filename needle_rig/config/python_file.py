"""Reading the Python files that users write: an effect, a device, a strategy of their own.

A file is a module of the package `needle_rig.config.own`. The module's name says the file's folder and when
the file last changed: equal names in two folders are two modules, and every process finds the same file.
"""

from __future__ import annotations

import importlib
import importlib.util
import os
import traceback
from collections.abc import Sequence
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from needle_rig.config.regular_file import open_regular
from needle_rig.errors import BadInput

LIMIT_BYTES = 1_000_000
"""A law or a driver takes a page; what is a thousand times longer is neither."""
PACKAGE = "needle_rig.config.own."


def stamp_ns(path: Path) -> int:
    """When the file last changed. Raises BadInput where it is no regular file of at most LIMIT_BYTES."""
    with open_regular(path, str(path), LIMIT_BYTES) as file:
        return os.fstat(file.fileno()).st_mtime_ns


def load_module(path: Path) -> ModuleType:
    """The file run as a module of its own. Raises BadInput with file and line for any error in it."""
    if "." in path.stem:
        raise BadInput(f"{path}:1: the name {path.stem} has a dot; rename the file")
    folder = os.fsencode(path.parent.absolute()).hex()
    name = f"{PACKAGE}d{folder}_{stamp_ns(path)}.{path.stem}"
    try:
        return importlib.import_module(name)
    except SyntaxError as error:
        raise BadInput(f"{path}:{error.lineno}: {error.msg}; correct the file or move it away") from None
    except Exception as error:  # noqa: BLE001 any error of a user's file becomes one sentence
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        raise BadInput(
            f"{path}:{lines[-1] if lines else 1}: {type(error).__name__} while the file is read: {error}"
        ) from None


class Files:
    """Finds the modules of `needle_rig.config.own` by the names that `load_module` gives them."""

    def find_spec(
        self,
        fullname: str,
        path: Sequence[str] | None = None,  # noqa: ARG002 see MetaPathFinder
        target: ModuleType | None = None,  # noqa: ARG002
    ) -> ModuleSpec | None:
        """The spec of a module of one's own, or of its folder's empty package; None for any other module.

        Raises BadInput where the file is no longer the one that the name was given to.
        """
        if not fullname.startswith(PACKAGE):
            return None
        place, _, stem = fullname.removeprefix(PACKAGE).partition(".")
        if not stem:
            return ModuleSpec(fullname, None, is_package=True)
        folder, _, stamp = place.removeprefix("d").partition("_")
        file = Path(os.fsdecode(bytes.fromhex(folder))) / f"{stem}.py"
        if stamp_ns(file) != int(stamp):
            raise BadInput(f"{file} has changed since it was read; start anew what uses it")
        return importlib.util.spec_from_file_location(fullname, file, loader=_Uncached(fullname, str(file)))


def the_subclass(module: ModuleType, base: type, what: str, path: Path) -> type:
    """The one class that `module` derives from `base`. Raises BadInput when there is none, or more."""
    classes = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, base) and value.__module__ == module.__name__
    ]
    if len(classes) != 1:
        raise BadInput(
            f"{path}:1: {len(classes)} classes derive from {base.__name__}; {what}'s file has exactly one"
        )
    return classes[0]


class _Uncached(SourceFileLoader):
    """Reads the file itself: bytecode kept beside it counts as new while size and second of its date are."""

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        return self.source_to_code(self.get_data(path), path)
