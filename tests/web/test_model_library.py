"""The library of models: a file is opened there, and two models stand side by side, value by value."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from tests.web.looking import IN_BROWSER, Open, look_at
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER


def test_a_file_is_opened_and_two_models_are_compared(visit: Open, served: Served, tmp_path: Path) -> None:
    page = visit("models", served=served)
    page.set_default_timeout(60_000)
    uncertain = {"friction_nmm_per_100mm": 0.001}
    for name in ("rig_elastic", "rig_rigid"):
        save_model(tmp_path / f"{name}.yaml", SavedModel(load_parameters(name), name, uncertain))
        page.goto(f"{served.base}/#/models")
        page.get_by_label("Open a model file").set_input_files(tmp_path / f"{name}.yaml")
        page.wait_for_url(re.compile("#/models/."))
    page.get_by_role("button", name="Set as the rig's").click()
    page.get_by_text("the rig's model", exact=True).wait_for()
    page.goto(f"{served.base}/#/models")
    side = page.get_by_role("button", name="Side by side")
    expect(side).to_have_attribute("aria-disabled", "true")
    for box in page.get_by_label(re.compile("^Mark ")).all():
        box.check()
    expect(side).to_have_attribute("aria-disabled", "false")
    expect(page.get_by_role("row", name=re.compile("rig rigid.*the rig's"))).to_have_count(1)
    look_at(page, "models")
    side.click()
    table = page.get_by_role("group", name="Two models")
    table.wait_for()
    told = {
        line.split("\t")[0]: line.split("\t")[1:] for line in table.inner_text().splitlines() if "\t" in line
    }
    stiffness = next(cells for name, cells in told.items() if "stiffness" in name)
    assert "not in it" in stiffness
    assert stiffness[2] == "–"
    friction = next(cells for name, cells in told.items() if name.startswith("friction"))
    assert re.fullmatch(r"[+−][\d.]+ σ|beyond [+−]8 σ", friction[2])
    look_at(page, "models-side-by-side")
    page.reload()
    table.wait_for()
