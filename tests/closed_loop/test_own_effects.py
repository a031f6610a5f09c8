"""Models with effects of every origin go wherever a strategy thinks; one that never ends stops nothing."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from needle_rig.workbench.laws.draft import Origin, Table, written
from needle_rig.workbench.laws.law import Law
from tests.closed_loop.shell import ROOT, Shell, all_gone, wait_for_line

SLIT = ROOT / "tests" / "data" / "effects" / "slit_membrane.py"
HANGS = '''"""Hangs while a file of that name is there.

Law: none.
Source: none.
Shows best: never.
"""

import os
import time
from dataclasses import dataclass

from needle_rig.physics.effect import Effect, parameter


@dataclass(frozen=True)
class Hangs(Effect):
    amount: float = parameter(
        off=0.0, lower=0.0, upper=10.0, typical=1.0, smallest=0.1, literature=(0.0, 5.0), unit="1"
    )

    def shape(self, rod, trial):
        while os.path.exists("HANG"):
            time.sleep(0.01)
        return rod
'''
MODEL = """format: needle-rig-model/1
name: own
starts_from: rig_rigid
layout:
  needle_length_mm: 397
  tissue_sections_mm: [[175, 200], [240, 265], [305, 330], [370, 395]]
  sensor_positions_mm: [220, 285, 350, 396]
base:
  torsional_rigidity_nmm2: {value: 62.56, uncertainty: 0.03, unit: N·mm²}
  friction_nmm_per_100mm: {value: 0.099647, uncertainty: 0.00069, unit: N·mm per 100 mm}
effects:
  EFFECT
history: []
"""
EFFECTS = {
    "own": "slit_membrane: {torque_nmm: {value: 0.03, unit: N·mm}, place_mm: {value: 315.0, unit: mm}}",
    "learnt": "learnt_law: {strength: {value: 1.0, unit: '1'}}",
    "shipped": "torque_bias: {bias_nmm: {value: 0.001, unit: N·mm}}",
    "hangs": "hangs: {amount: {value: 1.0, unit: '1'}}",
}


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    shell = Shell(tmp_path)
    yield shell
    all_gone(shell.processes())


def make_model(folder: Path, kind: str) -> str:
    effects = folder / "config" / "effects"
    effects.mkdir(parents=True)
    shutil.copy(SLIT, effects)
    (effects / "hangs.py").write_text(HANGS)
    curve = Table(np.array([0.0, 45.0]), np.array([0.0, 0.001]))
    origin = Origin("here", "0" * 64, "today")
    written(effects / "learnt_law.py", Law("observe", "torque", "angle"), curve, origin, ())
    (folder / "model.yaml").write_text(MODEL.replace("EFFECT", EFFECTS[kind]))
    return "model.yaml"


KINDS = pytest.mark.parametrize("kind", ["own", "learnt", "shipped"])
OWN_FIRST = pytest.mark.parametrize(
    "kind", ["own", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("learnt", "shipped"))]
)
"""Half a minute of a core each: the others before a release."""


@KINDS
@pytest.mark.real_time
def test_planned_works_in_real_time_with_a_model_that_holds_an_effect(shell: Shell, kind: str) -> None:
    model = make_model(shell.folder, kind)
    result = shell.compensate("--strategy", "planned", "--model", model, "--simulated", "--settle", "0.2")
    assert len(result["motions"]) >= 1
    assert result["status"] in ("aligned", "not_aligned")


@pytest.mark.whole
@OWN_FIRST
def test_planned_gives_the_same_in_every_virtual_run(shell: Shell, kind: str) -> None:
    order = ("--strategy", "planned", "--model", make_model(shell.folder, kind), "--fast", "--settle", "0.2")
    first, second = (shell.compensate(*order) for _ in range(2))
    assert first["motions"] == second["motions"]
    assert len(first["motions"]) >= 1


@pytest.mark.whole
@OWN_FIRST
def test_the_strategies_are_compared_in_other_processes(shell: Shell, kind: str) -> None:
    model = make_model(shell.folder, kind)
    options = ("--strategy", "planned", "--targets", "10", "--seeds", "1", "--jobs", "2", "--json")
    done = shell.run("strategies", "--parameters", "rig_rigid", "--model", model, *options)
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(done.stdout)["overall"]
    assert row["runs"] == 2


@pytest.mark.whole
@OWN_FIRST
def test_so_are_they_for_the_page(shell: Shell, kind: str) -> None:
    model = str(shell.folder / make_model(shell.folder, kind))
    request = {
        "kind": "strategies",
        "model": model,
        "parameters": model,
        "targets_deg": [10.0],
        "seeds": 1,
        "effects": [str(shell.folder / "config" / "effects")],
        "out": ".",
        "jobs": 2,
    }
    worker = [sys.executable, "-m", "needle_rig.web.worker"]
    with subprocess.Popen(
        worker,
        cwd=shell.folder,
        env=shell.environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        said = next(s for line in process.stdout if {"result", "error"} & (s := json.loads(line)).keys())
        process.stdin.close()
    assert "error" not in said, said
    planned = next(row for row in said["result"]["rows"] if row["strategy"] == "planned")
    assert planned["runs"] == 2


class Asked:
    """The daemon of a shell, asked over its socket."""

    def __init__(self, shell: Shell) -> None:
        place = shell.folder / "run" / "needle-rig" / "daemon.sock"
        self._client = httpx.Client(
            transport=httpx.HTTPTransport(uds=str(place)), base_url="http://daemon", timeout=60.0
        )

    def close(self) -> None:
        self._client.close()

    def state(self) -> dict[str, Any]:
        state: dict[str, Any] = self._client.get("/state").json()
        return state

    def order(self, path: str, **content: Any) -> None:
        answer = self._client.post(path, json=content)
        assert answer.is_success, answer.text

    def until(self, wanted: Callable[[dict[str, Any]], bool], within_s: float) -> dict[str, Any]:
        end_s = time.monotonic() + within_s
        while not wanted(state := self.state()):
            assert time.monotonic() < end_s, state
            time.sleep(0.02)
        return state


def is_thinking(state: dict[str, Any]) -> bool:
    return "strategy planned to plan" in state["waiting_for"]


def is_over(state: dict[str, Any]) -> bool:
    return state["run"] is None


@pytest.mark.whole
@pytest.mark.parametrize("time_is", ["virtual", pytest.param("real", marks=pytest.mark.real_time)])
def test_a_planner_that_never_answers_hangs_neither_stop_nor_the_next_run_nor_the_end(
    shell: Shell, time_is: str
) -> None:
    model = make_model(shell.folder, "hangs")
    fast = ["--fast"] if time_is == "virtual" else []
    with ExitStack() as daemon:
        process = daemon.enter_context(shell.start("daemon", "--simulated", *fast, "--model", model))
        wait_for_line(process, lambda line: "ready" in line)
        asked = daemon.enter_context(closing(Asked(shell)))
        (shell.folder / "HANG").touch()
        asked.order("/compensate", target_deg=10.0, strategy="planned", settle_s=0.2)
        state = asked.until(is_thinking, within_s=30.0)
        time.sleep(1.0)
        then = asked.state()
        assert is_thinking(then)
        assert (then["time_s"] == state["time_s"]) == (time_is == "virtual")

        asked.order("/stop")
        start_s = time.monotonic()
        ended = asked.until(is_over, within_s=5.0)
        assert time.monotonic() - start_s < 1.0
        assert ended["phase"] == "aborted"

        (shell.folder / "HANG").unlink()
        asked.order("/compensate", target_deg=10.0, strategy="planned", settle_s=0.2)
        assert asked.until(is_over, within_s=60.0)["phase"] == "done"

        (shell.folder / "HANG").touch()
        asked.order("/compensate", target_deg=-10.0, strategy="planned", settle_s=0.2)
        asked.until(is_thinking, within_s=30.0)
        start_s = time.monotonic()
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
        assert process.returncode == 0
        assert time.monotonic() - start_s < 5.0


@pytest.mark.whole
def test_a_planner_that_never_answers_ends_the_run_by_its_name(shell: Shell) -> None:
    model = make_model(shell.folder, "hangs")
    rig = (ROOT / "config" / "rig.yaml").read_text()
    assert "motion_timeout_s: 60" in rig
    (shell.folder / "rig.yaml").write_text(rig.replace("motion_timeout_s: 60", "motion_timeout_s: 8"))
    with ExitStack() as daemon:
        start = shell.start("daemon", "--config", "rig.yaml", "--fast", "--model", model)
        process = daemon.enter_context(start)
        wait_for_line(process, lambda line: "ready" in line)
        asked = daemon.enter_context(closing(Asked(shell)))
        (shell.folder / "HANG").touch()
        asked.order("/compensate", target_deg=10.0, strategy="planned", settle_s=0.2)
        last = asked.until(is_over, within_s=60.0)["last"]
        assert last["result"]["status"] == "fault"
        sentence = "strategy planned has not answered for 8 s (sequence.motion_timeout_s); choose another"
        assert last["text"] == sentence
        asked.order("/compensate", target_deg=10.0, settle_s=0.2)
        assert asked.until(is_over, within_s=60.0)["phase"] == "done"
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)
