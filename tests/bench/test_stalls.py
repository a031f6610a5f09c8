"""A machine that stands still for a moment: no link is called dead for it, whoever stood still."""

from __future__ import annotations

import asyncio
import os
import re
import select
import signal
import time

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.records import Phase
from needle_rig.service.tick.rig_on_bench import RigOnBench
from needle_rig.simulation.bench.process import Bench
from needle_rig.units import rad
from tests.bench.ticking import Ticking

pytestmark = pytest.mark.usefixtures("steady")


def stand_still(seconds: float) -> None:
    """Hold up this process, and with it the tick."""
    until_s = time.monotonic() + seconds
    while (left_s := until_s - time.monotonic()) > 0:
        select.select([], [], [], left_s)


async def pass_s(seconds: float) -> None:
    """Let the loop tick on for a while."""
    done = asyncio.get_running_loop().create_future()
    asyncio.get_running_loop().call_later(seconds, done.set_result, None)
    await done


async def stall(bench: Bench, who: str, seconds: float) -> None:
    if who != "host":
        os.kill(bench.pid, signal.SIGSTOP)
    if who == "bench":
        await pass_s(seconds)
    else:
        stand_still(seconds)
    if who != "host":
        os.kill(bench.pid, signal.SIGCONT)


@pytest.mark.parametrize("who", ["bench", "both", "host"])
@pytest.mark.parametrize(("away_s", "times"), [(0.03, 4), (0.08, 2), (0.2, 1)])
def test_a_link_is_not_dead_because_a_process_stood_still(
    bench: Bench, who: str, away_s: float, times: int
) -> None:
    config = bench.configured(load_rig_config())

    async def scenario() -> tuple[str, str]:
        rig, brain = HardwareRig(config), Brain(config)
        await rig.open()
        ticking = Ticking(rig, brain)
        try:
            await ticking.ready()
            start_rad = ticking.measurement.base_angle_rad
            brain.compensate(Request(start_rad + rad(40 if start_rad < 0 else -40), "none", settle_s=0.3))
            await ticking.until(lambda: brain.state.phase is Phase.MOVING)
            for _ in range(times):
                await pass_s(0.2)
                await stall(bench, who, away_s)
            await ticking.until(lambda: brain.state.outcome is not None)
            outcome = brain.state.outcome
            assert outcome is not None
            return outcome.status, outcome.text
        finally:
            ticking.end()
            await rig.close()

    status, text = asyncio.run(scenario())
    if who == "host" and away_s > 0.05:
        # The drive node has no way to know that its host will be back.
        assert "no valid command reached it for 50 ms" in text
    elif away_s > 0.05 and status == "fault":
        # nobody sees the base of a drive that is enabled and not heard: the simulated one stood still, too
        assert "the drive is enabled and was not heard for" in text
    else:
        assert status != "fault", text


def test_a_simulated_rig_that_was_held_up_is_told_as_that() -> None:
    async def scenario() -> str:
        rig = RigOnBench(load_rig_config(), lambda source, row: None)
        await rig.open()
        try:
            assert rig._bench is not None
            assert rig.read().torque_complaint == ""
            os.kill(rig._bench.pid, signal.SIGSTOP)
            await pass_s(0.15)
            os.kill(rig._bench.pid, signal.SIGCONT)
            async with asyncio.timeout(1.0):
                while not (told := rig.read().torque_complaint):
                    await pass_s(0.005)
            return told
        finally:
            await rig.close()

    assert re.fullmatch(
        r"this machine held up the simulated rig for 1\d\d ms; leave it a core, or give --fast",
        asyncio.run(scenario()),
    )
