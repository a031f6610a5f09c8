"""The wheel, built from the sdist, works from any folder, with its shipped files and with a user's own."""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from needle_rig.version import VERSION

ROOT = Path(__file__).parents[2]
LOOK = """
from needle_rig.config.loader import find_config_file, load_rig_config
for name in ("rig.yaml", "needle_rig.dbc", "parameters/rig_elastic.yaml", "datasets/reed2008/settled.yaml"):
    print(find_config_file(name))
print(load_rig_config().name)
"""


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sdist, and with the wheel that is built from it, as a release has them."""
    pytest.importorskip("build")
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)],
        check=True,
        capture_output=True,
    )
    return folder


@pytest.fixture(scope="module")
def site(built: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the wheel is installed in."""
    folder = tmp_path_factory.mktemp("site")
    (wheel,) = built.glob("*.whl")
    pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target"]
    subprocess.run([*pip, str(folder), str(wheel)], check=True, capture_output=True)
    return folder


def python(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


def test_both_have_the_version_of_the_package(built: Path) -> None:
    names = {path.name for path in built.iterdir()}
    assert names == {f"needle_rig-{VERSION}.tar.gz", f"needle_rig-{VERSION}-py3-none-any.whl"}
    with tarfile.open(built / f"needle_rig-{VERSION}.tar.gz") as sdist:
        held = {name.split("/", 1)[1] for name in sdist.getnames() if "/" in name}
    assert {"CITATION.cff", "LICENSE", "tests/unit/test_wheel.py", "requirements.lock"} <= held


def test_the_installed_program_tells_its_version(site: Path, tmp_path: Path) -> None:
    told = python(site, tmp_path, str(site / "bin/needle-rig"), "--version")
    assert told.stdout == f"needle-rig, version {VERSION}\n", told.stderr
    listed = python(site, tmp_path, "-c", "import importlib.metadata as m; print(m.version('needle-rig'))")
    assert listed.stdout.strip() == VERSION


def test_shipped_files_are_found_from_any_folder(site: Path, tmp_path: Path) -> None:
    done = python(site, tmp_path, "-c", LOOK)
    assert done.returncode == 0, done.stderr
    *paths, name = done.stdout.splitlines()
    assert [Path(path).relative_to(site / "needle_rig" / "shipped").name for path in paths] == [
        "rig.yaml",
        "needle_rig.dbc",
        "rig_elastic.yaml",
        "settled.yaml",
    ]
    assert name == "simulated rig"


def test_a_users_own_rig_comes_first(site: Path, tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    own = (ROOT / "config" / "rig.yaml").read_text(encoding="utf-8").replace("simulated rig", "my rig", 1)
    (tmp_path / "config" / "rig.yaml").write_text(own, encoding="utf-8")
    done = python(site, tmp_path, "-c", LOOK)
    assert done.stdout.splitlines()[-1] == "my rig"


def test_the_command_runs(site: Path, tmp_path: Path) -> None:
    done = python(site, tmp_path, "-m", "needle_rig", "runs", "--json")
    assert (done.returncode, done.stdout) == (0, "[]\n"), done.stderr
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "rig.yaml").write_text("format: needle-rig/1\nformat: needle-rig/1\n")
    done = python(site, tmp_path, "-m", "needle_rig", "runs")
    assert done.returncode == 2
    assert (
        done.stderr == "config/rig.yaml:2:1: format is given twice, first at config/rig.yaml:1:1; keep one\n"
    )
