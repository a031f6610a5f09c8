"""Where the C sources are, and what each image is made of."""

from __future__ import annotations

import hashlib
from pathlib import Path

from needle_rig.errors import BadInput

NODES = ("torque", "hall", "drive")
BOARD = "stm32f405"


def firmware_folder() -> Path:
    """The `firmware` folder of this checkout, or the copy that an installed wheel carries.

    Raises BadInput when neither is there.
    """
    package = Path(__file__).resolve().parent.parent
    for folder in (package.parent / "firmware", package / "shipped_firmware"):
        if (folder / "core").is_dir():
            return folder
    raise BadInput(
        f"{package.parent / 'firmware'}: no firmware sources; reinstall needle-rig or run in a checkout"
    )


def core_sources(folder: Path) -> list[Path]:
    """Portable sources and the generated CAN codec, in a fixed order."""
    return [*sorted((folder / "core").glob("*.c")), folder / "generated" / "needle_rig.c"]


def image_sources(folder: Path, node: str) -> list[Path]:
    """Sources of one node's image for the real board."""
    board = folder / "boards" / BOARD
    return [
        *core_sources(folder),
        *(board / name for name in ("board.c", "startup.c", "string.c", f"{node}.c")),
    ]


def source_build(folder: Path) -> int:
    """First 24 bits of the SHA-256 of what the nodes are compiled of; a changed source changes it."""
    digest = hashlib.sha256()
    for part in ("core", "generated", "boards"):
        for path in sorted((folder / part).rglob("*")):
            if path.is_file():
                digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return int.from_bytes(digest.digest()[:3], "big")
