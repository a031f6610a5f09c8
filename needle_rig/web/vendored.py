"""What of others the page ships: each file with package, version, licence and hashes, in `manifest.json`.

A module that names another by its package ("preact") names the file beside it instead ("./preact.js"), since
a browser finds packages only by an inline script, which the page's policy forbids. Nothing else is changed:
with the names put back the file has the hash that its package was published with.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

VENDOR = Path(__file__).parent / "static" / "vendor"
MANIFEST = VENDOR / "manifest.json"
_NAMED = re.compile(rb'(from\s*|import\s*)"([^"]+)"')


@dataclass(frozen=True)
class Vendored:
    """One file of a package on npm."""

    file: str
    package: str
    version: str
    path: str
    """Inside the package."""
    licence: str
    published_sha256: str
    """As the package has it."""
    sha256: str
    """As it stands here."""
    modules: Mapping[str, str]
    """Packages that it imports, and the files that stand for them."""


def vendored() -> tuple[Vendored, ...]:
    """The manifest."""
    return tuple(Vendored(**entry) for entry in json.loads(MANIFEST.read_text(encoding="utf-8")))


def renamed(content: bytes, names: Mapping[str, str]) -> bytes:
    """`content` with the modules that it imports called by other names."""

    def other(found: re.Match[bytes]) -> bytes:
        name = found[2].decode()
        return found[1] + b'"' + names.get(name, name).encode() + b'"'

    return _NAMED.sub(other, content)


def sha256(content: bytes) -> str:
    """In hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()
