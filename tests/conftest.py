"""What every test is held to: no asyncio task may outlive it; one that needs real time gets a fair trial."""

from __future__ import annotations

import asyncio
import os
import resource
import signal
import sys
from collections.abc import Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from needle_rig.workbench.parallel import one_thread_each

pytest_plugins = ["tests.trials"]
one_thread_each()  # before any test imports NumPy: threads on small matrices take a third more time

# A shell's job in the background ignores Ctrl-C, and so would every process that a test interrupts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Some hundred processes are started, and each would compile the whole package; each worker, all tests.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The same examples every time, since a run decides whether a change lands. 25 find with 93 % what one example
# in ten shows. CI takes `--hypothesis-profile=ci`, where it is one in forty; `search` looks for new examples.
settings.register_profile("default", deadline=None, print_blob=True, derandomize=True, max_examples=25)
settings.register_profile("ci", settings.get_profile("default"), max_examples=100)
settings.register_profile("search", deadline=None, print_blob=True)
settings.load_profile("default")

APART = ("whole", "real_time", "slow", "long", "hardware", "linux", "browser")
"""Marks of what plain `pytest` leaves out."""
BEGAN_S = pytest.StashKey[float]()
NOTICED_S = 3.0
"""Thrice what a test may take of a core without a mark, so that a slow computer names no other."""
LONG = "more than a second of a core: mark them whole"
"""Property of the last report of such a test."""

PASSED = "needle-rig/passed"
"""Where pytest's cache keeps which tests passed in the last run without `--not-again`."""


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--not-again",
        action="store_true",
        help="leave out what passed in the last run without this option, but for tests of many examples",
    )


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out what passed already; examples of hypothesis may be more this time."""
    cache = getattr(config, "cache", None)  # there is none without the plugin
    if not config.option.not_again or cache is None:
        return
    passed = set(cache.get(PASSED, []))
    again = [i for i in items if i.nodeid not in passed or i.get_closest_marker("hypothesis")]
    config.hook.pytest_deselected(items=[i for i in items if i not in set(again)])
    items[:] = again


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Keep which tests passed."""
    config = session.config
    cache = getattr(config, "cache", None)
    if hasattr(config, "workerinput") or config.option.not_again or cache is None:
        return
    reporter: Any = config.pluginmanager.get_plugin("terminalreporter")
    cache.set(PASSED, sorted({r.nodeid for r in reporter.stats.get("passed", ()) if r.when == "call"}))


def processor_s() -> float:
    """What this process and its children that ended took."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    item.stash[BEGAN_S] = processor_s()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Tell of a test of the plain run that takes more than its share."""
    report = yield
    if call.when == "teardown" and not any(mark.name in APART for mark in item.iter_markers()):
        taken_s = processor_s() - item.stash[BEGAN_S]
        if taken_s > NOTICED_S:
            report.user_properties.append((LONG, f"{item.nodeid}: {taken_s:.1f} s"))
    return report


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the tests that took long."""
    from tests.trials import tell

    tell(terminalreporter, LONG)


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile the solver and the firmware beside it before the workers start, since each of them would."""
    if hasattr(session.config, "workerinput") or session.config.option.collectonly:
        return
    from needle_rig.firmware.cache import built_firmware

    with ThreadPoolExecutor() as beside:
        beside.submit(built_firmware, images=True)  # tests that need it say what is missing
        compile_solver()


def compile_solver() -> None:
    import numpy as np

    from needle_rig.model import load_parameters
    from needle_rig.physics.effect import Trial

    time_s = np.array([0.0, 0.1, 0.2])
    load_parameters("rig_elastic").truth(Trial(time_s, time_s))


@pytest.fixture(autouse=True)
def no_task_left_behind(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fails a test whose event loop ends, or is closed, with tasks that are not done.

    asyncio.run cancels what is left without a word, so the tasks are looked at just before it does.
    """
    left: list[str] = []

    def watch(owner: Any, loop_of: Any) -> None:
        close = owner.close

        def closing(self: Any) -> None:
            loop = loop_of(self)
            if loop is not None and not loop.is_closed():
                left.extend(f"{task.get_name()}: {task.get_coro()}" for task in asyncio.all_tasks(loop))
            close(self)

        monkeypatch.setattr(owner, "close", closing)

    watch(asyncio.Runner, lambda runner: runner._loop)
    watch(asyncio.BaseEventLoop, lambda loop: loop)
    yield
    assert not left, "asyncio tasks left behind:\n" + "\n".join(dict.fromkeys(left))


@pytest.fixture(scope="session")
def run_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recorded run of reed2008."""
    from tests.recorded_run import write_run

    return write_run(tmp_path_factory.mktemp("runs") / "2026-01-01_12-00-00Z_reed2008.h5")
