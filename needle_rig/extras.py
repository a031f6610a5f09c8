"""Packages that only some uses need: asked for there, with the command that installs them."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import json
import os
import re
import shutil
import sys
from pathlib import Path
from types import ModuleType
from urllib.parse import unquote, urlsplit

from needle_rig.errors import BadInput

NAME = "needle-rig"
LOCK = "requirements.lock"
_SOURCE = Path(__file__).resolve().parent.parent
"""The clone, where the package runs from its source folder."""


def needed(module: str, what: str, extra: str) -> ModuleType:
    """The module that `what` needs, of an extra. Raises BadInput with the command that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise missing(what, module, extra) from None


def missing(what: str, module: str, extra: str) -> BadInput:
    """The error to raise where `what` needs a module of an extra that is not there."""
    package = module.partition(".")[0].replace("_", "-")
    return BadInput(f"{what} needs the package {package}, which is not installed; {install_command(extra)}")


def install_command(extra: str = "") -> str:
    """The command that installs needle-rig, with an extra, beside the Python that runs."""
    return f"{_installer()} {install_arguments(extra)}"


def install_arguments(extra: str = "") -> str:
    """What pip is given to install needle-rig with an extra.

    From a clone that is the clone with its extra. A wheel may be of a name that nobody holds on an index, so
    that its extra is named by the packages that are in it.
    """
    place, editable = _origin()
    if place is None or not place.is_dir():
        packages = [f"'{package}'" for package in _packages(extra)] if extra else []
        return " ".join(packages) or str(place or NAME)
    here = place == Path.cwd()
    lock, folder = (LOCK, ".") if here else (str(place / LOCK), str(place))
    wanted = f"'{folder}[{extra}]'" if extra else folder
    return f"-c {lock} {'-e ' if editable else ''}{wanted}"


def _origin() -> tuple[Path | None, bool]:
    """The clone, or the wheel, that this was installed from, and whether it runs in place."""
    if (_SOURCE / LOCK).is_file():
        return _SOURCE, True
    try:
        told = importlib.metadata.distribution(NAME).read_text("direct_url.json")
        origin = json.loads(told or "{}")
    except (importlib.metadata.PackageNotFoundError, ValueError):
        return None, False
    parts = urlsplit(str(origin.get("url", "")))
    place = Path(unquote(parts.path))
    if parts.scheme != "file" or not os.path.exists(place / LOCK if "dir_info" in origin else place):
        return None, False
    return place, bool(origin.get("dir_info", {}).get("editable"))


def _packages(extra: str) -> list[str]:
    """The packages of an extra, with their bounds, as the installed needle-rig states them."""
    try:
        stated = importlib.metadata.requires(NAME) or []
    except importlib.metadata.PackageNotFoundError:
        return []
    found: list[str] = []
    for requirement in stated:
        package, _, marker = (part.strip() for part in requirement.partition(";"))
        if not re.search(rf"extra\s*==\s*['\"]{re.escape(extra)}['\"]", marker):
            continue
        inner = re.fullmatch(rf"{NAME}\[(?P<extras>[^]]+)\]", package)
        if inner:
            found += [p for each in inner["extras"].split(",") for p in _packages(each.strip())]
        else:
            found.append(package)
    return list(dict.fromkeys(found))


def _installer() -> str:
    """`pip install` as it is reached from here, for the Python that runs."""
    if importlib.util.find_spec("pip") is None:
        return f"uv pip install --python {sys.executable}"
    reached = shutil.which("pip")
    if reached is not None and Path(reached).parent == Path(sys.executable).parent:
        return "pip install"
    return f"{sys.executable} -m pip install"
