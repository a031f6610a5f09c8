"""A link that dies in mid-run, whichever way: the drive is stopped in time, the fault names the link."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from needle_rig.config.schema import RigConfig
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.records import DriveFault, DriveState, Phase
from needle_rig.simulation.bench.bench_lines import Said
from needle_rig.simulation.bench.process import Bench
from needle_rig.units import rad
from tests.bench.ticking import Ticking

pytestmark = pytest.mark.usefixtures("steady")

REACTION_S = 0.05


async def drive_fault_seen(bench: Bench) -> tuple[DriveFault, float]:
    """Why the drive stopped by itself, and when by the bench's clock: without the time that others took."""

    def fault(said: Said) -> bool:
        return said.get("event") == "drive" and said["state"] == "fault"

    said = await asyncio.to_thread(bench.wait_for, fault, 10)
    assert isinstance(said["faults"], int)
    return DriveFault(said["faults"]), said["time_s"] - said["late_s"]


@asynccontextmanager
async def turning(config: RigConfig) -> AsyncIterator[tuple[Ticking, Brain]]:
    """A rig whose base is on its way."""
    rig, brain = HardwareRig(config), Brain(config)
    await rig.open()
    try:
        ticking = Ticking(rig, brain)
        await ticking.ready()
        start_rad = ticking.measurement.base_angle_rad
        brain.compensate(Request(target_rad=start_rad + rad(60 if start_rad < 0 else -60)))
        await ticking.until(lambda: abs(ticking.measurement.base_angle_rad - start_rad) > rad(3))
        yield ticking, brain
    finally:
        ticking.end()
        await rig.close()


async def stop_seen(bench: Bench) -> Said:
    def stop(said: Said) -> bool:
        return said.get("event") == "command" and not said["enable"]

    return await asyncio.to_thread(bench.wait_for, stop, 10)


@pytest.mark.parametrize("fault", ["unplug", "silence", "garble", "freeze"])
@pytest.mark.parametrize("link", ["torque", "hall", "drive"])
def test_the_stop_goes_out_in_time_and_the_message_names_the_link(
    bench: Bench, config: RigConfig, link: str, fault: str
) -> None:
    age_limit_s = getattr(config.links, f"{link}_age_limit_ms") * 1e-3

    async def scenario() -> None:
        async with turning(config) as (ticking, brain):
            failed_s = await asyncio.to_thread(bench.harm, link, fault)
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            assert not ticking.command.enable
            on_bus_s = (await stop_seen(bench))["time_s"]
            assert on_bus_s - failed_s - age_limit_s <= REACTION_S
            outcome = brain.state.outcome
            assert outcome is not None
            assert outcome.status == "fault"
            assert link in outcome.text.lower()

    asyncio.run(scenario())


def test_the_adapter_is_pulled_out_and_the_drive_stops_by_itself(bench: Bench, config: RigConfig) -> None:
    async def scenario() -> None:
        async with turning(config) as (ticking, brain):
            failed_s = await asyncio.to_thread(bench.harm, "can", "unplug")
            faults, stopped_s = await drive_fault_seen(bench)
            assert DriveFault.COMMAND_AGE in faults
            assert stopped_s - failed_s <= 0.06
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            outcome = brain.state.outcome
            assert outcome is not None
            assert "torque" in outcome.text

    asyncio.run(scenario())


def test_noise_on_the_can_adapter_stops_the_run(bench: Bench, config: RigConfig) -> None:
    async def scenario() -> None:
        async with turning(config) as (ticking, brain):
            await asyncio.to_thread(bench.harm, "can", "garble")
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            assert not ticking.command.enable

    asyncio.run(scenario())


@pytest.mark.parametrize(("link", "named"), [("can", "torque"), ("hall", "hall")])
def test_a_port_that_is_put_back_works_again_after_a_clear(
    bench: Bench, config: RigConfig, link: str, named: str
) -> None:
    async def scenario() -> None:
        async with turning(config) as (ticking, brain):
            await asyncio.to_thread(bench.harm, link, "unplug")
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            assert named in brain.state.outcome.text if brain.state.outcome else False
            await asyncio.to_thread(bench.harm, link, "restore")
            await ticking.until(lambda: brain.state.fault is None)
            brain.clear()
            await ticking.until(lambda: ticking.measurement.drive_state is DriveState.READY)
            start_rad = ticking.measurement.base_angle_rad
            brain.compensate(Request(target_rad=start_rad + rad(10)))
            await ticking.until(lambda: ticking.measurement.base_angle_rad - start_rad > rad(3))

    asyncio.run(scenario())


def test_the_host_stops_and_the_drive_stops_by_itself(bench: Bench, config: RigConfig) -> None:
    async def scenario() -> None:
        async with turning(config) as (ticking, _):
            ticking.end()
            faults, stopped_s = await drive_fault_seen(bench)
            assert DriveFault.COMMAND_AGE in faults
            assert stopped_s - ticking.tick_s[-1] <= 0.06

    asyncio.run(scenario())


def test_a_magnet_out_of_reach_is_a_fault_with_the_sensors_name(bench: Bench, config: RigConfig) -> None:
    async def scenario() -> None:
        async with turning(config) as (ticking, brain):
            await asyncio.to_thread(bench.harm, "hall", "fade")
            await ticking.until(lambda: brain.state.phase is Phase.FAULT)
            outcome = brain.state.outcome
            assert outcome is not None
            assert "hall_4 sees a field of 0" in outcome.text

    asyncio.run(scenario())
