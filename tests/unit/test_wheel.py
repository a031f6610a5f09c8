"""The built wheel works from any folder, with the files that it ships and with a user's own."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BUILD = "import sys; from hatchling.build import build_wheel; print(build_wheel(sys.argv[1]))"
LOOK = """
from needle_rig.config.loader import find_config_file, load_rig_config
for name in ("rig.yaml", "needle_rig.dbc", "parameters/rig_elastic.yaml", "datasets/reed2008/settled.yaml"):
    print(find_config_file(name))
print(load_rig_config().name)
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as a wheel installs it."""
    pytest.importorskip("hatchling")
    folder = tmp_path_factory.mktemp("wheel")
    name = subprocess.run(
        [sys.executable, "-c", BUILD, str(folder)], cwd=ROOT, check=True, capture_output=True, text=True
    ).stdout.split()[-1]
    with zipfile.ZipFile(folder / name) as wheel:
        wheel.extractall(folder / "site")
    return folder / "site"


def python(site: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(site)}
    return subprocess.run(
        [sys.executable, *arguments], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )


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
