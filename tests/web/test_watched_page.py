"""What changed on the rig, as the page shows it, and the page of a watcher."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from needle_rig.web.guard import WATCHES
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, Open, look_at
from tests.web.served import Served
from tests.web.test_trends import kept, series

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def rig(shell: Shell) -> Iterator[Served]:
    """A simulated rig whose friction has changed, as the watch kept it; watchers have their address."""
    runs = shell.folder / "changed"
    runs.mkdir()
    kept(runs, series(30, jump=0.02))
    yield from started(shell, "--rig", "simulated", "--fast", "--watchers", "--dir", str(runs))


def test_a_change_is_an_alarm_beside_the_runs_and_their_range(visit: Open, rig: Served) -> None:
    page = visit("trends", served=rig)
    page.set_default_timeout(60_000)
    alarm = page.get_by_role("alert").filter(has_text="Something has changed")
    alarm.get_by_text("friction").wait_for()
    assert "needle-rig " not in alarm.inner_text()
    changed = page.get_by_role("link", name="run020")
    assert (changed.get_attribute("href") or "").endswith("#/runs/run020")
    page.wait_for_selector(".plot canvas")
    assert page.get_by_role("heading", name="error that the model leaves").locator(".tag").count() == 0
    look_at(page, "trends")


def test_a_watcher_sees_the_rig_and_has_nothing_to_order_with(visit: Open, rig: Served) -> None:
    page = visit("live", served=Served(rig.shell, rig.process, rig.watching))
    page.set_default_timeout(60_000)
    page.wait_for_selector(".shaft .curve")
    page.get_by_text("Watching", exact=True).wait_for()
    assert page.get_by_role("button", name="Stop").count() == 0
    assert page.get_by_role("button", name="Compensate").count() == 0
    page.keyboard.press("Escape")
    page.wait_for_timeout(300)
    assert page.locator(".stopped").count() == 0
    page.reload()
    page.get_by_text("Watching", exact=True).wait_for()
    page.goto(f"{rig.base}/#/trends")
    page.get_by_role("button", name="Look at new runs").click()
    page.get_by_role("alert").filter(has_text=WATCHES).wait_for()
