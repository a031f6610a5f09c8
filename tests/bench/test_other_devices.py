"""A CiA 402 drive on slcan, an ATI sensor on UDP, lines of text on a port: drivers behind real ports."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from needle_rig.config.loader import load_rig_config, rig_config_text
from needle_rig.config.schema import RigConfig
from needle_rig.control.brain import Brain
from needle_rig.control.faults import FaultName
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.errors import RigFault
from needle_rig.records import DriveState, Phase
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.process import Bench
from needle_rig.units import rad
from tests.bench.ticking import Ticking

pytestmark = pytest.mark.usefixtures("steady")

LINKS = ("torque", "drive", "hall", "can")


def config_of_others() -> RigConfig:
    config = load_rig_config(None, {"sequence.settle_s": 0.5, "sequence.torque_window_s": 0.2})
    links = config.links.model_dump()
    links["drive"] = {
        "device": "cia402",
        "node_id": 5,
        "position_units_per_turn": 409_600,
        "velocity_units_per_rpm": 100,
    }
    links["torque"] = {"device": "netft", "address": "auto"}
    links["hall"] = {"device": "text", "port": "auto", "checksum": True}
    return RigConfig.model_validate({**config.model_dump(), "links": links})


@pytest.fixture(scope="module")
def others() -> Iterator[Bench]:
    bench = bench_module.start(config_of_others())
    yield bench
    bench.close()


@pytest.fixture
def mended(others: Bench) -> Bench:
    for link in LINKS:
        others.harm(link, "restore")
    return others


def on(bench: Bench) -> RigConfig:
    """The bench with the age limits of a real rig."""
    config = bench.configured(config_of_others())
    limits = {f"{link}_age_limit_ms": 50.0 for link in ("torque", "hall", "drive")}
    return config.model_copy(update={"links": config.links.model_copy(update=limits)})


@asynccontextmanager
async def awake(bench: Bench) -> AsyncIterator[tuple[Ticking, Brain]]:
    config = on(bench)
    rig, brain = HardwareRig(config), Brain(config)
    await rig.open()
    try:
        ticking = Ticking(rig, brain)
        async with asyncio.timeout(20):
            while not ticking.measurement.referenced:  # what a test before left: a fault, a needle wound up
                if brain.state.fault_name == FaultName.REFERENCE_LOST:
                    brain.home(by="here", angle_rad=0.0)
                elif brain.state.fault is not None:
                    brain.clear()
                await asyncio.sleep(0.2)
        await ticking.ready()
        yield ticking, brain
    finally:
        ticking.end()
        await rig.close()


@asynccontextmanager
async def turning(bench: Bench) -> AsyncIterator[tuple[Ticking, Brain]]:
    async with awake(bench) as (ticking, brain):
        start_rad = ticking.measurement.base_angle_rad
        brain.jog(by_rad=rad(60.0) if start_rad < 0.0 else rad(-60.0))
        await ticking.until(lambda: abs(ticking.measurement.base_angle_rad - start_rad) > rad(3.0))
        yield ticking, brain


def test_a_compensation_runs_to_its_end_and_is_recorded(tmp_path: Path) -> None:
    rig_file = tmp_path / "rig.yaml"
    rig_file.write_text(rig_config_text(config_of_others()))
    command = [sys.executable, "-m", "needle_rig", "compensate", "--target", "45", "--json", "--no-picture"]
    done = subprocess.run(
        [*command, "--config", str(rig_file), "--out", str(tmp_path / "runs")],
        capture_output=True,
        text=True,
        timeout=200,
        env={**os.environ, "XDG_RUNTIME_DIR": str(tmp_path)},
        check=False,
    )
    assert "Traceback" not in done.stderr
    assert done.stdout, done.stderr
    result = json.loads(done.stdout)
    assert result["status"] == "not_aligned", done.stderr
    assert len(result["motions"]) == 5
    assert result["motions"][-1]["base_deg"] == pytest.approx(45.0, abs=0.2)


@pytest.mark.parametrize(
    "fault",
    [
        "unplug",
        "silence",
        # by default in virtual time alone: tests/closed_loop/test_other_devices.py
        pytest.param("garble", marks=pytest.mark.slow),
        pytest.param("freeze", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("link", ["torque", "hall"])
def test_a_sensor_that_fails_in_mid_motion_is_named_and_heard_again(
    mended: Bench, link: str, fault: str
) -> None:
    async def scenario() -> None:
        async with turning(mended) as (ticking, brain):
            await asyncio.to_thread(mended.harm, link, fault)
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            assert f"the {link} link" in (brain.state.fault or "")
            assert not ticking.command.enable
            await asyncio.to_thread(mended.harm, link, "restore")
            await ticking.until(
                lambda: max(ticking.measurement.torque_age_s, ticking.measurement.hall_age_s) < 0.05
            )

    asyncio.run(scenario())


@pytest.mark.parametrize("fault", ["reset", "emergency", "unplug", "silence"])
def test_a_drive_that_fails_in_mid_motion_stops_the_run_and_is_set_up_again(
    mended: Bench, fault: str
) -> None:
    async def scenario() -> None:
        async with turning(mended) as (ticking, brain):
            await asyncio.to_thread(mended.harm, "drive", fault)
            await ticking.until(lambda: brain.state.outcome is not None)
            outcome = brain.state.outcome
            assert outcome is not None
            assert outcome.status == "fault"
            assert "drive" in outcome.text
            if fault == "emergency":
                assert "emergency 0x2310 (continuous over-current)" in outcome.text
            else:
                await asyncio.to_thread(mended.harm, "drive", "restore")
            await ticking.until(
                lambda: (
                    ticking.measurement.drive_age_s < 0.05
                    and ticking.measurement.drive_state is not DriveState.RUNNING
                )
            )

    asyncio.run(scenario())


def test_an_adapter_that_is_pulled_stops_the_drive_by_its_own_heartbeat_consumer(mended: Bench) -> None:
    async def scenario() -> None:
        async with turning(mended) as (_, __):
            failed_s = await asyncio.to_thread(mended.harm, "can", "unplug")

            def stopped(said: Said) -> bool:
                return said.get("event") == "drive" and said["state"] == "fault"

            said = await asyncio.to_thread(mended.wait_for, stopped, 10)
            assert said["faults"] == 2  # HEARTBEAT
            assert said["time_s"] - said["late_s"] - failed_s < 0.07

    asyncio.run(scenario())


def test_a_sensor_that_is_not_there_is_one_sentence_with_its_address(mended: Bench) -> None:
    config = on(mended)
    nobody = config.links.torque.model_copy(update={"http_port": 1})
    links = config.links.model_copy(update={"torque": nobody})
    rig = HardwareRig(config.model_copy(update={"links": links}))
    with pytest.raises(
        RigFault, match=r"http://127\.0\.0\.1:1/netftapi2\.xml: no page: connection refused; is it on"
    ):
        asyncio.run(rig.open())
