"""Reading the Python files that users write: an effect, a device of their own."""

from __future__ import annotations

import importlib.util
import os
import sys
import traceback
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, ModuleType

from needle_rig.config.regular_file import open_regular
from needle_rig.errors import BadInput

LIMIT_BYTES = 1_000_000
"""A law or a driver takes a page; what is a thousand times longer is neither."""


def stamp_ns(path: Path) -> int:
    """When the file last changed. Raises BadInput where it is no regular file of at most LIMIT_BYTES."""
    with open_regular(path, str(path), LIMIT_BYTES) as file:
        return os.fstat(file.fileno()).st_mtime_ns


def load_module(path: Path, package: str) -> ModuleType:
    """The file run as a module below `package`. Raises BadInput with file and line for any error in it.

    The folder is in the module's name: equal names in two folders are two modules.
    """
    name = f"{package}.d{abs(hash(path.parent)):x}.{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=_Uncached(name, str(path)))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise BadInput(f"{path}:{error.lineno}: {error.msg}; correct the file or move it away") from None
    except Exception as error:  # noqa: BLE001 any error of a user's file becomes one sentence
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if f.filename == str(path)]
        raise BadInput(
            f"{path}:{lines[-1] if lines else 1}: {type(error).__name__} while the file is read: {error}"
        ) from None
    return module


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
