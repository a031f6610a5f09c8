"""A rig that is switched on after its daemon is found; until then the daemon says what is missing."""

from __future__ import annotations

import asyncio
import math

import pytest

from needle_rig.config.files import shipped_file
from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import STOP, Command, DriveState, Firmware, Measurement, Phase
from needle_rig.service.tick.late_rig import LateRig

MISSING = "CAN bus (socketcan can0): there is no interface can0"


class FakeRig:
    """Answers once `there` is true."""

    def __init__(self) -> None:
        self.there = self.closed = False
        self.broken: Exception | None = None
        self.opened = 0
        self.told: list[Command] = []

    async def open(self) -> None:
        self.opened += 1
        if self.broken is not None:
            raise self.broken
        if not self.there:
            raise RigFault(MISSING)

    def read(self) -> Measurement:
        return Measurement(
            1.0, 0.5, 0.0, (0.5,), DriveState.SILENT, torque_age_s=0, hall_age_s=0, drive_age_s=0
        )

    def firmware(self) -> dict[str, Firmware]:
        return {"drive": Firmware(protocol=2, refusal=MISSING)}

    def write(self, command: Command) -> None:
        self.told.append(command)

    async def close(self) -> None:
        self.closed = True


@pytest.fixture
def fake() -> FakeRig:
    return FakeRig()


def late_rig(fake: FakeRig) -> LateRig:
    return LateRig(fake, 4, now=lambda: 7.0, again_s=0.001)


async def test_a_rig_that_is_not_there_reads_as_dead_links_with_the_reason(fake: FakeRig) -> None:
    rig = late_rig(fake)
    await rig.open()
    seen = rig.read()
    rig.write(STOP)
    assert (seen.time_s, seen.drive_state, seen.referenced) == (7.0, DriveState.SILENT, False)
    assert all(math.isinf(age) for age in (seen.torque_age_s, seen.hall_age_s, seen.drive_age_s))
    assert seen.torque_complaint == seen.hall_complaint == MISSING
    assert len(seen.hall_rad) == 4
    await rig.close()


async def test_it_is_opened_when_it_comes_and_used_from_then_on(fake: FakeRig) -> None:
    rig = late_rig(fake)
    await rig.open()
    await asyncio.sleep(0.01)
    assert fake.opened > 1
    fake.there = True
    async with asyncio.timeout(5):
        while math.isnan(rig.read().base_angle_rad):
            await asyncio.sleep(0.001)
    attempts = fake.opened
    await asyncio.sleep(0.01)
    assert fake.opened == attempts
    rig.write(STOP)
    assert fake.told == [STOP]
    await rig.close()
    assert fake.closed


async def test_a_defect_while_it_is_opened_is_told_and_it_is_tried_again(fake: FakeRig) -> None:
    rig = late_rig(fake)
    await rig.open()
    fake.broken = ZeroDivisionError()
    async with asyncio.timeout(5):
        while "ZeroDivisionError" not in rig.read().torque_complaint:
            await asyncio.sleep(0.001)
    fake.broken, fake.there = None, True
    async with asyncio.timeout(5):
        while math.isnan(rig.read().base_angle_rad):
            await asyncio.sleep(0.001)
    await rig.close()


async def test_a_rig_that_can_never_be_opened_is_told_at_once(fake: FakeRig) -> None:
    fake.broken = BadInput("links.can: no such thing")
    with pytest.raises(BadInput):
        await late_rig(fake).open()


async def test_the_brain_refuses_motions_until_the_rig_answers(
    fake: FakeRig,
) -> None:
    brain = Brain(load_rig_config(shipped_file("rig.hardware.yaml")))
    rig = late_rig(fake)
    await rig.open()
    for _ in range(5):
        command, _ = brain.step(rig.read(), 0.005)
        assert not command.enable
    assert brain.state.phase is Phase.FAULT
    assert MISSING in (brain.state.fault or "")
    assert not brain.state.latched
    with pytest.raises(RigFault, match="there is no interface can0"):
        brain.compensate(Request(0.1, "reed2008", {}))
    await rig.close()
