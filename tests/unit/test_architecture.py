"""The rooms keep their distance, and the contracts that say so can be broken."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LINT = "from importlinter.cli import lint_imports_command as lint; lint(['--no-cache'])"


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    pytest.importorskip("importlinter")
    return subprocess.run(
        [sys.executable, "-c", LINT], cwd=folder, capture_output=True, text=True, check=False
    )


def broken(output: str) -> set[str]:
    return set(re.findall(r"^(.+) BROKEN$", output, re.MULTILINE))


def test_every_room_imports_only_what_is_below_it() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture
def house(tmp_path: Path) -> Path:
    shutil.copytree(
        ROOT / "needle_rig", tmp_path / "needle_rig", ignore=shutil.ignore_patterns("__pycache__")
    )
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_every_contract_notices_a_breach(house: Path) -> None:
    for file, breach in {
        "needle_rig/control/pid.py": "import time",
        "needle_rig/physics/rod.py": "import needle_rig.recording",
        "needle_rig/physics/effects/first.py": "import needle_rig.physics.effects.second",
        "needle_rig/physics/effects/second.py": "",
        "needle_rig/workbench/estimation/problem.py": "import needle_rig.workbench.selection.verdict",
        "needle_rig/importing/guess/units.py": "import needle_rig.workbench",
        "needle_rig/service/api/lease.py": "import needle_rig.service.tick.loop",
        "needle_rig/simulation/nodes/analogue.py": "import needle_rig.simulation.plant",
        "needle_rig/workbench/selection/verdict.py": "import can, canopen, simple_pid, yaml, h5py, pint"
        "\nimport matplotlib",
    }.items():
        path = house / file
        path.write_text((path.read_text() if path.exists() else '"""New."""\n') + f"\n{breach}\n")
    done = lint(house)
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = {contract["name"] for contract in settings["tool"]["importlinter"]["contracts"]}
    assert len(contracts) >= 9
    assert broken(done.stdout) == contracts, done.stdout


def test_no_module_is_imported_by_what_it_imports() -> None:
    """Nor for a type's sake."""
    graph = pytest.importorskip("grimp").build_graph("needle_rig", cache_dir=None)
    # what imports nothing that is left goes first; what never goes stands in a ring
    imported = {module: set(graph.find_modules_directly_imported_by(module)) for module in graph.modules}
    while ends := {module for module, others in imported.items() if not others & imported.keys()}:
        imported = {module: others for module, others in imported.items() if module not in ends}
    assert not imported


def test_a_new_room_must_be_given_its_place(house: Path) -> None:
    (house / "needle_rig" / "attic.py").write_text('"""A room nobody placed."""\n')
    done = lint(house)
    assert done.returncode != 0
    assert "attic" in done.stdout + done.stderr


LEAVES_A_TASK = """
import asyncio

def test_it():
    async def forgetful():
        asyncio.get_running_loop().create_task(asyncio.Event().wait(), name="forgotten")
        await asyncio.sleep(0)

    asyncio.run(forgetful())

def test_tidy():
    async def tidy():
        await asyncio.get_running_loop().create_task(asyncio.sleep(0))

    asyncio.run(tidy())
"""


@pytest.mark.whole
def test_a_task_left_behind_fails_its_test(tmp_path: Path) -> None:
    shutil.copy(ROOT / "tests" / "conftest.py", tmp_path)
    (tmp_path / "test_it.py").write_text(LEAVES_A_TASK)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(tmp_path)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "asyncio tasks left behind" in done.stdout
    assert "forgotten" in done.stdout
    assert "2 passed, 1 error" in done.stdout
