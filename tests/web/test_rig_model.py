"""The model that a person set as the rig's: orders plan with it, `status` says so, a step is taken back."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from needle_rig.recording import RunFile
from needle_rig.web.store import RIG_MODEL, Store, opened, rig_model_name
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.served import Served

END_S = 120.0


@pytest.fixture(scope="module")
def rig(shell: Shell) -> Iterator[Served]:
    yield from started(shell, "--rig", "simulated", "--fast", "--dir", str(shell.folder / "rigs"))


def done(served: Served, **asked: Any) -> dict[str, Any]:
    """A job to its end."""
    key = served.ask("POST", "/api/jobs", json=asked).json()["job"]
    until = time.monotonic() + END_S
    while time.monotonic() < until:
        job: dict[str, Any] = served.ask("GET", f"/api/jobs/{key}").json()
        if job["state"] not in ("waiting", "running"):
            assert job["state"] == "done", job["error"]
            return job
        time.sleep(0.1)
    raise AssertionError("the job did not end")


def opened_file(served: Served, path: Path) -> dict[str, Any]:
    """A model file, dropped and opened."""
    upload = served.ask("POST", "/api/uploads", json={"name": path.stem}).json()["upload"]
    served.ask("PUT", f"/api/uploads/{upload}/{path.name}", content=path.read_bytes())
    return done(served, kind="open", upload=upload)


def about(served: Served) -> dict[str, Any]:
    told: dict[str, Any] = served.ask("GET", "/api/about").json()
    return told


def test_the_name_is_found_beside_the_runs_or_nothing_is_said(tmp_path: Path) -> None:
    assert rig_model_name(tmp_path) == ""
    with opened(tmp_path, tmp_path / "otherwise") as (store, _):
        store.keep_setting(RIG_MODEL, {"key": "k", "name": "mine"})
        assert rig_model_name(tmp_path) == "mine"
    assert rig_model_name(tmp_path) == "mine"
    damaged = tmp_path / "damaged"
    (damaged / ".page").mkdir(parents=True)
    (damaged / ".page" / "page.sqlite").write_bytes(b"no database at all, but text that is long enough" * 9)
    assert rig_model_name(damaged) == ""
    (damaged / ".page" / "page.sqlite").unlink()
    Store(damaged / ".page").close()
    assert rig_model_name(damaged) == ""


@pytest.mark.whole
def test_orders_plan_with_the_rigs_model_until_it_is_changed(rig: Served, tmp_path: Path) -> None:
    saved = SavedModel(load_parameters("rig_elastic"), "rig_elastic", {"friction_nmm_per_100mm": 0.001})
    save_model(tmp_path / "elastic.yaml", saved)
    model = opened_file(rig, tmp_path / "elastic.yaml")
    runs = Path(about(rig)["runs"])
    assert about(rig)["rig_model"] is None
    assert rig_model_name(runs) == ""
    answer = rig.ask("PUT", "/api/rig_model", json={"model": model["key"]})
    assert answer.json() == {"rig_model": {"key": model["key"], "name": model["name"]}}
    assert rig_model_name(runs) == model["name"]

    def run(target_deg: float, **more: Any) -> Any:
        """The model that an order without or with a word of one was planned with."""
        before = set(runs.glob("*.h5"))
        order = {"target_deg": target_deg, "strategy": "planned", **more}
        assert rig.ask("POST", "/api/rig/compensate", json=order).status_code == 202
        until = time.monotonic() + END_S
        while time.monotonic() < until:
            listed = rig.ask("GET", "/api/runs").json()["runs"]
            new = [one for one in listed if runs / f"{one['name']}.h5" not in before]
            if new and new[0]["status"] not in ("running", ""):
                return RunFile(runs / f"{new[0]['name']}.h5").attributes.get("model")
            time.sleep(0.2)
        raise AssertionError("the run did not end")

    assert run(20.0) == "rig_elastic"
    assert run(-20.0, strategy="reed2008", model=None) is None
    assert rig.ask("PUT", "/api/rig_model", json={"model": None}).json() == {"rig_model": None}
    assert rig_model_name(runs) == ""


@pytest.mark.parametrize("model", ["rig_elastic", "no such key", 3, {"a": 1}])
def test_what_is_no_model_of_the_library_is_refused_and_nothing_changes(served: Served, model: Any) -> None:
    answer = served.ask("PUT", "/api/rig_model", json={"model": model})
    assert answer.status_code == 422
    assert "error" in answer.json()
    assert about(served)["rig_model"] is None


@pytest.mark.whole
def test_a_step_of_an_opened_file_is_taken_back(served: Served, tmp_path: Path) -> None:
    made = done(served, kind="add_effect", data=["shipped:reed2008"], effect="tissue_elasticity")
    file = tmp_path / "learnt.yaml"
    file.write_bytes(served.ask("GET", f"/api/jobs/{made['key']}/model.yaml").content)
    again = opened_file(served, file)
    assert [step["step"] for step in again["result"]["steps"]] == ["null", "+ tissue_elasticity"]
    back = done(served, kind="undo", model=again["key"])
    assert (back["result"]["model"], back["name"]) == (None, "")  # the null model, which no list has
    assert {m["kind"] for m in about(served)["models"]} == {"add_effect", "open"}
    assert done(served, kind="undo", model=again["key"])["key"] == back["key"]
