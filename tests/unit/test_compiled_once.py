"""What a session compiles is there before its first test, so that no worker compiles it again."""

from __future__ import annotations

import importlib.util
import os

import pytest

from needle_rig.firmware import cache
from needle_rig.firmware.cache import built_firmware
from needle_rig.physics.kernel.run import _run

IN_A_WORKER = pytest.mark.skipif(
    "PYTEST_XDIST_WORKER" not in os.environ, reason="one process alone compiles for itself"
)


@IN_A_WORKER
def test_a_worker_reads_the_solver() -> None:
    assert sum(_run.stats.cache_hits.values()) > 0
    assert sum(_run.stats.cache_misses.values()) == 0


@IN_A_WORKER
@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="no compiler: the extra bench")
def test_a_worker_finds_the_firmware(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "build", lambda *_, **__: pytest.fail("it was built here"))
    assert built_firmware(images=True).is_dir()
