"""Latched means latched over real ports and with the nodes' firmware; a late drive hides no encoder."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.records import DriveFault, DriveState, Phase
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.process import Bench
from needle_rig.units import rad
from tests.bench.ticking import Ticking
from tests.values import now

pytestmark = pytest.mark.usefixtures("steady")

FIRMWARE = load_rig_config(None, {"simulation.nodes": "firmware"})
LATE_MS = 30


@pytest.fixture(scope="module")
def firmware_bench() -> Iterator[Bench]:
    bench = bench_module.start(FIRMWARE)
    yield bench
    bench.close()


@pytest.fixture
def firmware_config(firmware_bench: Bench) -> RigConfig:
    return firmware_bench.configured(FIRMWARE)


@asynccontextmanager
async def turning(config: RigConfig) -> AsyncIterator[tuple[Ticking, Brain]]:
    """A base on its way to where it will not be for two seconds."""
    rig, brain = HardwareRig(config), Brain(config)
    await rig.open()
    ticking = Ticking(rig, brain)
    try:
        await ticking.ready()
        start_rad = ticking.measurement.base_angle_rad
        brain.compensate(Request(start_rad + rad(80 if start_rad < 0 else -80)))
        await ticking.until(lambda: abs(ticking.measurement.base_angle_rad - start_rad) > rad(3))
        yield ticking, brain
    finally:
        ticking.end()
        await rig.close()


async def status(bench: Bench) -> Said:
    bench.tell("status")
    return await asyncio.to_thread(bench.wait_for, lambda said: "plant_s" in said, 10)


def test_an_emergency_stop_beside_a_dead_link_is_left_by_a_person_alone(
    firmware_bench: Bench, firmware_config: RigConfig
) -> None:
    async def scenario() -> None:
        bench = firmware_bench
        async with turning(firmware_config) as (ticking, brain):
            await asyncio.to_thread(bench.harm, "hall", "silence")
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            await asyncio.to_thread(bench.harm, "estop", "press")
            await asyncio.sleep(1.0)
            await asyncio.to_thread(bench.harm, "estop", "restore")
            await asyncio.sleep(1.0)
            assert brain.state.latched
            assert "the emergency stop" in (brain.state.fault or "")
            assert ticking.measurement.drive_state is DriveState.FAULT
            assert DriveFault.EMERGENCY_STOP in ticking.measurement.drive_faults
            before = await status(bench)
            assert not before["supply_on"]
            await asyncio.to_thread(bench.harm, "motor", "short")
            await asyncio.sleep(4.0)
            after = await status(bench)
            assert abs(after["true_base_deg"] - before["true_base_deg"]) < 1.0
            await asyncio.to_thread(bench.harm, "motor", "restore")
            await asyncio.to_thread(bench.harm, "hall", "restore")
            await ticking.until(lambda: ticking.measurement.hall_age_s < 0.05)
            assert brain.state.latched
            brain.clear()
            await ticking.until(lambda: ticking.measurement.drive_state is DriveState.READY)
            start_rad = ticking.measurement.base_angle_rad
            brain.jog(by_rad=rad(10 if start_rad < 0 else -10))
            await ticking.until(lambda: abs(ticking.measurement.base_angle_rad - start_rad) > rad(3))
            assert brain.state.fault is None

    asyncio.run(scenario())


def test_an_encoder_that_sticks_is_named_though_the_drive_is_heard_late(
    firmware_bench: Bench, firmware_config: RigConfig
) -> None:
    async def scenario() -> None:
        bench = firmware_bench
        async with turning(firmware_config) as (ticking, brain):
            try:
                await asyncio.to_thread(bench.harm, "drive", f"delay {LATE_MS}")
                await ticking.until(lambda: ticking.measurement.drive_age_s > 0.02)
                assert now(brain.state).fault is None
                stuck_s = await asyncio.to_thread(bench.harm, "encoder", "stick")
                await ticking.until(lambda: brain.state.latched)
                assert ticking.tick_s[-1] - stuck_s < 0.5
                assert "encoder" in (now(brain.state).fault or "")
            finally:
                await asyncio.to_thread(bench.harm, "drive", "restore")
                await asyncio.to_thread(bench.harm, "encoder", "restore")

    asyncio.run(scenario())
