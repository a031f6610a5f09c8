import asyncio
import math
from typing import Any

import pytest

from needle_rig.records import STOP, Command, DriveState, Firmware, Measurement, Phase, Sample
from needle_rig.service.tick.clock import VirtualClock
from needle_rig.service.tick.loop import ControlLoop

READING = Measurement(0.0, 0.1, 0.0, (0.0,))


class Rig:
    def __init__(self) -> None:
        self.written: list[Command] = []

    async def open(self) -> None: ...

    async def close(self) -> None: ...

    def read(self) -> Measurement:
        return READING

    def firmware(self) -> dict[str, Firmware]:
        return {}

    def write(self, command: Command) -> None:
        self.written.append(command)


class Brain:
    """Turns, and breaks at its tenth step when told to."""

    def __init__(self, breaks: bool = False) -> None:
        self.lengths_s: list[float] = []
        self.breaks = breaks

    def step(self, measurement: Measurement, dt_s: float) -> tuple[Command, Sample]:
        self.lengths_s.append(dt_s)
        if self.breaks and len(self.lengths_s) == 10:
            raise ZeroDivisionError
        return Command(velocity_rad_s=0.2, enable=True), sample(dt_s)


class LateClock(VirtualClock):
    """Skips two ticks once, and once the next tick is due before this one is done."""

    late = (3, 5)
    count = 0

    async def tick(self, busy: bool) -> int:
        self.count += 1
        await super().tick(busy)
        return 2 if self.count == self.late[0] else 0

    def overrun(self) -> bool:
        return self.count == self.late[1]


def sample(dt_s: float) -> Sample:
    return Sample(
        time_s=0.0,
        dt_s=dt_s,
        phase=Phase.MOVING,
        motion="rotate",
        base_angle_rad=0.1,
        torque_nm=0.0,
        hall_rad=(0.0,),
        waypoint_rad=math.nan,
        velocity_rad_s=0.2,
        enable=True,
        limited=False,
        drive_state=DriveState.READY,
        drive_faults=READING.drive_faults,
        torque_age_s=0.0,
        hall_age_s=0.0,
        drive_age_s=0.0,
    )


async def test_a_broken_brain_leaves_the_drive_stopped() -> None:
    rig, brain = Rig(), Brain(breaks=True)
    loop = ControlLoop(rig, brain, VirtualClock(0.005, lambda dt_s: None), lambda s: None, lambda t: None)  # type: ignore[arg-type]
    loop.busy = True
    with pytest.raises(ZeroDivisionError):
        await loop.run()
    assert len(rig.written) == 10
    assert rig.written[-1] == STOP


async def test_ending_leaves_the_drive_stopped_and_ticks_have_their_measured_length() -> None:
    rig, brain = Rig(), Brain()
    met: list[float] = []

    def on_sample(each: Sample) -> None:
        if len(brain.lengths_s) == 20:
            loop.end()

    loop = ControlLoop(rig, brain, VirtualClock(0.005, lambda dt_s: None), on_sample, met.append)  # type: ignore[arg-type]
    loop.busy = True
    await loop.run()
    assert rig.written[-1] == STOP
    assert brain.lengths_s == pytest.approx([0.005] * 20)
    assert len(met) == loop.timing().ticks == 20
    assert loop.timing().missed == 0


async def test_only_ticks_that_met_their_deadline_feed_the_watchdog() -> None:
    rig, brain = Rig(), Brain()
    met: list[float] = []
    loop = ControlLoop(
        rig,
        brain,  # type: ignore[arg-type]
        LateClock(0.005, lambda dt_s: None),
        lambda s: loop.end() if len(brain.lengths_s) == 10 else None,
        met.append,
    )
    loop.busy = True
    await loop.run()
    assert loop.timing().missed == 3
    assert len(met) == 9


async def test_while_time_stands_still_nothing_is_decided() -> None:
    rig, brain = Rig(), Brain()
    ticks = 0

    class Counting(VirtualClock):
        async def tick(self, busy: bool) -> int:
            nonlocal ticks
            ticks += 1
            if ticks == 5:
                loop.end()
            return await super().tick(busy)

    loop = ControlLoop(rig, brain, Counting(0.001, lambda dt_s: None), lambda s: None, lambda t: None)  # type: ignore[arg-type]
    await loop.run()
    assert len(brain.lengths_s) == 1


async def test_who_waits_for_a_tick_s_work_goes_on_after_it_and_nobody_waits_for_a_loop_that_ended() -> None:
    class Yielding(VirtualClock):
        async def tick(self, busy: bool) -> int:
            await asyncio.sleep(0)
            return await super().tick(busy)

    rig, brain = Rig(), Brain()
    told: list[int] = []
    seen: list[tuple[int, int]] = []
    clock = Yielding(0.005, lambda dt_s: None)
    loop = ControlLoop(rig, brain, clock, lambda each: told.append(0), lambda t: None)  # type: ignore[arg-type]
    loop.busy = True

    async def ask() -> None:
        for _ in range(3):
            before = len(told)
            await loop.worked()
            seen.append((before, len(told)))
        loop.end()

    asking = asyncio.create_task(ask())
    await loop.run()
    await asking
    assert all(after > before for before, after in seen)
    await asyncio.wait_for(loop.worked(), 1.0)


async def test_who_waits_for_a_tick_s_work_goes_on_while_virtual_time_stands_still() -> None:
    loop = ControlLoop(Rig(), Brain(), VirtualClock(0.001, lambda dt_s: None), lambda s: None, lambda t: None)  # type: ignore[arg-type]
    running = asyncio.create_task(loop.run())
    for _ in range(3):
        await asyncio.wait_for(loop.worked(), 1.0)
    loop.end()
    await running


async def test_a_broken_brain_keeps_nobody_waiting() -> None:
    broken: Any = Brain(breaks=True)
    loop = ControlLoop(Rig(), broken, VirtualClock(0.005, lambda dt_s: None), lambda s: None, lambda t: None)
    loop.busy = True
    waiting = asyncio.create_task(loop.worked())
    with pytest.raises(ZeroDivisionError):
        await loop.run()
    await asyncio.wait_for(waiting, 1.0)


async def test_while_virtual_time_stands_still_it_says_so_and_no_tick_is_counted() -> None:
    rig, brain = Rig(), Brain()
    stood: list[int] = []
    loop = ControlLoop(
        rig,
        brain,  # type: ignore[arg-type]
        VirtualClock(0.001, lambda dt_s: None),
        lambda sample: None,
        lambda now_s: None,
        lambda: stood.append(len(stood)) if len(stood) < 5 else loop.end(),
    )
    await asyncio.wait_for(loop.run(), 5.0)
    assert len(stood) == 5
    assert loop.timing().ticks == 1
