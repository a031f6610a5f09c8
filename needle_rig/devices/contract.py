"""What every device is held to, tried in a time of its own against its twin: `needle-rig check-device`.

The faults are those of the bench: silence, garble, freeze, restart, a lost host.
"""

from __future__ import annotations

import asyncio
import math
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from needle_rig.control.supervision import BLIND_S
from needle_rig.devices.device import Device, Drive, HallSensors, TorqueSensor, Twin
from needle_rig.devices.memory_host import MemoryHost
from needle_rig.errors import RigFault
from needle_rig.records import COMMAND_AGE_S, RELEASE, STOP, TEMPORARY, Command, DriveState
from needle_rig.units import deg, nm, nmm, rad

SENSORS = ("hall_1", "hall_2", "hall_3", "hall_4")
FRESH_S = 0.05
"""The shipped age limits (`links.*_age_limit_ms`)."""
_STEP_S = 0.001
_STEPS_A_TICK = 5
_LONG_S, _GIVE_UP_STEPS = 0.3, 10_000
_SPEED_RAD_S = rad(45.0)
_SPEED_SHARE = 0.05
"""As the host forgives: `control.following.SCALE_TOLERANCE`."""
_ANGLE_RAD = rad(0.5)
_TORQUE_NM, _TORQUE_TOLERANCE_NM = nm(0.1), nm(0.002)
_LONGEST_STOP_S = 0.3
_CHUNKS = 300


class Broken(Exception):
    """A device does not keep to the contract; what it did."""


@dataclass(frozen=True)
class Clause:
    """One sentence of the contract, and what spoke against it: None when it was kept."""

    name: str
    broken: str | None


class Bench:
    """A device, its host, and its twin, stepped by the millisecond. `fault` is of the way to the host."""

    def __init__(self, device_class: type[Device], options: Any, twin: Twin) -> None:
        self.host = MemoryHost(SENSORS)
        self.twin = twin
        self.twin.reset(self.host.now_s)
        self.device = device_class(options, self.host)
        self.fault = ""
        self.base_rad = 0.0
        self._last: list[tuple[int, bytes]] = []
        self._random = random.Random(1)

    def step(self) -> None:
        """One millisecond."""
        self.host.now_s += _STEP_S
        now_s = self.host.now_s
        while self.host.sent:
            self.twin.receive(now_s, *self.host.sent.popleft())
        if isinstance(self.device, Drive):
            self.twin.angle_rad = self.base_rad  # type: ignore[attr-defined]
        sent = list(self.twin.step(now_s))
        if isinstance(self.device, Drive):
            self.base_rad += self.motor_rad_s * _STEP_S
        if self.fault == "silence":
            return
        if self.fault == "freeze":
            sent = self._last if sent else []
        elif self.fault == "garble":
            sent = [(frame_id, self._random.randbytes(len(data))) for frame_id, data in sent]
        else:
            self._last = sent or self._last
        for frame_id, data in sent:
            self.host.bring(frame_id, data)

    def tick(self, command: Command = STOP, ticks: int = 1) -> None:
        """A drive is sent its command each tick."""
        for _ in range(ticks):
            if isinstance(self.device, Drive):
                self.device.command(command)
            for _ in range(_STEPS_A_TICK):
                self.step()

    def run(self, seconds: float, command: Command = STOP) -> None:
        """Let so much time pass."""
        self.tick(command, round(seconds / _STEP_S / _STEPS_A_TICK))

    async def set_up(self) -> None:
        """Set the device up, while its twin goes on at the pace of a clock: it may wait in a thread."""
        self.host.pages = _Pages(self.twin)
        task = asyncio.create_task(self.device.set_up())
        for _ in range(_GIVE_UP_STEPS):
            self.step()
            if (await asyncio.wait((task,), timeout=_STEP_S))[0]:
                break
        try:
            await task
        except RigFault as fault:
            raise Broken(f"it cannot be set up with its twin: {fault}") from None

    def age_s(self) -> float:
        """How old its newest value is."""
        return self.device.age_s(self.host.now_s)

    @property
    def motor_rad_s(self) -> float:
        """What the twin asks of its motor."""
        return float(self.twin.velocity_rad_s)  # type: ignore[attr-defined]


class _Pages(dict[str, bytes]):
    """The pages that a twin serves."""

    def __init__(self, twin: Twin) -> None:
        super().__init__()
        self._twin = twin

    def __missing__(self, path: str) -> bytes:
        return self._twin.page(path)


def check_device(device_class: type[Device], options: Any, make_twin: Callable[[], Twin]) -> Iterator[Clause]:
    """Every clause that holds for a device of this kind, in the order of their trial."""
    clauses = list(_OF_ALL)
    if issubclass(device_class, Drive):
        clauses += _OF_DRIVES
    elif issubclass(device_class, TorqueSensor):
        clauses += _OF_TORQUE
    elif issubclass(device_class, HallSensors):
        clauses += _OF_HALL
    for name, clause in clauses:
        try:
            bench = Bench(device_class, options, make_twin())
            asyncio.run(clause(bench))
        except Broken as broken:
            yield Clause(name, str(broken))
        except Exception as error:  # noqa: BLE001 an error of a user's device becomes one sentence
            yield Clause(name, f"it raised {type(error).__name__}: {error}")
        else:
            yield Clause(name, None)


def _need(kept: bool, otherwise: str) -> None:
    if not kept:
        raise Broken(otherwise)


def _need_old(bench: Bench, seconds: float, what: str) -> None:
    age_s = bench.age_s()
    _need(
        age_s > seconds - FRESH_S,
        f"{what}, and after {seconds:g} s its value is said to be {age_s:.3f} s old",
    )


async def _heard(bench: Bench) -> None:
    await bench.set_up()
    bench.run(_LONG_S)
    age_s = bench.age_s()
    _need(
        age_s < FRESH_S,
        f"its twin speaks, and its newest value is {age_s:.3f} s old: {bench.device.complaint(0)}",
    )


async def _nothing_before(bench: Bench) -> None:
    device = bench.device
    _need(math.isinf(bench.age_s()), f"its value is said to be {bench.age_s():g} s old")
    if isinstance(device, Drive):
        _need(math.isnan(device.angle_rad), f"its angle is {device.angle_rad}, not NaN")
        _need(device.state is DriveState.SILENT, f"its state is {device.state.name}")
        _need(not device.referenced, "it claims to know its zero")


async def _noise(bench: Bench) -> None:
    draw, host = random.Random(2), bench.host
    for _ in range(_CHUNKS):
        host.now_s += _STEP_S
        host.bring(
            draw.choice((draw.randrange(0x800), 0x101, 0x185)),
            draw.randbytes(draw.choice((0, 1, 7, 8, 36, 60))),
        )
    _need(math.isinf(bench.age_s()), "noise was taken for a reading")


async def _silence(bench: Bench) -> None:
    await _heard(bench)
    bench.fault = "silence"
    bench.run(_LONG_S)
    _need_old(bench, _LONG_S, "nothing came")
    bench.fault = ""
    await bench.set_up()
    bench.run(_LONG_S)
    _need(bench.age_s() < FRESH_S, "it is not heard again after a silence")


async def _garble(bench: Bench) -> None:
    await _heard(bench)
    bench.fault = "garble"
    bench.run(_LONG_S)
    _need_old(bench, _LONG_S, "noise came in its messages' place")


async def _freeze(bench: Bench) -> None:
    await _heard(bench)
    bench.fault = "freeze"
    bench.run(_LONG_S)
    _need_old(bench, _LONG_S, "it repeated its last message")


async def _restart(bench: Bench) -> None:
    await _heard(bench)
    bench.twin.reset(bench.host.now_s)
    bench.run(1.0)
    if isinstance(bench.device, Drive):
        _need(not bench.device.referenced, "its twin started again, and it still claims to know its zero")
        _need(
            bench.device.state is DriveState.SILENT,
            f"its twin started again, and it is {bench.device.state.name}",
        )
    if bench.device.needs_set_up(bench.host.now_s):
        await bench.set_up()
    bench.run(_LONG_S)
    _need(bench.age_s() < FRESH_S, "it is not heard again after a restart")


async def _awake(bench: Bench) -> Drive:
    await _heard(bench)
    drive = bench.device
    assert isinstance(drive, Drive)
    _need(drive.state is DriveState.SILENT, f"it is {drive.state.name} before anybody cleared it")
    for _ in range(4):
        bench.tick(Command(clear=True))
        bench.tick(STOP, 4)
    _need(drive.state is DriveState.READY, f"a clear leaves it {drive.state.name}: {drive.complaint(0)}")
    return drive


async def _turning(bench: Bench, speed_rad_s: float) -> Drive:
    drive = await _awake(bench)
    bench.run(_LONG_S, Command(speed_rad_s, enable=True))
    _need(drive.state is DriveState.RUNNING, f"a velocity leaves it {drive.state.name}")
    return drive


async def _sleeps(bench: Bench) -> None:
    await _heard(bench)
    bench.run(_LONG_S, Command(_SPEED_RAD_S, enable=True))
    _need(bench.base_rad == 0.0, "it turns before anybody cleared it")


async def _follows(bench: Bench) -> None:
    for speed_rad_s in (_SPEED_RAD_S, -_SPEED_RAD_S):
        bench.twin.reset(bench.host.now_s)
        drive = await _turning(bench, speed_rad_s)
        told_rad, base_rad = drive.angle_rad, bench.base_rad
        bench.run(1.0, Command(speed_rad_s, enable=True))
        turned_rad, counted_rad = bench.base_rad - base_rad, drive.angle_rad - told_rad
        _need(
            abs(turned_rad - speed_rad_s) < _SPEED_SHARE * abs(speed_rad_s),
            f"asked for {deg(speed_rad_s):g}°/s it turns at {deg(turned_rad):.1f}°/s",
        )
        _need(
            abs(counted_rad - turned_rad) < _ANGLE_RAD,
            f"the base turned by {deg(turned_rad):.1f}°, and it counts {deg(counted_rad):.1f}°",
        )
        bench.run(_LONGEST_STOP_S, STOP)
        _need(bench.motor_rad_s == 0.0, f"{_LONGEST_STOP_S:g} s after a stop it turns")
        _need(drive.state is DriveState.READY, f"a stop leaves it {drive.state.name}")


async def _refers(bench: Bench) -> None:
    drive = await _awake(bench)
    _need(not drive.referenced, "it claims to know its zero before it was given one")
    bench.tick(Command(reference_rad=rad(30.0)), 20)
    _need(drive.referenced, "it was given its angle, and does not know its zero")
    _need(abs(drive.angle_rad - rad(30.0)) < _ANGLE_RAD, f"told 30° it says {deg(drive.angle_rad):.1f}°")


async def _not_a_number(bench: Bench) -> None:
    drive = await _turning(bench, _SPEED_RAD_S)
    bench.run(_LONGEST_STOP_S, Command(math.nan, enable=True))
    _need(bench.motor_rad_s == 0.0, f"asked for no number it is {drive.state.name} and turns")


async def _host_lost(bench: Bench) -> None:
    drive = await _turning(bench, _SPEED_RAD_S)
    for _ in range(round((COMMAND_AGE_S + _LONGEST_STOP_S) / _STEP_S)):
        bench.step()
    _need(
        bench.motor_rad_s == 0.0,
        f"its host fell silent, and {COMMAND_AGE_S + _LONGEST_STOP_S:g} s later it turns",
    )
    bench.run(_LONG_S, Command(_SPEED_RAD_S, enable=True))
    _need(bench.motor_rad_s == 0.0, "its host came back, and it turns without a clear")
    _need(drive.state is not DriveState.RUNNING, "its host came back, and it runs without a clear")


async def _watched(bench: Bench) -> None:
    drive = await _turning(bench, _SPEED_RAD_S)
    for steps in (1, 20):
        for _ in range(round(_LONG_S / _STEP_S / steps)):
            drive.command(Command(_SPEED_RAD_S, enable=True))
            for _ in range(steps):
                bench.step()
            age_s = bench.age_s()
            _need(
                age_s <= BLIND_S,
                f"at {1.0 / (steps * _STEP_S):g} ticks a second its angle was {age_s * 1e3:.0f} ms old,"
                f" limit {BLIND_S * 1e3:g} ms: the host would stop it",
            )


async def _latches(bench: Bench) -> None:
    drive = await _turning(bench, _SPEED_RAD_S)
    fail = getattr(bench.twin, "fail", None)
    if fail is None:
        return
    fail()
    bench.run(_LONG_S, STOP)
    latches = drive.state is DriveState.FAULT and not (drive.faults and not drive.faults & ~TEMPORARY)
    _need(latches, f"it failed, and is {drive.state.name} with the faults {drive.faults!s}")
    for acknowledge, state in ((False, DriveState.FAULT), (True, DriveState.READY)):
        for _ in range(4):
            bench.tick(Command(clear=True, acknowledge=acknowledge))
            bench.tick(STOP, 4)
        _need(
            drive.state is state,
            f"a clear {'that' if acknowledge else 'before'} a person gave leaves it {drive.state.name}",
        )


async def _releases(bench: Bench) -> None:
    drive = await _turning(bench, _SPEED_RAD_S)
    bench.run(_LONGEST_STOP_S, STOP)
    bench.run(_LONGEST_STOP_S, RELEASE)
    _need(bench.motor_rad_s == 0.0, "it was released, and turns")
    _need(drive.state is DriveState.SILENT, f"it was released, and is {drive.state.name}")


async def _frozen_drive(bench: Bench) -> None:
    drive = await _awake(bench)
    angle_rad = drive.angle_rad
    bench.fault = "freeze"
    bench.run(_LONG_S, Command(_SPEED_RAD_S, enable=True))
    still = drive.angle_rad == angle_rad
    _need(
        bench.age_s() > _LONG_S - FRESH_S or still,
        "it repeated its last message, and its angle went on: nobody would notice",
    )


async def _measures_torque(bench: Bench) -> None:
    device = bench.device
    assert isinstance(device, TorqueSensor)
    for torque_nm in (_TORQUE_NM, -_TORQUE_NM):
        bench.twin.torque_nm = torque_nm  # type: ignore[attr-defined]
        await _heard(bench)
        _need(
            abs(device.torque_nm - torque_nm) < _TORQUE_TOLERANCE_NM,
            f"{nmm(torque_nm):g} N·mm read as {nmm(device.torque_nm):.4f}",
        )


async def _measures_angles(bench: Bench) -> None:
    device = bench.device
    assert isinstance(device, HallSensors)
    angles_rad = [rad(10.0 * n) for n in range(len(SENSORS))]
    bench.twin.hall_rad = tuple(angles_rad)  # type: ignore[attr-defined]
    await _heard(bench)
    for _ in range(200):  # two turns of the first, a turn back of the second
        angles_rad[0] += rad(3.6)
        angles_rad[1] -= rad(1.8)
        bench.twin.hall_rad = tuple(angles_rad)  # type: ignore[attr-defined]
        bench.run(0.02)
    off_deg = [deg(abs(a - b)) for a, b in zip(device.angle_rad, angles_rad, strict=True)]
    told = ", ".join(f"{deg(angle):.1f}°" for angle in device.angle_rad)
    truth = ", ".join(f"{deg(angle):.1f}°" for angle in angles_rad)
    _need(max(off_deg) < deg(_ANGLE_RAD), f"{truth} read as {told}")


_OF_ALL = (
    ("before the first message nothing is known", _nothing_before),
    ("noise is no reading", _noise),
    ("what it sends is heard, and young", _heard),
    ("in a silence its value grows old, and it is heard again", _silence),
    ("garbled messages are no readings", _garble),
    ("a restart is noticed, and it is heard again", _restart),
)
_REPEATS = (("a message that repeats itself grows old", _freeze),)
_OF_TORQUE = (*_REPEATS, ("it measures torque, with its sign", _measures_torque))
_OF_HALL = (*_REPEATS, ("it measures angles over any number of turns", _measures_angles))
_OF_DRIVES = (
    ("it sleeps until a clear", _sleeps),
    ("it turns as asked and counts what it turned, both ways, and stops", _follows),
    ("it takes a reference", _refers),
    ("a velocity that is no number stops it", _not_a_number),
    ("it stops by itself when its host falls silent, and sleeps until a clear", _host_lost),
    ("while it turns its angle is at most 100 ms old, at 50 to 1000 ticks a second", _watched),
    ("a fault that latches stays until a clear that a person gave", _latches),
    ("a release lets go of the base", _releases),
    ("a message that repeats itself grows old, or its angle stands still", _frozen_drive),
)
