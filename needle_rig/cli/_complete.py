"""Names that a shell completes: effects, strategies, parameter sets, protocols. No file is run for it."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from needle_rig.config.directories import config_directories

_PACKAGE = Path(__file__).parent.parent
SHIPPED = {"effects": _PACKAGE / "physics" / "effects", "strategies": _PACKAGE / "control" / "strategies"}
"""Where the shipped ones of a kind are, beside the folders of `config/`."""

Completed = Callable[[click.Context, click.Parameter, str], list[CompletionItem]]


def completing(kind: str) -> Completed:
    """For `shell_complete=`: the names of a kind (`effects`), or files."""

    def complete(ctx: click.Context, parameter: click.Parameter, begun: str) -> list[CompletionItem]:  # noqa: ARG001
        found = [CompletionItem(name) for name in names(kind) if name.startswith(begun)]
        return found or [CompletionItem(begun, type="file")]

    return complete


def names(kind: str) -> list[str]:
    """All names of a kind: of files of `config/KIND`, of shipped files, of entry points."""
    folders = [folder / kind for folder in config_directories()]
    folders += [SHIPPED[kind]] if kind in SHIPPED else []
    files = (path for folder in folders for path in folder.glob("*") if path.suffix in (".py", ".yaml"))
    stems = {path.stem for path in files if not path.stem.startswith("_")}
    return sorted(stems | {entry.name for entry in entry_points(group=f"needle_rig.{kind}")})
