"""Work belongs to the server: reloads, tabs, restarts find it; no result stands under another's name."""

from __future__ import annotations

import os
import re
import signal
from pathlib import Path
from typing import Any

import pytest

from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, WIDE, Open, look_at
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
pytestmark = IN_BROWSER

SOON_MS = 8000
"""So long a result that is there may take to be shown."""
NO_SUCH = {
    "data/nothing": "nothing: no such data here",
    "data/data/mine?model=nothing": "nothing: no such model here",
    "models/nothing": "nothing: no such model here",
    "effects/nothing": "nothing: no such effect in the library",
    "runs/nothing": "nothing: no such run in the list",
}


def compared(page: Any, name: str) -> Any:
    """Where the model fails on these data."""
    return page.locator("section", has=page.get_by_role("heading", name="2 · Where it fails")).filter(
        has_text=f"{name} against"
    )


def kinds(served: Served) -> list[str]:
    """Of all jobs of a server."""
    return [job["kind"] for job in served.ask("GET", "/api/jobs").json()["jobs"]]


def test_a_reload_a_second_tab_and_a_restart_find_the_work_again(
    visit: Open, shell: Shell, data: Path, tmp_path: Path
) -> None:
    arguments = (str(data), "--dir", str(tmp_path), "--jobs", "2")
    for served in started(shell, *arguments):
        page = visit("data", served=served)
        page.get_by_label("data/mine").check()
        compared(page, "mine").wait_for()
        assert page.url.endswith("#/data/data/mine")
        page.get_by_label("Model to hold").select_option("rig_elastic")
        page.get_by_role("heading", name="Values: as the model says, and refitted").wait_for()
        page.go_back()
        page.get_by_role("heading", name="Values, fitted").wait_for(timeout=SOON_MS)
        page.go_forward()
        page.get_by_role("heading", name="Values: as the model says, and refitted").wait_for(timeout=SOON_MS)
        page.reload()
        page.get_by_role("heading", name="Values: as the model says, and refitted").wait_for(timeout=SOON_MS)
        second = page.context.new_page()
        second.goto(f"{served.base}/#/data/data/mine?model=rig_elastic")
        second.get_by_role("heading", name="Values: as the model says, and refitted").wait_for(
            timeout=SOON_MS
        )
        assert kinds(served) == ["compare", "compare"]
        page.get_by_role("button", name="Diagnose quickly").click()
        page.get_by_text("trying every effect").first.wait_for()
    # the server was ended while the diagnosis ran
    for served in started(shell, *arguments):
        page = visit("data/data/mine?model=rig_elastic", served=served)
        page.get_by_role("heading", name="Values: as the model says, and refitted").wait_for(timeout=SOON_MS)
        page.get_by_text("needle-rig web was closed while this ran").wait_for()
        page.get_by_role("button", name="Dismiss what came of the work").click()
        page.get_by_role("button", name="torque against angle").click()  # it compares again for its figure
        page.locator(".paper img").wait_for()
        assert sorted(kinds(served)) == ["compare", "compare", "diagnose", "figure"]


def test_what_runs_is_in_the_header_of_every_view_and_its_result_is_a_click_away(
    visit: Open, shell: Shell, data: Path, tmp_path: Path
) -> None:
    for served in started(shell, str(data), "--dir", str(tmp_path), "--jobs", "2"):
        page = visit("data/data/mine", served=served)
        compared(page, "mine").wait_for()
        button = page.get_by_role("button", name="Diagnose quickly")
        button.scroll_into_view_if_needed()
        button.click()
        at_button = page.locator("main .job")
        at_button.wait_for()
        box = at_button.bounding_box()
        assert 0 <= box["y"] < WIDE["height"]  # progress stands where the button stood
        strip = page.get_by_role("region", name="Work")
        for view in ("live", "runs", "models", "strategies"):
            page.goto(f"{served.base}/#/{view}")
            strip.get_by_text("Diagnose data/mine").wait_for()
            assert strip.get_by_role("button", name="Cancel").is_visible()
        page.get_by_text(re.compile(r"trying every effect.* · \d+ of \d+")).first.wait_for()
        look_at(page, "strip")
        other = page.context.new_page()
        other.goto(f"{served.base}/#/live")
        other.get_by_role("region", name="Work").get_by_text("Diagnose data/mine").wait_for()
        page.reload()
        page.get_by_role("link", name="Show the result").click()
        page.wait_for_selector(".verdict")
        assert page.url.endswith("#/data/data/mine")
        strip.wait_for(state="detached")
        # requested in the other tab, it is there at once
        other.goto(f"{served.base}/#/data/data/mine")
        other.wait_for_selector(".verdict", timeout=SOON_MS)
        page.get_by_role("button", name="Add tissue elasticity").click()
        page.get_by_role("heading", name="4 · The error falls").wait_for()
        model = page.url.split("model=")[1]
        page.get_by_role("link", name="All about this model").click()
        assert page.url.endswith(f"#/models/{model}")
        page.wait_for_selector(".bars")
        look_at(page, "model")
        page.get_by_role("link", name="Hold against its data").click()
        compared(page, "mine").wait_for()
        page.get_by_role("link", name="Undo").click()
        page.get_by_role("button", name="Add tissue elasticity").wait_for(timeout=SOON_MS)


def test_no_result_stands_under_the_name_of_other_data(visit: Open, page_server: Served) -> None:
    page = visit("data")
    page.get_by_label("data/mine").check()
    page.get_by_role("radio", name="reed2008").check()
    compared(page, "reed2008").wait_for()
    page.wait_for_timeout(1000)
    assert page.get_by_role("radio", name="reed2008").is_checked()
    assert page.locator("section", has_text="mine against").count() == 0
    page.get_by_role("button", name="Diagnose", exact=True).click()
    page.locator("main .job").wait_for()
    page.get_by_label("data/mine").check()
    compared(page, "mine").wait_for()
    page.get_by_role("link", name="Show the result").wait_for()  # of reed2008
    assert page.locator(".verdict").count() == 0
    assert page.get_by_role("button", name="Diagnose", exact=True).is_enabled()
    page.get_by_role("link", name="Show the result").click()
    page.wait_for_selector(".verdict")
    assert page.get_by_role("radio", name="reed2008").is_checked()
    # a comparison that nobody looks at any more was ended
    jobs = page_server.ask("GET", "/api/jobs").json()["jobs"]
    first = next(job for job in jobs if job["kind"] == "compare" and job["data"][0]["name"] == "data/mine")
    assert first["state"] in ("cancelled", "done")


@pytest.mark.parametrize("where", NO_SUCH)
def test_a_link_to_what_is_not_there_is_a_sentence(visit: Open, where: str) -> None:
    page = visit(where)
    page.get_by_role("alert").filter(has_text=NO_SUCH[where]).wait_for()


def test_an_effect_has_an_address(visit: Open) -> None:
    page = visit("effects/tip_friction")
    page.get_by_role("heading", name="tip friction").wait_for()
    page.get_by_role("link", name="tissue elasticity").click()
    assert page.url.endswith("#/effects/tissue_elasticity")
    page.go_back()
    page.get_by_role("heading", name="tip friction").wait_for()


@pytest.fixture
def opened(browser: Any) -> Any:
    context = browser.new_context(viewport=WIDE)
    context.set_default_timeout(SOON_MS)
    yield context
    context.close()


def test_a_new_tab_needs_no_token_and_a_link_without_one_says_what_to_paste(
    browser: Any, opened: Any, page_server: Served
) -> None:
    alone = browser.new_context()
    page = alone.new_page()
    page.goto(f"{page_server.base}/#/runs")
    page.get_by_role("alert").filter(has_text="This link is incomplete").wait_for()
    page.goto(page_server.address)  # pasted into the same tab: only the part after # changes
    page.wait_for_selector(".shaft")
    alone.close()
    first = opened.new_page()
    first.goto(page_server.address)
    first.wait_for_selector(".shaft")
    assert page_server.token not in first.url
    assert first.evaluate("document.cookie") == ""  # no script reads it
    with opened.expect_page() as new:
        first.get_by_role("link", name="Runs").click(modifiers=["Control"])
    new.value.get_by_role("heading", name="Runs").wait_for()
    new.value.wait_for_selector(".link.on")
    kept = first.evaluate("JSON.stringify({...localStorage, ...sessionStorage})")
    assert page_server.token not in kept


def test_a_key_of_an_earlier_server_is_told_as_what_it_is(opened: Any, shell: Shell, tmp_path: Path) -> None:
    port = 0
    for served in started(shell, "--dir", str(tmp_path)):
        port = served.port
        page = opened.new_page()
        page.goto(served.address)
        page.get_by_role("heading", name="No rig").wait_for()
    page.get_by_text("The page's server does not answer").first.wait_for()
    for served in started(shell, "--dir", str(tmp_path), "--port", str(port)):
        page.get_by_role("alert").filter(has_text="This page's key is no longer valid").wait_for()
        page.goto(served.address)
        page.get_by_role("alert").wait_for(state="detached")
        wrong = opened.new_page()
        wrong.goto(f"{served.base}/#token=wrong")
        wrong.get_by_role("alert").filter(has_text="This page's key is no longer valid").wait_for()


def test_a_second_server_beside_the_same_runs_says_that_its_work_is_not_kept(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for _ in started(shell, "--dir", str(tmp_path)):
        for second in started(shell, "--dir", str(tmp_path)):
            page = visit("live", served=second)
            page.get_by_text("another needle-rig web keeps its work in").wait_for()
            os.kill(second.process.pid, signal.SIGTERM)
