"""The page's store and its client of jobs, by node's own test runner, in the modules that are served."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path

import pytest

from needle_rig.web.static_files import STATIC

HERE = Path(__file__).parent / "front_end"
NODE = shutil.which("node")
PATIENCE_S = 60


@pytest.mark.whole
@pytest.mark.skipif(NODE is None, reason="no node here: apt-get install nodejs")
@pytest.mark.parametrize("name", sorted(path.name for path in HERE.glob("*.test.mjs")))
def test_in_node(name: str, tmp_path: Path) -> None:
    # node takes a .js for a module where its folder says so; the page's folder has nothing of node's
    shutil.copytree(STATIC, tmp_path / "static")
    (tmp_path / "static" / "package.json").write_text(json.dumps({"type": "module"}))
    done = subprocess.run(
        [str(NODE), "--test", str(HERE / name)],
        env={**os.environ, "NEEDLE_RIG_STATIC": str(tmp_path / "static")},
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "# tests 0" not in done.stdout
