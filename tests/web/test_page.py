"""The page in a real browser: the circle by clicks, the rig, what breaks, keyboard and accessibility."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from pathlib import Path
from typing import Any

import pytest

from needle_rig.cli.main import run as command
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, VIEWS, Open, look_at, pictured
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
pytestmark = IN_BROWSER


def fallen(page: Any) -> tuple[float, float]:
    """The error before and after what was added, once the page shows it and has compared again."""
    page.get_by_role("heading", name="4 · The error falls").wait_for()
    before, after = (float(text) for text in page.locator(".bars strong").all_inner_texts())
    page.wait_for_selector(".map")
    return before, after


def test_the_whole_circle_by_clicks_finds_the_hidden_effect_and_lowers_the_error(visit: Open) -> None:
    page = visit("data")
    page.get_by_label("data/mine").check()
    page.wait_for_selector(".map")
    cell = page.locator(".map td button").nth(3)
    cell.click()
    assert cell.get_attribute("aria-pressed") == "true"
    assert page.get_by_role("button", name="Whole trial").is_visible()
    pictured(page, "where-it-fails")
    look_at(page, "workbench-where-it-fails")
    page.get_by_role("button", name="Diagnose", exact=True).click()
    page.wait_for_selector(".verdict")
    assert page.locator(".verdict").inner_text() == "The model lacks tissue elasticity."
    page.locator("tbody button", has_text="tissue elasticity").hover()
    page.get_by_text("predicts, fitted").wait_for()
    pictured(page, "what-is-missing")
    look_at(page, "workbench-what-is-missing")
    with page.expect_download() as sent:
        page.get_by_role("button", name="Report as one file").click()
    report = Path(sent.value.path()).read_text()
    assert "tissue_elasticity" in report
    assert report.count("data:image/png;base64,") == 3
    page.get_by_role("button", name="Add tissue elasticity").click()
    before, after = fallen(page)
    assert before > 10.0
    assert after < 1.5
    pictured(page, "the-error-falls")
    look_at(page, "workbench-the-error-falls")
    with page.expect_download() as download:
        page.get_by_role("button", name="Model file").click()
    assert "tissue_elasticity" in Path(download.value.path()).read_text()
    page.get_by_role("link", name="Undo").click()
    page.get_by_role("heading", name="4 · The error falls").wait_for(state="detached")
    # the diagnosis of the model before stands there still
    page.get_by_role("button", name="Add tissue elasticity").wait_for(timeout=10_000)


def test_cancel_ends_a_diagnosis_and_its_processes_within_a_second(visit: Open, page_server: Served) -> None:
    page = visit("data")
    page.get_by_label("data/names").check()
    page.get_by_role("button", name="Diagnose", exact=True).click()
    page.get_by_text("trying every effect").first.wait_for()
    page.get_by_role("button", name="Cancel").first.click()
    page.locator(".job").first.wait_for(state="detached", timeout=3000)
    running = page_server.shell.processes().values()
    assert not [line for line in running if "web.worker" in line or "spawn_main" in line]


def test_a_compensation_is_followed_to_its_end_and_stands_among_the_runs(visit: Open) -> None:
    page = visit("live")
    page.wait_for_selector(".shaft .curve")
    page.get_by_role("button", name="Compensate", exact=True).click()
    page.locator(".ended").wait_for()
    assert page.locator(".ended").inner_text().startswith("Simulated:")
    page.get_by_role("heading", name="Motions: predicted and measured").wait_for()
    pictured(page, "live")
    look_at(page, "live-ended")
    page.goto(page.url.split("#")[0] + "#/runs")
    page.locator("tbody th a").first.click()
    page.get_by_label("Tags of").fill("first, good")
    page.get_by_label("Tags of").press("Enter")
    page.wait_for_selector(".plot canvas")
    look_at(page, "run")
    page.reload()
    playwright.expect(page.get_by_label("Tags of")).to_have_value("first, good")
    with page.expect_download() as download:
        page.get_by_role("button", name="CSV").click()
    assert "ticks.csv" in " ".join(zipfile.ZipFile(download.value.path()).namelist())


def test_names_from_files_are_shown_as_text(visit: Open) -> None:
    page = visit("data")
    page.get_by_label("data/names").check()
    page.wait_for_selector(".map")
    assert page.get_by_text("<img src=x").first.is_visible()
    assert page.locator("main img, main i").count() == 0
    assert page.evaluate("window.evil") is None


def test_a_zip_bomb_and_a_broken_dataset_are_refused_in_a_sentence_and_nothing_is_lost(
    visit: Open, tmp_path: Path
) -> None:
    page = visit("data")
    page.get_by_label("data/mine").check()
    page.wait_for_selector(".map")
    bomb = tmp_path / "bomb.zip"
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        for k in range(5):
            archive.writestr(f"{k}.csv", b"0" * (60 << 20))
    page.get_by_label("choose files").set_input_files(bomb)
    page.get_by_role("alert").filter(has_text="larger than 256 MiB").wait_for()
    assert page.locator(".map").is_visible()
    broken = tmp_path / "dataset.yaml"
    broken.write_text("format: needle-rig-dataset/1\nname: [")
    page.get_by_label("choose files").set_input_files(broken)
    page.get_by_role("alert").filter(has_text="dataset.yaml").wait_for()
    page.get_by_label("data/mine").check()
    page.wait_for_selector(".map")


def test_a_dataset_that_is_dropped_as_a_zip_is_compared(visit: Open, data: Path, tmp_path: Path) -> None:
    packed = shutil.make_archive(str(tmp_path / "mine"), "zip", data, "mine")
    page = visit("data")
    page.get_by_label("choose files").set_input_files(packed)
    page.wait_for_selector(".map")
    assert page.get_by_text("upload", exact=True).last.is_visible()


def test_a_slider_redraws_the_standard_trial_within_a_tenth_of_a_second(visit: Open) -> None:
    page = visit("effects")
    page.get_by_role("link", name="tip friction").click()
    page.get_by_text("Change against the null model, in units").wait_for()
    slider = page.locator("input[type=range]").first
    cell = page.locator("tbody td").first
    before = cell.inner_text()
    slider.focus()
    for _ in range(10):
        page.keyboard.press("ArrowRight")
    playwright.expect(cell).not_to_have_text(before)
    took = page.evaluate(
        """async () => {
            const headers = {"X-Needle-Rig-Page": localStorage.getItem("needle-rig-page")};
            const times = [];
            for (let k = 0; k < 20; k += 1) {
                const begun = performance.now();
                const body = JSON.stringify({effect: "tip_friction", values: {torque_nmm: 0.02 + k / 1000}});
                await (await fetch("/api/lesson", {method: "POST", headers, body})).json();
                times.push(performance.now() - begun);
            }
            return times.sort((a, b) => a - b)[10];
        }"""
    )
    assert took < 100.0


@pytest.mark.parametrize("name", VIEWS)
def test_no_page_has_a_serious_finding_of_accessibility(visit: Open, name: str) -> None:
    page = visit(name)
    ready = {"live": ".shaft", "data": ".sources label", "effects": ".sliders", "strategies": "form select"}
    page.wait_for_selector(ready.get(name, ".card"))
    if name == "effects":
        page.wait_for_selector(".plot canvas")
    look_at(page, name)


def test_two_runs_side_by_side_and_a_table_of_strategies_are_accessible_too(
    visit: Open, page_server: Served
) -> None:
    page = visit("live")
    page.wait_for_selector(".shaft .curve")
    for _ in range(2):
        before = ended(page_server)
        page.get_by_role("button", name="Compensate", exact=True).click()
        for _ in range(600):
            if ended(page_server) > before:
                break
            page.wait_for_timeout(100)
    page.goto(page.url.split("#")[0] + "#/runs")
    page.locator("tbody tr").nth(1).wait_for()
    for box in page.locator("tbody input[type=checkbox]").all()[:2]:
        box.check()
    page.get_by_role("button", name="Side by side").click()
    page.wait_for_selector(".grid2 canvas")
    look_at(page, "runs-side-by-side")
    page.goto(page.url.split("#")[0] + "#/strategies")
    page.get_by_label("Runs of each kind").fill("1")
    page.get_by_role("button", name="Run every strategy").click()
    page.get_by_role("heading", name="Side by side").wait_for()
    look_at(page, "strategies-side-by-side")


def ended(served: Served) -> int:
    """How many recorded runs have ended."""
    runs = served.ask("GET", "/api/runs").json()["runs"]
    return sum(run["status"] in ("aligned", "not_aligned") for run in runs)


def reach(page: Any, selector: str) -> None:
    """Tab until this has the focus."""
    for _ in range(400):
        if page.evaluate("s => document.activeElement.matches(s)", selector):
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {selector}")


def test_the_whole_circle_by_keyboard_alone(visit: Open, shell: Shell, data: Path, tmp_path: Path) -> None:
    for served in started(shell, str(data), "--dir", str(tmp_path), "--jobs", "2"):
        circle_by_keyboard(visit("live", served=served))


def circle_by_keyboard(page: Any) -> None:
    """From the data to a model and back."""
    reach(page, "nav a[href='#/data']")
    page.keyboard.press("Enter")
    page.wait_for_selector(".sources label")
    reach(page, ".sources input")
    named = "document.activeElement.closest('label')?.innerText.includes('data/mine')"
    for _ in range(20):
        if page.evaluate(named):
            break
        page.keyboard.press("ArrowDown")
    page.keyboard.press(" ")
    page.wait_for_selector(".map")
    assert page.evaluate(named)
    reach(page, ".map td button")
    page.keyboard.press("Enter")
    page.get_by_role("button", name="Whole trial").wait_for()
    reach(page, "button.go")
    page.keyboard.press("Enter")
    page.wait_for_selector(".verdict")
    reach(page, "button.go:not(:disabled)")
    assert "tissue elasticity" in page.evaluate("document.activeElement.innerText").lower()
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="4 · The error falls").wait_for()
    page.wait_for_selector(".map")
    undo = "document.activeElement.innerText === 'Undo'"
    for _ in range(400):
        if page.evaluate(undo):
            break
        page.keyboard.press("Tab")
    page.keyboard.press("Enter")
    page.get_by_role("heading", name="4 · The error falls").wait_for(state="detached")


def test_everything_is_reached_by_keyboard_alone(visit: Open) -> None:
    page = visit("live")
    page.wait_for_selector(".shaft")
    reached = set()
    for _ in range(30):
        page.keyboard.press("Tab")
        reached.add(page.evaluate("document.activeElement.innerText || document.activeElement.tagName"))
    assert {"Live", "Workbench", "Stop", "Compensate", "Jog", "Home", "Clear"} <= reached


@pytest.mark.real_time
@pytest.mark.parametrize("how", ["mouse", "Escape", "Space"])
def test_stop_by_mouse_and_by_key_brings_the_needle_to_a_stand(
    visit: Open, shell: Shell, tmp_path: Path, how: str
) -> None:
    for served in started(shell, "--rig", "simulated", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        page.wait_for_selector(".shaft")
        page.get_by_label("Jog by").fill("300")
        page.get_by_role("button", name="Jog", exact=True).click()
        page.locator(".phase", has_text="moves").wait_for()
        if how == "mouse":
            page.get_by_role("button", name="Stop").click()
        else:
            page.keyboard.press(how)
        playwright.expect(page.locator(".phase")).to_have_text(re.compile("stopped|at rest"), timeout=5000)
        page.wait_for_timeout(500)  # the stop is shown while the base still slows down
        base = page.locator(".readings dd").first.inner_text()
        page.wait_for_timeout(500)
        after = page.locator(".readings dd").first.inner_text()
        assert abs(float(after[:-1]) - float(base[:-1])) < 0.1
        assert float(after[:-1]) < 290.0


def test_a_lost_page_server_greys_everything_within_a_second(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--rig", "simulated", "--fast", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        page.wait_for_selector(".live:not(.grey)")
        os.kill(served.process.pid, 9)
        page.wait_for_selector(".live.grey", timeout=1500)
        page.get_by_role("alert").filter(has_text="connection is lost").wait_for(timeout=1500)


def test_a_lost_daemon_greys_everything_and_says_what_to_do(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--rig", "simulated", "--fast", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        page.wait_for_selector(".live:not(.grey)")
        for pid, line in served.shell.processes().items():
            if "--private" in line and str(tmp_path) in line:
                os.kill(pid, 9)
        page.wait_for_selector(".live.grey", timeout=2500)
        # a daemon that is started now would not be that of this page
        told = page.get_by_role("alert").first.inner_text()
        assert "the rig of this page has ended; start needle-rig web again" in told


@pytest.mark.long
def test_a_law_that_nobody_told_it_is_learnt_added_and_taken_back(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    folder, law = tmp_path / "data" / "hidden", Path(__file__).parents[1] / "data" / "effects"
    words = ["simulate", "--effects", str(law), "--effect", "slit_membrane=0.03", "--seed", "3"]
    assert command([*words, "--parameters", "rig_rigid", "--out", str(folder)]) == 0
    for served in started(shell, str(tmp_path / "data"), "--dir", str(tmp_path / "runs")):
        page = visit("data", served=served)
        page.get_by_label("data/hidden").check()
        page.get_by_role("button", name="Diagnose quickly").click()
        page.wait_for_selector(".verdict")
        assert page.get_by_role("button", name="Look for several").is_enabled()
        assert "no effect of the library explains" in page.locator(".verdict").inner_text()
        on = page.get_by_role("list", name="How to go on").get_by_role("listitem").first.inner_text()
        assert "of the error above the noise" in on
        assert page.get_by_role("button", name=f"Add {on.partition(' explains')[0]}").is_enabled()
        page.get_by_role("button", name="Learn the law").click()
        page.locator("section.law h4", has_text="a torque in tissue section 3").wait_for()
        assert "sin(2" in page.locator("section.law strong").first.inner_text()
        look_at(page, "workbench-law")
        pictured(page, "law", "section.law")
        page.get_by_role("button", name="Add this law").click()
        before, after = fallen(page)
        assert before > 10.0
        assert after < 1.1
        page.get_by_role("link", name="Undo").click()
        page.get_by_role("heading", name="4 · The error falls").wait_for(state="detached")
