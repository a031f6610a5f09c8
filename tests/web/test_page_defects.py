"""What a person met on the page and should not have: each is asked in a real browser."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.web.uploads import UPLOADS
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, NARROW, Open
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER
LONGEST = 4000


@pytest.fixture(scope="module")
def rig(shell: Shell) -> Iterator[Served]:
    """The page with a simulated rig alone, which has recorded one run."""
    yield from started(shell, "--rig", "simulated", "--fast", "--dir", str(shell.folder / "defects"))


def compensated(page: Any) -> None:
    page.wait_for_selector(".shaft .curve")
    page.get_by_role("button", name="Compensate", exact=True).click()
    page.locator(".ended").wait_for()


def test_a_jog_has_no_part_in_the_result_of_the_run_before_it(visit: Open, rig: Served) -> None:
    page = visit("live", served=rig)
    compensated(page)
    assert page.get_by_role("link", name="Diagnose this run").is_visible()
    page.get_by_role("button", name="Jog", exact=True).click()
    page.locator(".ended").wait_for(state="detached", timeout=10_000)
    page.get_by_label("Jog by").fill("20")
    page.get_by_role("button", name="Jog", exact=True).click()
    page.wait_for_timeout(1000)
    assert page.locator(".ended").count() == 0


def test_a_drive_that_waits_is_not_told_as_a_fault(visit: Open, shell: Shell, tmp_path: Path) -> None:
    for served in started(shell, "--rig", "simulated", "--fast", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        drive = page.locator(".readings div", has_text="drive")
        expect(drive).to_have_text("drivewaits for the first order")
        page.get_by_role("button", name="Jog", exact=True).click()
        expect(page.locator(".phase")).to_have_text("done", timeout=30_000)
        # its command for where the jog ended is in force
        expect(drive).to_have_text("driveholds the base")
        page.get_by_role("button", name="Hold", exact=True).click()
        expect(drive).to_have_text("driveholds the base")
        expect(page.locator(".phase")).to_have_text(re.compile("holds the base · waits for a release"))
        assert page.locator("progress").count() == 0
        page.get_by_role("button", name="Release", exact=True).click()
        page.get_by_text("The base is released.").wait_for()


@pytest.mark.real_time
def test_a_drive_of_a_rig_in_real_time_says_when_it_turns_the_base(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--rig", "simulated", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        drive = page.locator(".readings div", has_text="drive")
        expect(drive).to_have_text("drivewaits for the first order")
        page.get_by_label("Jog by").fill("90")
        page.get_by_role("button", name="Jog", exact=True).click()
        expect(drive).to_have_text("driveturns the base")
        expect(drive).to_have_text("driveready", timeout=30_000)


def test_the_focus_stays_on_the_button_that_was_pressed(visit: Open, rig: Served) -> None:
    page = visit("live", served=rig)
    page.wait_for_selector(".shaft .curve")
    page.get_by_label("Jog by").fill("30")
    jog = page.get_by_role("button", name="Jog", exact=True)
    jog.focus()
    page.keyboard.press("Enter")
    for _ in range(10):
        assert page.evaluate("document.activeElement.innerText") == "Jog"
        page.wait_for_timeout(50)


def test_the_shafts_letters_stay_readable_when_the_window_becomes_narrow(visit: Open, rig: Served) -> None:
    page = visit("live", served=rig)
    page.wait_for_selector(".shaft .curve")
    page.set_viewport_size(NARROW)
    page.wait_for_timeout(300)
    heights = page.locator(".shaft text").evaluate_all(
        "all => all.map((t) => t.getBoundingClientRect().height)"
    )
    assert min(heights) >= 11.0


def test_a_phone_shows_every_view_and_the_whole_of_a_run_without_scrolling_sideways(
    visit: Open, rig: Served
) -> None:
    page = visit("live", served=rig)
    compensated(page)
    page.set_viewport_size(NARROW)
    page.goto(f"{rig.base}/#/runs")
    page.locator("tbody th a").first.wait_for()
    row = page.locator("tbody tr").first
    parts = [row.locator("input"), row.get_by_text("aligned"), row.locator("[data-label='duration / s']")]
    for part in (*page.locator("nav a").all(), *parts):
        box = part.bounding_box()
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= NARROW["width"], part.inner_text()


def test_two_tabs_keep_each_others_note_and_tags_and_a_refused_note_stays_written(
    visit: Open, rig: Served
) -> None:
    page = visit("live", served=rig)
    compensated(page)
    page.get_by_role("link", name="This run", exact=True).click()
    page.get_by_label("Tags of").wait_for()
    other = page.context.new_page()
    other.goto(page.url)
    other.get_by_label("Tags of").wait_for()
    page.get_by_label("Note on").press_sequentially("seen by one", delay=100)  # drawn anew meanwhile
    with page.expect_response("**/notes"):
        page.get_by_label("Note on").press("Tab")
    other.get_by_label("Tags of").fill("by another")
    other.get_by_label("Tags of").press("Tab")
    expect(other.get_by_label("Note on")).to_have_value("seen by one")
    page.reload()
    expect(page.get_by_label("Note on")).to_have_value("seen by one")
    expect(page.get_by_label("Tags of")).to_have_value("by another")
    assert page.get_by_label("Note on").get_attribute("maxlength") == str(LONGEST)
    page.get_by_label("Tags of").fill("x" * 50)
    page.get_by_label("Tags of").press("Tab")
    page.get_by_role("alert").filter(has_text="at most 40 characters").wait_for()
    expect(page.get_by_label("Tags of")).to_have_value("x" * 50)


def test_what_was_dropped_is_named_as_it_was_dropped_and_can_be_removed(
    visit: Open, rig: Served, tmp_path: Path
) -> None:
    (tmp_path / "日本語 файл.csv").write_text("no table\n")
    page = visit("data", served=rig)
    page.get_by_label("choose files").set_input_files(tmp_path / "日本語 файл.csv")
    alert = page.get_by_role("alert").filter(has_text="日本語 файл.csv")
    alert.wait_for()
    assert alert.locator("span").inner_text().startswith("日本語 файл.csv")
    assert not re.search(r"uploads|\.page|/tmp", alert.inner_text())
    page.get_by_role("button", name="Remove 日本語 файл.csv").click()
    page.get_by_role("radio", name="日本語 файл.csv").wait_for(state="detached")


def test_the_page_can_be_dropped_on_for_as_long_as_it_is_open(
    visit: Open, rig: Served, tmp_path: Path
) -> None:
    page = visit("data", served=rig)
    for k in range(UPLOADS + 5):  # refused: nothing of them stays
        key = rig.ask("POST", "/api/uploads", json={"name": f"refused {k}"}).json()["upload"]
        assert rig.ask("PUT", f"/api/uploads/{key}/a.py", content=b"").status_code == 422
    (tmp_path / "last.csv").write_text("no table\n")
    page.get_by_label("choose files").set_input_files(tmp_path / "last.csv")
    page.get_by_label("last.csv").first.wait_for()
