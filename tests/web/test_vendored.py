"""What the page ships of others is what they published, with licence and hash."""

import subprocess
from pathlib import Path
from shutil import which

import pytest

from needle_rig.web.vendored import MANIFEST, VENDOR, renamed, sha256, vendored

ROOT = Path(__file__).parents[2]


def test_every_vendored_file_is_in_the_manifest_with_its_hash() -> None:
    listed = {entry.file for entry in vendored()}
    there = {path.name for path in VENDOR.iterdir() if not path.name.endswith(".d.ts")}
    assert there == listed | {MANIFEST.name}
    for entry in vendored():
        assert sha256((VENDOR / entry.file).read_bytes()) == entry.sha256, entry.file


def test_with_the_modules_called_by_their_packages_again_each_file_is_the_published_one() -> None:
    for entry in vendored():
        content = (VENDOR / entry.file).read_bytes()
        if entry.file.endswith(".js"):
            content = renamed(content, {at: name for name, at in entry.modules.items()})
        assert sha256(content) == entry.published_sha256, entry.file


def test_every_package_has_a_licence_and_its_text() -> None:
    with_text = {entry.package for entry in vendored() if entry.file.startswith("LICENSE")}
    for entry in vendored():
        assert entry.licence in ("MIT", "Apache-2.0")
        assert entry.package.replace("-core", "") in with_text


@pytest.mark.whole
@pytest.mark.skipif(which("tsc") is None, reason="no tsc here: npm install --global typescript")
def test_the_types_of_the_modules_are_right() -> None:
    done = subprocess.run(
        ["tsc", "-p", str(ROOT / "tests" / "web" / "jsconfig.json")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stdout
