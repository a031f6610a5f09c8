"""The circle closes: a model goes to the rig, its run is held against it, and can be diagnosed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from needle_rig.recording import RunFile
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.looking import IN_BROWSER, Open, look_at
from tests.web.served import Served

playwright = pytest.importorskip("playwright.sync_api", reason="no playwright here: pip install playwright")
expect = playwright.expect
pytestmark = IN_BROWSER


@pytest.fixture(scope="module")
def rig(shell: Shell) -> Iterator[Served]:
    """A page with a simulated rig alone; its needle is that of `rig_elastic`."""
    yield from started(shell, "--rig", "simulated", "--fast", "--dir", str(shell.folder / "on_the_rig"))


def dropped(page: Any, folder: Path, name: str, parameters: str) -> None:
    """A model file, opened by the page; it shows that model then."""
    saved = SavedModel(load_parameters(parameters), parameters, {"friction_nmm_per_100mm": 0.001})
    save_model(folder / f"{name}.yaml", saved)
    page.goto(page.url.split("#")[0] + "#/data")
    page.get_by_label("choose files").set_input_files(folder / f"{name}.yaml")
    page.wait_for_url(re.compile("#/models/"))
    page.get_by_role("link", name="Use this model on the rig").wait_for()


def run_with_it(page: Any, target_deg: float) -> str:
    """Use the shown model on the rig, to the end of a run to another angle; how it ended."""
    page.get_by_role("link", name="Use this model on the rig").click()
    page.wait_for_selector(".shaft .curve")
    expect(page.get_by_label("Strategy")).to_have_value("planned")
    page.get_by_label("Target").fill(str(target_deg))
    page.get_by_role("button", name="Compensate", exact=True).click()
    page.locator(".ended").wait_for()
    return str(page.locator(".ended").inner_text())


def state(served: Served) -> dict[str, Any]:
    """The newest state that the page's server tells."""
    from websockets.sync.client import connect

    protocol: Any = ["needle-rig", f"token.{served.token}"]
    with connect(served.base.replace("http", "ws") + "/api/live", subprotocols=protocol) as socket:
        while True:
            told: dict[str, Any] = json.loads(socket.recv(10))
            if told.get("type") == "state":
                return told


def test_a_learnt_model_plans_a_run_on_the_rig_and_is_drawn_beside_it(
    visit: Open, rig: Served, tmp_path: Path
) -> None:
    page = visit("data", served=rig)
    dropped(page, tmp_path, "elastic", "rig_elastic")
    page.get_by_role("link", name="Use this model on the rig").click()
    page.get_by_text("Nothing turns before").wait_for()
    before = state(rig)
    assert before["phase"] == "idle", "choosing a model is no order"
    assert before["model"] is None
    page.go_back()
    assert "aligned:" in run_with_it(page, 45.0)
    assert "not aligned" not in page.locator(".ended").inner_text()
    page.get_by_text("expected by rig elastic").first.wait_for()
    assert page.locator(".alarm").inner_text() == "", "the true model is not left"
    assert state(rig)["model"] == "rig_elastic"
    run = RunFile(state(rig)["last"]["result"]["run"])
    assert run.attributes["model"] == "rig_elastic"
    look_at(page, "live-with-model")


def test_a_model_that_is_wrong_is_told_while_the_run_goes(visit: Open, rig: Served, tmp_path: Path) -> None:
    page = visit("data", served=rig)
    dropped(page, tmp_path, "rigid", "rig_rigid")
    run_with_it(page, -30.0)
    alarm = page.get_by_role("alert").filter(has_text="The needle is not as the model")
    alarm.wait_for(timeout=20_000)
    assert re.search(r"(torque|Hall angle \d) (more than )?[\d.]+ σ (above|below)", alarm.inner_text())
    assert "needle-rig diagnose" not in page.locator(".ended").inner_text()
    look_at(page, "live-alarm")
    page.get_by_role("link", name="Diagnose this run").click()
    page.get_by_role("button", name="Diagnose", exact=True).wait_for()
    # the next order has the model of the rig again, and the alarm of another run is gone
    page.goto(page.url.split("#")[0] + "#/live")
    page.wait_for_selector(".shaft .curve")
    expect(page.get_by_label("Strategy")).to_have_value("reed2008")
    page.get_by_role("button", name="Compensate", exact=True).click()
    expect(alarm).to_have_count(0)
    page.locator(".ended").wait_for()
    assert state(rig)["model"] is None


def test_a_key_that_names_no_model_is_refused_in_a_sentence(rig: Served) -> None:
    for key in ("rig_elastic", "no such key", "../../etc/passwd"):
        order = {"target_deg": 45.0, "strategy": "planned", "model": key}
        answer = rig.ask("POST", "/api/rig/compensate", json=order)
        assert answer.status_code == 422
        assert "Traceback" not in answer.text
        assert "choose" in answer.json()["error"] or "not there any more" in answer.json()["error"]
    assert state(rig)["run"] is None
