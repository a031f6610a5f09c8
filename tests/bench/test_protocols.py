"""Nodes say which protocol they speak: one that is not known here is refused, whenever it comes."""

from __future__ import annotations

import asyncio
import json
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config, rig_config_text
from needle_rig.config.schema import RigConfig
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.errors import RigFault
from needle_rig.recording.reader import RunFile
from needle_rig.records import Phase
from needle_rig.service.client import DaemonClient, the_daemon
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.process import Bench
from needle_rig.units import rad
from needle_rig.version import VERSION
from tests.bench.ticking import Ticking

pytestmark = pytest.mark.usefixtures("steady")

LINKS = ("torque", "drive")
REACTION_S = 0.6
"""A node introduces itself every half second; its restart does so at once."""


@pytest.fixture
def running_bench() -> Iterator[Bench]:
    """A bench of its own for each test: a drive that restarted has lost its zero."""
    bench = bench_module.start(load_rig_config())
    yield bench
    bench.close()


def test_what_the_nodes_are_is_known_as_soon_as_the_rig_is_open(config: RigConfig) -> None:
    async def scenario() -> None:
        rig = HardwareRig(config)
        await rig.open()
        told = rig.firmware()
        await rig.close()
        assert set(told) == set(LINKS), "the serial line of the Hall node has no such frame"
        assert {firmware.protocol for firmware in told.values()} == {1}

    asyncio.run(scenario())


@pytest.mark.parametrize("link", LINKS)
@pytest.mark.parametrize("protocol", [0, 2])
def test_a_node_of_an_unknown_protocol_is_refused_at_the_start_in_a_sentence(
    bench: Bench, config: RigConfig, link: str, protocol: int
) -> None:
    bench.harm(link, f"protocol {protocol}")

    async def scenario() -> None:
        rig = HardwareRig(config)
        with pytest.raises(RigFault, match=f"the {link} node speaks protocol {protocol}.*knows 1; flash"):
            await rig.open(timeout_s=1.0)

    asyncio.run(scenario())


@pytest.mark.parametrize("link", LINKS)
def test_a_node_that_comes_back_with_another_protocol_in_mid_motion_stops_the_run(
    bench: Bench, config: RigConfig, link: str
) -> None:
    async def scenario() -> None:
        rig, brain = HardwareRig(config), Brain(config)
        await rig.open()
        try:
            ticking = Ticking(rig, brain)
            await ticking.ready()
            start_rad = ticking.measurement.base_angle_rad
            brain.compensate(Request(target_rad=start_rad + rad(60 if start_rad < 0 else -60)))
            await ticking.until(lambda: abs(ticking.measurement.base_angle_rad - start_rad) > rad(3))
            await asyncio.to_thread(bench.harm, link, "protocol 7")
            await ticking.until(lambda: brain.state.phase is Phase.FAULT, REACTION_S)
            assert not ticking.command.enable
            await ticking.until(lambda: f"the {link} node speaks protocol 7" in (brain.state.fault or ""))
            with pytest.raises(RigFault, match=f"the {link} node speaks protocol 7"):
                brain.compensate(Request(target_rad=0.0))
            brain.clear()
            await asyncio.sleep(0.3)
            with pytest.raises(RigFault, match=f"the {link} node speaks protocol 7"):
                brain.jog(by_rad=0.1)
            ages = {"torque": ticking.measurement.torque_age_s, "drive": ticking.measurement.drive_age_s}
            assert math.isinf(ages[link])
            await asyncio.to_thread(bench.harm, link, "protocol 1")
            await ticking.until(lambda: "protocol" not in (brain.state.fault or ""))
            assert ticking.measurement.torque_age_s + ticking.measurement.drive_age_s < 1.0
        finally:
            ticking.end()
            await rig.close()

    asyncio.run(scenario())


@pytest.fixture
def rig_file(config: RigConfig, tmp_path: Path) -> Path:
    path = tmp_path / "rig.yaml"
    path.write_text(rig_config_text(config))
    return path


@pytest.fixture
def needle_rig(tmp_path: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    def run(*words: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, "-m", "needle_rig", *words],
            capture_output=True,
            text=True,
            env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
            timeout=120,
            check=False,
        )

    return run


@pytest.fixture
def daemon(rig_file: Path, tmp_path: Path) -> Iterator[DaemonClient]:
    """A daemon that outlives its rig."""
    where = tmp_path / "d"
    words = ["daemon", "--config", str(rig_file), "--socket", str(where), "--out", str(tmp_path / "runs")]
    with subprocess.Popen(
        [sys.executable, "-m", "needle_rig", *words], stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stderr is not None
            assert any("ready" in line for line in process.stderr), "it ended"
            yield the_daemon(where)
        finally:
            process.terminate()


def test_a_daemon_tells_what_its_nodes_are_and_each_run_keeps_it(
    bench: Bench, daemon: DaemonClient, needle_rig: Callable[..., subprocess.CompletedProcess[str]]
) -> None:
    bench.harm("torque", "protocol none")
    status = needle_rig("status", "--socket", str(daemon.path)).stdout
    assert f"node:    drive {VERSION}, protocol 1" in status
    # the torque node's older firmware shows when three of its frames are missing
    compensated = needle_rig(
        "compensate", "--target", "1", "--strategy", "none", "--json", "--socket", str(daemon.path)
    )
    assert compensated.returncode == 0, compensated.stderr
    run = RunFile(json.loads(compensated.stdout)["run"])
    firmware = json.loads(str(run.attributes["firmware"]))
    assert firmware["drive"]["version"] == VERSION
    assert firmware["drive"]["calibrated"] is False
    assert set(firmware) == set(LINKS)
    status = needle_rig("status", "--socket", str(daemon.path)).stdout
    assert "node:    torque version unknown" in status, "an old firmware is shown and allowed"


def test_check_and_a_motion_refuse_a_node_that_came_with_another_protocol(
    bench: Bench,
    daemon: DaemonClient,
    rig_file: Path,
    needle_rig: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    place = ("--socket", str(daemon.path))
    well = needle_rig("check", "--config", str(rig_file), *place)
    assert f"ok    torque firmware: {VERSION}, protocol 1, not calibrated" in well.stdout
    bench.harm("torque", "protocol 2")
    refused = needle_rig("check", "--config", str(rig_file), *place)
    assert refused.returncode == 1
    assert "fail  torque firmware: the torque node speaks protocol 2" in refused.stdout
    moved = needle_rig("jog", "--by", "5", *place)
    assert moved.returncode == 3
    (sentence,) = moved.stderr.strip().splitlines()
    assert "the torque node speaks protocol 2" in sentence
    assert needle_rig("status", *place).stdout.count("the torque node speaks protocol 2") == 1
