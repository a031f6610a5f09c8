"""Pictures that a command was asked for: refused at once where what draws them is not installed."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import Any

import click


def picture_option(*names: str, **how: Any) -> Callable[[Any], Any]:
    """An option that asks for pictures; without the extra `figures` it raises BadInput at once."""
    return click.option(*names, callback=_check, **how)


def _check(_context: click.Context, _option: click.Parameter, given: Any) -> Any:
    """Refuse before the work whose pictures are asked for."""
    if given and importlib.util.find_spec("matplotlib") is None:
        from needle_rig.extras import missing

        raise missing("a picture", "matplotlib", "figures")
    return given
