"""A phone: each view with all that it can show has no table that scrolls sideways."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from tests.web.looking import IN_BROWSER, NARROW, Open, pictured
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
pytestmark = IN_BROWSER

WIDER = """[...document.querySelectorAll("main *")].filter((e) => e.scrollWidth > e.clientWidth + 1
  && ["auto", "scroll"].includes(getComputedStyle(e).overflowX))
  .map((e) => `${e.getAttribute("aria-label") ?? e.className}: ${e.scrollWidth} px in ${e.clientWidth}`)"""
"""What scrolls sideways."""


def fits(page: Any, name: str) -> list[str]:
    """What of this view scrolls sideways in a light and in a dark scheme; pictures of both."""
    found = []
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        page.wait_for_timeout(300)  # plots are drawn anew
        pictured(page, f"narrow-{name}-{scheme}")
        found += [f"{name}, {scheme}: {wide}" for wide in page.evaluate(WIDER)]
    page.emulate_media(color_scheme="light")
    return found


def test_no_table_of_any_view_scrolls_sideways_on_a_phone(
    visit: Open, page_server: Served, tmp_path: Path
) -> None:
    base, wide = page_server.base, []
    page = visit("live", NARROW)
    page.wait_for_selector(".shaft .curve")
    for _ in range(2):
        page.get_by_role("button", name="Compensate", exact=True).click()
        page.wait_for_function("!document.querySelector('.ended')")
        page.locator(".ended").wait_for()
    page.get_by_role("heading", name="Motions: predicted and measured").wait_for()
    wide += fits(page, "live")
    page.goto(f"{base}/#/runs")
    page.locator("tbody tr").nth(1).wait_for()
    wide += fits(page, "runs")
    page.locator("tbody th a").first.click()
    page.wait_for_selector(".plot canvas")
    wide += fits(page, "run")
    page.goto(f"{base}/#/models")
    uncertain = {"friction_nmm_per_100mm": 0.001}
    for name in ("rig_elastic", "rig_rigid"):
        save_model(tmp_path / f"{name}.yaml", SavedModel(load_parameters(name), name, uncertain))
        page.goto(f"{base}/#/models")
        page.get_by_label("Open a model file").set_input_files(tmp_path / f"{name}.yaml")
        page.wait_for_url(f"**/#/models/{name}*")
    page.goto(f"{base}/#/models")
    for box in page.get_by_label("Mark ").all():
        box.check()
    wide += fits(page, "models")
    page.get_by_role("button", name="Side by side").click()
    page.get_by_role("group", name="Two models").wait_for()
    wide += fits(page, "two-models")
    page.goto(f"{base}/#/data/data/mine?model=rig_elastic")
    page.wait_for_selector(".map")
    wide += fits(page, "compared")
    page.goto(f"{base}/#/data/data/mine")
    page.wait_for_selector(".map")
    page.get_by_role("button", name="Diagnose quickly").click()
    page.wait_for_selector(".verdict")
    wide += fits(page, "diagnosed")
    page.get_by_role("button", name="Add tissue elasticity").click()
    page.get_by_role("heading", name="4 · The error falls").wait_for()
    page.wait_for_selector(".map")
    wide += fits(page, "fallen")
    page.goto(f"{base}/#/models")
    page.locator("tbody th a").first.click()
    page.get_by_role("group", name="Errors by channel").wait_for()
    wide += fits(page, "model")
    page.goto(f"{base}/#/effects/tissue_elasticity")
    page.get_by_role("group", name="Change by channel").wait_for()
    wide += fits(page, "effect")
    page.goto(f"{base}/#/strategies")
    page.get_by_label("Targets / °").fill("45")
    page.get_by_role("button", name="Run every strategy").click()
    page.get_by_role("group", name="Strategies").wait_for()
    wide += fits(page, "strategies")
    page.goto(f"{base}/#/trends")
    page.get_by_role("button", name="Look at new runs").wait_for()
    wide += fits(page, "trends")
    assert not wide, "\n".join(wide)
