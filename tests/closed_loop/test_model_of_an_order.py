"""A run that plans with the model of its order: read beside the tick, told, recorded; or refused at rest."""

from __future__ import annotations

import hashlib
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from needle_rig.model import SavedModel, load_parameters, save_model
from needle_rig.recording import RunFile
from needle_rig.service.api.orders import MODEL_LETTERS
from tests.closed_loop.shell import Shell, all_gone, wait_for_line

pytestmark = pytest.mark.whole


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    shell = Shell(tmp_path)
    yield shell
    all_gone(shell.processes())


@pytest.fixture
def rig(shell: Shell, daemon: subprocess.Popen[str]) -> Iterator[Rig]:
    rig = Rig(shell)
    yield rig
    rig.client.close()


@pytest.fixture
def daemon(shell: Shell) -> Iterator[subprocess.Popen[str]]:
    with shell.start("daemon", "--fast") as process:
        wait_for_line(process, lambda line: "ready" in line)
        yield process


@pytest.fixture
def text(tmp_path: Path) -> str:
    """The simulated needle's own model."""
    saved = SavedModel(load_parameters("rig_elastic"), "rig_elastic", {"friction_nmm_per_100mm": 0.001})
    save_model(tmp_path / "learnt.yaml", saved)
    return (tmp_path / "learnt.yaml").read_text()


class Rig:
    """Orders as the page gives them."""

    def __init__(self, shell: Shell) -> None:
        place = shell.folder / "run" / "needle-rig" / "daemon.sock"
        transport = httpx.HTTPTransport(uds=str(place))
        self.lease = ""
        self.client = httpx.Client(transport=transport, base_url="http://daemon", timeout=60.0)

    def compensate(self, **content: object) -> httpx.Response:
        if not self.lease:
            self.lease = self.client.post("/lease", json={"holder": "a test"}).json()["lease"]
        order = {"target_deg": 45.0, "strategy": "planned", "settle_s": 0.5} | content
        return self.client.post("/compensate", json=order, headers={"Lease": self.lease})

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = self.client.get("/state").json()
        return state


def test_a_run_plans_with_the_model_of_its_order(shell: Shell, rig: Rig, text: str) -> None:
    refused = rig.compensate()
    assert "planned needs a model" in refused.json()["error"]
    begun = rig.compensate(model=text)
    assert begun.status_code == 202, begun.text
    until_s = time.monotonic() + 120
    while (state := rig.state())["last"] is None:
        assert time.monotonic() < until_s
        time.sleep(0.1)
    assert state["last"]["result"]["status"] == "aligned", state["last"]["text"]
    assert state["model"] == "rig_elastic"
    assert state["model_sha256"] == hashlib.sha256(text.encode()).hexdigest()
    assert state["ticks"]["missed"] == 0
    assert "model:   rig_elastic" in shell.run("status").stdout
    run = RunFile(begun.json()["run"])
    assert run.attributes["model"] == "rig_elastic"
    assert run.attributes["model_file"] == text
    # the next order has the daemon's own model again, which is none
    assert "planned needs a model" in rig.compensate().json()["error"]


def test_a_model_that_cannot_be_used_is_refused_before_anything_moves(rig: Rig, text: str) -> None:
    unknown = text.replace("tissue_elasticity:", "not_installed:", 1)
    assert unknown != text
    for broken, told in (
        (unknown, "not_installed"),
        (text[: len(text) // 2], "the model of this order"),
        ("a: [", "the model of this order:1"),
        ("x" * (MODEL_LETTERS + 1), str(MODEL_LETTERS)),
        ("!!python/object/apply:os.system [true]", "the model of this order:1"),
    ):
        answer = rig.compensate(model=broken)
        assert answer.status_code == 422, answer.text
        sentence = answer.json()["error"]
        assert told in sentence
        assert sentence.isprintable()
        assert len(sentence) < 800  # it lists the effects that there are
    state = rig.state()
    assert state["phase"] == "idle"
    assert state["last"] is None
    assert not list(Path(state["runs"]).glob("*"))
    assert rig.compensate(strategy="reed2008", model=text).status_code == 202
