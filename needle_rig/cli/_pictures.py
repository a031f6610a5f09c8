"""Pictures that a command was asked for: refused at once where what draws them is not installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from needle_rig.errors import BadInput


def picture_option(*names: str, **how: Any) -> Callable[[Any], Any]:
    """An option that asks for pictures; without the extra `figures` it raises BadInput at once."""
    return click.option(*names, callback=_check, **how)


def _check(_context: click.Context, option: click.Parameter, given: Any) -> Any:
    """Refuse before the work whose pictures are asked for, and a file that no picture can be."""
    if given and importlib.util.find_spec("matplotlib") is None:
        from needle_rig.extras import missing

        raise missing("a picture", "matplotlib", "figures")
    if isinstance(given, Path):
        from needle_rig.figures.figure import FORMATS

        named = given.suffix.lower() in FORMATS
        if "--png" in option.opts and not named:
            raise BadInput(f"--png {given}: names no kind of picture; let it end in {', '.join(FORMATS)}")
        if "--pictures" in option.opts and named:
            raise BadInput(f"--pictures {given}: is the name of a picture; name a folder")
    return given
