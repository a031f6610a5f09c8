"""A run's own page: what was measured, a model held against it, settings, events, files, and its end."""

from __future__ import annotations

import csv
import io
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from needle_rig.recording import RunFile, runs_in
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, Open, look_at
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def folder(shell: Shell) -> Path:
    """With two runs, made by a command: no rig is needed to look at them."""
    folder = Path(shell.folder) / "own_page"
    for target in ("45", "-20"):
        arguments = ("--simulated", "--fast", "--no-picture", "--target", target, "--settle", "0.5")
        made = shell.run("compensate", *arguments, "--out", str(folder))
        assert made.returncode == 0, made.stderr
    return folder


@pytest.fixture(scope="module")
def pages(shell: Shell, folder: Path) -> Iterator[Served]:
    yield from started(shell, "--dir", str(folder))


def saved(page: Any, chart: str, kind: str) -> bytes:
    """What this chart is saved as."""
    place = page.locator("details.save").filter(has=page.get_by_label(f"Save the chart {chart}", exact=True))
    if place.get_attribute("open") is None:
        place.locator("summary").click()
    with page.expect_download(timeout=60_000) as download:
        place.get_by_role("button", name=kind).click()
    return Path(download.value.path()).read_bytes()


def test_a_run_is_read_on_its_own_page(visit: Open, pages: Served, folder: Path) -> None:
    name = sorted(path.stem for path in runs_in(folder))[0]
    page = visit(f"runs/{name}", served=pages)
    page.set_default_timeout(60_000)
    page.get_by_role("heading", name="Torque against angle").wait_for()
    run = RunFile(folder / f"{name}.h5")
    settings = page.locator(".settings").inner_text()
    assert "reed2008" in settings
    assert "rig elastic" in settings
    assert page.locator(".events tbody tr").count() == len(run.events)
    assert run.result is not None
    motions: Any = run.result["motions"]
    rows = page.get_by_role("group", name="Motions of the run").locator("tbody tr").all_inner_texts()
    assert [row.split()[0] for row in rows] == [str(motion["phase"]) for motion in motions]
    look_at(page, "run-page")

    choice = page.get_by_label("Hold a model against this run")
    choice.select_option("null model")
    page.get_by_label("torque: measured minus model, in units of the noise").wait_for(timeout=120_000)
    assert page.get_by_label(re.compile("measured minus model")).count() == 5
    table = list(csv.reader(io.StringIO(saved(page, f"{name}-torque-residual", "CSV").decode())))
    assert table[0] == ["time / s", "model: residual / σ"]
    assert len(table) > 100
    assert table[1][1], "what was turned before the record is not drawn"
    numbers = [float(row[1]) for row in table[1:] if row[1]]
    assert max(map(abs, numbers)) > 3, "elastic tissue is not rigid"
    look_at(page, "run-page-with-model")


def test_a_chart_is_saved_as_picture_as_drawing_and_as_numbers(
    visit: Open, pages: Served, folder: Path
) -> None:
    name = sorted(path.stem for path in runs_in(folder))[0]
    page = visit(f"runs/{name}", served=pages)
    page.set_default_timeout(60_000)
    page.get_by_role("heading", name="Torque against angle").wait_for()
    for chart in (f"{name}-base", f"{name}-loop"):
        assert saved(page, chart, "PNG").startswith(b"\x89PNG")
        drawing = saved(page, chart, "SVG")
        root = ElementTree.fromstring(drawing)
        assert root.tag.endswith("svg")
        assert drawing.count(b"<path") > 5
    table = list(csv.reader(io.StringIO(saved(page, f"{name}-loop", "CSV").decode())))
    assert table[0] == ["measured: base angle / °", "measured: torque / N·mm"]
    assert 40 < max(float(row[0]) for row in table[1:] if row[0]) < 100


def test_a_stretch_is_zoomed_in_all_charts_at_once_and_shown_whole_again(
    visit: Open, pages: Served, folder: Path
) -> None:
    name = sorted(path.stem for path in runs_in(folder))[0]
    page = visit(f"runs/{name}", served=pages)
    page.set_default_timeout(60_000)
    page.get_by_role("heading", name="Torque against angle").wait_for()
    charts = page.locator(".chart").filter(has=page.locator("[tabindex='0']"))
    count = charts.count()
    assert count == 6
    place = charts.first.locator(".u-over").bounding_box()
    page.mouse.move(place["x"] + place["width"] * 0.3, place["y"] + 40)
    readout = charts.nth(1).locator(".said")
    expect(readout).to_have_text(re.compile(r"time \d+\.\d\d · measured −?\d"))
    page.mouse.down()
    page.mouse.move(place["x"] + place["width"] * 0.6, place["y"] + 40, steps=5)
    page.mouse.up()
    whole = page.get_by_role("button", name="Show all")
    expect(whole).to_have_count(count)
    whole.first.click()
    expect(whole).to_have_count(0)
    # the same by keys alone
    charts.nth(2).locator("[tabindex='0']").focus()
    page.keyboard.press("+")
    expect(whole).to_have_count(count)
    page.keyboard.press("0")
    expect(whole).to_have_count(0)


def test_a_run_is_deleted_after_a_second_word(visit: Open, pages: Served, folder: Path) -> None:
    name = sorted(path.stem for path in runs_in(folder))[-1]
    page = visit(f"runs/{name}", served=pages)
    page.set_default_timeout(60_000)
    page.get_by_label(f"Note on {name}").fill("of no use")
    page.get_by_label(f"Note on {name}").blur()
    deadline_s = time.monotonic() + 20
    while not (folder / f"{name}.notes.json").exists():
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
    page.get_by_role("button", name="Delete …").click()
    page.get_by_role("button", name="Keep").click()
    assert (folder / f"{name}.h5").exists()
    page.get_by_role("button", name="Delete …").click()
    page.get_by_role("button", name="Delete", exact=True).click()
    page.wait_for_url(re.compile("#/runs$"))
    # on a busy machine the header still says that its traces are read
    expect(page.locator("main").get_by_role("link", name=name)).to_have_count(0)
    assert not list(folder.glob(f"{name}.*"))
    for gone in (name, "..%2Fown_page", ".page"):
        assert pages.ask("DELETE", f"/api/runs/{gone}").status_code in (404, 405, 422)
