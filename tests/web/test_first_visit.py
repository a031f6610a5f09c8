"""A newcomer without data or a terminal: the opening, example data, and the circle to an aligned needle."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, VIEWS, Open, look_at
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def fresh(shell: Shell) -> Iterator[Served]:
    """A page in an empty folder, with a simulated rig."""
    yield from started(shell, "--rig", "simulated", "--fast", "--dir", str(shell.folder / "first"))


def test_every_view_says_what_it_is_for(visit: Open, served: Served) -> None:
    page = visit("live", served=served)
    page.set_default_timeout(30_000)
    page.get_by_role("heading", name="What this is about").wait_for()
    assert "windup" in page.locator(".opening").inner_text()
    look_at(page, "opening")
    for view in VIEWS:
        page.goto(f"{served.base}/#/{view}")
        purpose = page.locator("h1 + .purpose")
        purpose.wait_for()
        assert purpose.count() == 1
        assert re.fullmatch(r"[A-Z][^.]+\.", purpose.inner_text())


def test_the_circle_closes_from_an_empty_folder_with_a_reload_between_any_two_steps(
    visit: Open, fresh: Served
) -> None:
    page = visit("data", served=fresh)
    page.set_default_timeout(120_000)
    page.get_by_role("button", name="Try it with example data").click()
    page.wait_for_selector(".map td button")
    look_at(page, "workbench-example")
    reloaded(page, ".map td button")
    page.get_by_role("button", name="Diagnose quickly").click()
    page.locator(".verdict").wait_for()
    assert "tissue elasticity" in page.locator(".verdict").inner_text()
    reloaded(page, ".verdict")
    page.get_by_role("button", name="Add tissue elasticity").click()
    page.get_by_role("heading", name="4 · The error falls").wait_for()
    reloaded(page, ".bars")
    page.get_by_role("link", name="Use this model on the rig").click()
    page.wait_for_selector(".shaft .curve")
    reloaded(page, ".shaft .curve")
    expect(page.get_by_label("Strategy")).to_have_value("planned")
    page.get_by_role("button", name="Compensate", exact=True).click()
    page.locator(".ended").wait_for()
    assert ": aligned" in page.locator(".ended").inner_text()
    assert page.locator(".alarm").inner_text() == ""
    # a second request finds the same example and makes none
    page.goto(f"{fresh.base}/#/data")
    page.get_by_role("button", name="Try it with example data").click()
    page.wait_for_url(re.compile("#/data/example$"))


@pytest.mark.real_time
def test_the_circle_closes_with_a_reload_while_each_work_and_the_run_goes_on(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--rig", "simulated", "--dir", str(tmp_path)):
        page = visit("data", served=served)
        page.set_default_timeout(120_000)
        page.get_by_role("button", name="Try it with example data").click()
        reloaded_while(page, served, "example")
        page.get_by_role("link", name="Show the result").click()
        page.wait_for_selector(".map td button")
        page.get_by_role("button", name="Diagnose quickly").click()
        reloaded_while(page, served, "diagnose")
        page.locator(".verdict").wait_for()
        page.get_by_role("button", name="Add tissue elasticity").click()
        reloaded_while(page, served, "adopt")
        page.get_by_role("link", name="Show the result").click()
        page.get_by_role("heading", name="4 · The error falls").wait_for()
        # each was computed once
        made = [job["kind"] for job in served.ask("GET", "/api/jobs").json()["jobs"]]
        assert sorted(made) == ["adopt", "compare", "compare", "diagnose", "example"]
        page.get_by_role("link", name="Use this model on the rig").click()
        page.wait_for_selector(".shaft .curve")
        page.get_by_role("button", name="Compensate", exact=True).click()
        page.locator(".steps .now").wait_for()
        reloaded(page, ".steps .now")
        assert page.locator(".ended").count() == 0
        page.get_by_text("expected by").first.wait_for()
        expect(page.get_by_label("Strategy")).to_have_value("planned")
        aligned(page)
        reloaded(page, ".ended")
        aligned(page)
        page.get_by_role("link", name="This run", exact=True).click()
        page.get_by_role("heading", name="Torque against angle").wait_for()
        page.go_back()
        page.get_by_role("link", name="Diagnose this run").click()
        page.wait_for_selector(".map td button")


def aligned(page: Any) -> None:
    """The run has ended, with an aligned needle, and the model held."""
    page.locator(".ended").wait_for()
    assert ": aligned" in page.locator(".ended").inner_text()
    assert page.locator(".alarm").inner_text() == ""


def reloaded_while(page: Any, served: Served, kind: str) -> None:
    """Load the page anew while this work goes on; it is shown there, too."""
    page.get_by_role("region", name="Work").get_by_role("button", name="Cancel").wait_for()
    page.reload()
    jobs = served.ask("GET", "/api/jobs").json()["jobs"]
    assert [job["state"] for job in jobs if job["kind"] == kind] == ["running"]
    page.get_by_role("region", name="Work").get_by_role("button", name="Cancel").wait_for()


def reloaded(page: Any, wanted: str) -> None:
    page.reload()
    page.locator(wanted).first.wait_for()
