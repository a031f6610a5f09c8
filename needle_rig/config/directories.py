"""The folders that hold configuration, nearest first."""

from __future__ import annotations

from pathlib import Path


def config_directories() -> tuple[Path, ...]:
    """Folders to search, nearest first: ./config, then the files that came with needle-rig."""
    package = Path(__file__).resolve().parent.parent
    shipped = package / "shipped"
    source = package.parent / "config"
    folders = [Path("config"), shipped if shipped.is_dir() else source]
    return tuple(dict.fromkeys(f.resolve() for f in folders if f.is_dir()))
