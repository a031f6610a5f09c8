"""The firmware, built once and kept until a source or the compiler changes."""

from __future__ import annotations

import hashlib
import importlib.metadata
import importlib.util
import shutil
import tempfile
from pathlib import Path

from needle_rig.extras import missing
from needle_rig.firmware.build import build
from needle_rig.firmware.sources import firmware_folder
from needle_rig.folders import cache_folder
from needle_rig.version import VERSION

_NEEDED = {"ziglang": "the compiler", "cffi": "the bridge to C", "elftools": "the reader of images"}


def built_firmware(*, images: bool = False) -> Path:
    """The folder with the host library, and with `images` the Cortex-M images; built when it is not there.

    Raises BadInput when the bench extra is not installed, NeedleRigError when a source does not compile.
    """
    needed = {**_NEEDED, "unicorn": "the emulator"} if images else _NEEDED
    for module, what in needed.items():
        if importlib.util.find_spec(module) is None:
            raise missing(f"running the firmware here ({what})", module, "bench")
    kept = cache_folder() / "firmware" / f"{_fingerprint()}-{'images' if images else 'host'}"
    if kept.is_dir():
        return kept
    kept.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(dir=kept.parent))
    try:
        build(fresh, only_host=not images)
        fresh.rename(kept)
    except OSError:
        if not kept.is_dir():  # another process was not faster: this is a real failure
            raise
    finally:
        shutil.rmtree(fresh, ignore_errors=True)
    return kept


def _fingerprint() -> str:
    folder = firmware_folder()
    digest = hashlib.sha256(importlib.metadata.version("ziglang").encode())
    digest.update(VERSION.encode())
    digest.update(Path(__file__).with_name("build.py").read_bytes())
    for path in sorted(folder.rglob("*")):
        if path.is_file():
            digest.update(str(path.relative_to(folder)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
