"""Libraries of the extra `import`: asked for when a file needs them."""

from __future__ import annotations

import importlib
from types import ModuleType

from needle_rig.errors import BadInput


def needed(module: str, what: str) -> ModuleType:
    """The module that reads `what`. Raises BadInput with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise BadInput(
            f"{what} needs the package {module.partition('.')[0]}, which is not installed; "
            "pip install 'needle-rig[import]'"
        ) from None
