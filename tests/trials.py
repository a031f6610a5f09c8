"""A test that needs the clock gets a fair trial: failed while the machine stood still, it is repeated."""

from __future__ import annotations

from typing import Any

import pytest
from _pytest.runner import runtestprotocol

from tests.stillness import Stillness

MARK = "real_time"
PAUSE_S = 0.01
"""Of the machine, which spoils a trial: the least margin of what such tests assert."""
PRIORITY = 1
"""In real time, of the witness: that of the bench. Beside other tests the machine can be too busy for a rig
that is a program."""
TRIALS = 5

WITNESS = pytest.StashKey[Stillness]()
REPEATED = "trials repeated"
"""Property of the first report of a test that was repeated; it says why, in words."""


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
    """Repeat a test that failed while the machine stood still: that says nothing of the code.

    A failure on a machine that kept time counts at once, and so does that of the last trial.
    """
    if item.get_closest_marker(MARK) is None:
        return None
    stash = item.config.stash
    if WITNESS not in stash:
        stash[WITNESS] = Stillness(PAUSE_S / 2, PRIORITY)
        item.config.add_cleanup(stash[WITNESS].close)
    item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
    repeated: list[tuple[str, object]] = []
    for trial in range(1, TRIALS + 1):
        stash[WITNESS].longest_s()
        reports = runtestprotocol(item, log=False, nextitem=nextitem)
        pause_s = stash[WITNESS].longest_s()
        if trial == TRIALS or pause_s < PAUSE_S or not any(report.failed for report in reports):
            break
        repeated.append((REPEATED, f"{item.nodeid}: the machine paused for {pause_s * 1e3:.0f} ms"))
    reports[0].user_properties.extend(repeated)
    for report in reports:
        item.ihook.pytest_runtest_logreport(report=report)
    item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
    return True


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Name the trials that were repeated."""
    tell(terminalreporter, REPEATED)


def tell(terminalreporter: Any, title: str) -> None:
    """The properties of this title of every test, in whichever process it ran."""
    reports = (report for each in terminalreporter.stats.values() for report in each)
    properties = [pair for report in reports for pair in getattr(report, "user_properties", ())]
    if lines := [line for name, line in properties if name == title]:
        terminalreporter.section(title)
        for line in lines:
            terminalreporter.line(line)
