"""The page in a real browser: the circle by clicks, the rig, what breaks, keyboard and accessibility."""

from __future__ import annotations

import os
import re
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.notebook import simulate
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium"),
    pytest.mark.timeout(900),
]

PICTURES = Path(__file__).parents[2] / "build" / "page"
WIDE, NARROW = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
PATIENCE_MS = 600_000
"""A diagnosis beside other tests."""
EVIL = "<img src=x onerror=window.evil=1>"
PAGES = ("live", "workbench", "runs", "learn", "strategies")

Open = Callable[..., Any]


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with playwright.sync_playwright() as started_:
        found = started_.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def data(shell: Shell) -> Path:
    """A practice set with a hidden effect, and one whose every name is an attack."""
    simulate({"tissue_elasticity": 0.35}, seed=1, name="mine", out=shell.folder / "data" / "mine")
    simulate({}, seed=2, name=EVIL, out=shell.folder / "data" / "names")
    description = shell.folder / "data" / "names" / "dataset.yaml"
    text = description.read_text().replace("hall_1", "'<i onclick=evil()>hall'", 1)
    description.write_text(text)
    for trial in (shell.folder / "data" / "names" / "trials").glob("*.csv"):
        rows = trial.read_text().replace("hall_1_deg", "<i onclick=evil()>hall_deg").replace("rotate", EVIL)
        trial.write_text(rows)
    return Path(shell.folder) / "data"


@pytest.fixture(scope="module")
def page_server(shell: Shell, data: Path) -> Iterator[Served]:
    """With the data and a simulated rig in virtual time."""
    runs = str(shell.folder / "runs")
    yield from started(shell, str(data), "--rig", "simulated", "--fast", "--dir", runs, "--jobs", "2")


@pytest.fixture
def visit(browser: Any, page_server: Served) -> Iterator[Open]:
    """Open the page; at the end it has made no request to another host and met no error of its own."""
    contexts = []
    wrong: list[str] = []

    def opened(
        where: str = "live", size: Any = WIDE, scheme: str = "light", served: Served = page_server
    ) -> Any:
        context = browser.new_context(viewport=size, color_scheme=scheme, reduced_motion="reduce")
        contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "request",
            lambda r: None if r.url.startswith((served.base, "blob:", "data:")) else wrong.append(r.url),
        )
        page.on(
            "console",
            lambda m: wrong.append(m.text) if "Content Security Policy" in m.text else None,
        )
        page.goto(served.address)
        page.goto(f"{served.base}/#/{where}")
        page.wait_for_selector("h1")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not wrong


def pictured(page: Any, name: str) -> None:
    PICTURES.mkdir(parents=True, exist_ok=True)
    page.evaluate("scrollTo(0, 0)")
    page.screenshot(path=PICTURES / f"{name}.png", full_page=True)


def test_the_whole_circle_by_clicks_finds_the_hidden_effect_and_lowers_the_error(visit: Open) -> None:
    page = visit("workbench")
    page.get_by_label("data/mine").check()
    page.wait_for_selector(".map")
    cell = page.locator(".map td button").nth(3)
    cell.click()
    assert cell.get_attribute("aria-pressed") == "true"
    assert page.get_by_role("button", name="Whole trial").is_visible()
    pictured(page, "where-it-fails")
    page.get_by_role("button", name="Diagnose").click()
    page.wait_for_selector(".verdict")
    assert page.locator(".verdict").inner_text().lower().startswith("tissue elasticity missing")
    page.locator("tbody button", has_text="tissue elasticity").hover()
    page.get_by_text("foretells, fitted").wait_for()
    pictured(page, "what-is-missing")
    page.get_by_role("button", name="Add tissue elasticity").click()
    page.get_by_role("heading", name="4 · The error falls").wait_for()
    before, after = (float(text) for text in page.locator(".bars strong").all_inner_texts())
    assert before > 10.0
    assert after < 1.5
    page.wait_for_selector(".map")
    pictured(page, "the-error-falls")
    with page.expect_download() as download:
        page.get_by_role("button", name="Model file").click()
    assert "tissue_elasticity" in Path(download.value.path()).read_text()
    page.get_by_role("button", name="Undo").click()
    page.wait_for_selector(".map")
    assert not page.get_by_role("heading", name="4 · The error falls").is_visible()


def test_cancel_ends_a_diagnosis_and_its_processes_within_a_second(visit: Open, page_server: Served) -> None:
    page = visit("workbench")
    page.get_by_label("data/mine").check()
    page.get_by_role("button", name="Diagnose").click()
    page.get_by_text("trying every effect").wait_for()
    page.get_by_role("button", name="Cancel").click()
    page.locator(".job").wait_for(state="detached", timeout=3000)
    running = page_server.shell.processes().values()
    assert not [line for line in running if "web.worker" in line or "spawn_main" in line]


def test_a_compensation_is_followed_to_its_end_and_stands_among_the_runs(visit: Open) -> None:
    page = visit("live")
    page.wait_for_selector(".shaft .curve")
    page.get_by_role("button", name="Compensate", exact=True).click()
    page.locator(".ended").wait_for()
    assert page.locator(".ended").inner_text().startswith("Simulated:")
    page.get_by_role("heading", name="Motions: foretold and measured").wait_for()
    pictured(page, "live")
    page.goto(page.url.split("#")[0] + "#/runs")
    row = page.locator("tbody tr").first
    row.wait_for()
    row.get_by_label("Tags of").fill("first, good")
    row.get_by_label("Tags of").press("Enter")
    page.get_by_label("Filter").fill("good")
    page.reload()
    page.wait_for_selector("tbody tr")
    assert page.locator("tbody tr").first.get_by_label("Tags of").input_value() == "first, good"
    with page.expect_download() as download:
        page.locator("tbody tr").first.get_by_label("Export").select_option("csv")
    assert "ticks.csv" in " ".join(zipfile.ZipFile(download.value.path()).namelist())


def test_names_from_files_are_shown_as_text(visit: Open) -> None:
    page = visit("workbench")
    page.get_by_label("data/names").check()
    page.wait_for_selector(".map")
    assert page.get_by_text("<img src=x").first.is_visible()
    assert page.locator("main img, main i").count() == 0
    assert page.evaluate("window.evil") is None


def test_a_zip_bomb_and_a_broken_dataset_are_refused_in_a_sentence_and_nothing_is_lost(
    visit: Open, tmp_path: Path
) -> None:
    page = visit("workbench")
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
    page = visit("workbench")
    page.get_by_label("choose files").set_input_files(packed)
    page.wait_for_selector(".map")
    assert page.get_by_text("upload", exact=True).is_visible()


def test_a_slider_redraws_the_standard_trial_within_a_tenth_of_a_second(visit: Open) -> None:
    page = visit("learn")
    page.get_by_role("button", name="tip friction").click()
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
            const headers = {Authorization: `Bearer ${sessionStorage.getItem("needle-rig-token")}`};
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


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_no_page_has_a_serious_finding_of_accessibility(visit: Open, name: str, scheme: str) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    for size, suffix in ((WIDE, "1440"), (NARROW, "390")):
        page = visit(name, size, scheme)
        ready = {"live": ".shaft", "workbench": ".sources label", "runs": ".orders", "learn": ".sliders"}
        page.wait_for_selector(ready.get(name, "form select"))
        if name == "learn":
            page.wait_for_selector(".plot canvas")
        pictured(page, f"{name}-{suffix}-{scheme}")
        found = axe.Axe().run(page).response["violations"]
        serious = [v for v in found if v["impact"] in ("serious", "critical")]
        assert not serious, [(v["id"], [n["html"][:120] for n in v["nodes"][:3]]) for v in serious]
        wider = page.evaluate("document.documentElement.scrollWidth - window.innerWidth")
        assert wider <= 0, "the page scrolls sideways"


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
        assert "connection is lost" in page.get_by_role("alert").first.inner_text()


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
        assert "start one: needle-rig daemon" in page.get_by_role("alert").first.inner_text()
