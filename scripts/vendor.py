#!/usr/bin/env python3
"""Fetches what the page ships of others from npm again, as `FILES` says, and writes the manifest.

scripts/vendor.py            with the versions that stand here
"""

from __future__ import annotations

import json
import subprocess
import tarfile
import tempfile
from dataclasses import asdict
from pathlib import Path

from needle_rig.web.vendored import MANIFEST, VENDOR, Vendored, renamed, sha256

VERSIONS = {
    "uplot": ("1.6.32", "MIT"),
    "preact": ("11.2.0", "MIT"),
    "htm": ("3.1.1", "Apache-2.0"),
    "@preact/signals": ("2.11.4", "MIT"),
    "@preact/signals-core": ("1.14.5", "MIT"),
}
FILES = {
    "uplot.js": ("uplot", "dist/uPlot.esm.js"),
    "uplot.css": ("uplot", "dist/uPlot.min.css"),
    "preact.js": ("preact", "dist/preact.mjs"),
    "hooks.js": ("preact", "hooks/dist/hooks.mjs"),
    "htm.js": ("htm", "dist/htm.mjs"),
    "signals.js": ("@preact/signals", "dist/signals.mjs"),
    "signals-core.js": ("@preact/signals-core", "dist/signals-core.mjs"),
    "LICENSE-uplot": ("uplot", "LICENSE"),
    "LICENSE-preact": ("preact", "LICENSE"),
    "LICENSE-htm": ("htm", "LICENSE"),
    "LICENSE-signals": ("@preact/signals", "LICENSE"),
}
MODULES = {
    "preact": "./preact.js",
    "preact/hooks": "./hooks.js",
    "@preact/signals-core": "./signals-core.js",
}


def main() -> None:
    """Write every file and the manifest."""
    with tempfile.TemporaryDirectory() as folder:
        entries = []
        for file, (package, path) in FILES.items():
            version, licence = VERSIONS[package]
            content = fetched(package, version, path, Path(folder))
            here = renamed(content, MODULES) if file.endswith(".js") else content
            used = {name: at for name, at in MODULES.items() if f'"{name}"'.encode() in content}
            (VENDOR / file).write_bytes(here)
            hashes = sha256(content), sha256(here)
            entries.append(asdict(Vendored(file, package, version, path, licence, *hashes, used)))
    MANIFEST.write_text(json.dumps(entries, indent=1) + "\n", encoding="utf-8")


def fetched(package: str, version: str, path: str, folder: Path) -> bytes:
    """One file of a package."""
    place = folder / f"{package.replace('/', '_')}.tgz"
    if not place.exists():
        done = subprocess.run(
            ["npm", "pack", "--json", f"{package}@{version}"],
            cwd=folder,
            check=True,
            capture_output=True,
            text=True,
        )
        (folder / json.loads(done.stdout)[0]["filename"]).rename(place)
    with tarfile.open(place) as packed:
        member = packed.extractfile(f"package/{path}")
        assert member is not None
        return member.read()


if __name__ == "__main__":
    main()
