"""One simulated rig behind real ports for all bench tests; every test gets it unharmed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.bench_loop import LINKS
from needle_rig.simulation.bench.process import Bench


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Everything here runs in real time."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.real_time)


@pytest.fixture
def steady() -> Iterator[None]:
    """Real-time priority where the system allows it, as the daemon has, for a tick inside the test."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(50))
    except PermissionError:
        yield
        return
    yield
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@pytest.fixture(scope="session")
def running_bench() -> Iterator[Bench]:
    bench = bench_module.start(load_rig_config())
    yield bench
    bench.close()


@pytest.fixture
def bench(running_bench: Bench) -> Bench:
    for link in LINKS:
        running_bench.harm(link, "restore")
    return running_bench


@pytest.fixture
def config(bench: Bench) -> RigConfig:
    """The bench with the age limits of a real rig."""
    limits = {f"links.{link}_age_limit_ms": 50 for link in ("torque", "hall", "drive")}
    return bench.configured(load_rig_config(None, limits))
