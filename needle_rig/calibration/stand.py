"""Where a calibration is measured: on the simulated rig, or on a real one with a person's hands."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, RigFault
from needle_rig.numerics import Array
from needle_rig.records import STOP, Command, DriveState
from needle_rig.units import nmm, rad
from needle_rig.wire.hall_frames import HallFrame

TICK_S = 0.005


@dataclass(frozen=True)
class Collected:
    """Readings of one tick each: `base_rad`, `torque_nmm` (n,), `raw_rad`, `field` (n, sensors)."""

    base_rad: Array
    torque_nmm: Array
    raw_rad: Array
    field: Array


class Stand(Protocol):
    """What a calibration needs of the world."""

    config: RigConfig
    rig: Any

    async def wait(self, seconds: float) -> None:
        """Let time pass."""

    async def ask(self, text: str) -> None:
        """Have a person do something."""

    async def hand_turn(self, turns: float) -> None:
        """The base is turned by hand by so many turns, counter-clockwise."""

    async def hang(self, weight_nmm: float) -> None:
        """This torque hangs on the load cell."""


class BenchStand:
    """The firmware around a free needle, in virtual time; nodes other than `kind` keep their pages."""

    def __init__(self, kind: str, pages: Path, overrides: Mapping[str, object]) -> None:
        import shutil
        import tempfile

        from needle_rig.simulation.build import build_plant
        from needle_rig.simulation.firmware_rig import FirmwareRig

        with tempfile.TemporaryDirectory() as flashed:
            for page in pages.glob("*.hex"):
                if page.stem != kind:
                    shutil.copy(page, flashed)
            wanted = {"simulation.nodes": "firmware", "simulation.free_needle": True}
            self.config = load_rig_config(None, {**wanted, **overrides, "simulation.node_pages": flashed})
            self.rig: Any = FirmwareRig(self.config, build_plant(self.config))

    async def wait(self, seconds: float) -> None:
        """Let virtual time pass."""
        self.rig.advance(seconds)

    async def ask(self, text: str) -> None:
        """The bench needs no hands."""

    async def hand_turn(self, turns: float) -> None:
        """Turn the simulated base at a third of a turn a second."""
        speed = math.tau / 3.0
        self.rig.hand_rad_s = math.copysign(speed, turns)
        self.rig.advance(abs(turns) * math.tau / speed)
        self.rig.hand_rad_s = 0.0

    async def hang(self, weight_nmm: float) -> None:
        """Put the weight on the simulated cell."""
        self.rig.nodes.front_end.weight_nmm = weight_nmm


class RealStand:
    """A rig of our nodes behind its ports and a person in front of it. Raises BadInput for other devices."""

    def __init__(self, config: RigConfig, confirm: Callable[[str], None]) -> None:
        from needle_rig.devices.hardware_rig import HardwareRig

        for link in ("drive", "torque", "hall"):
            device = getattr(config.links, link).device
            if device != "node":
                raise BadInput(
                    f"links.{link}.device: {device} keeps no calibration of ours; use its maker's tool"
                )
        self.config = config
        self.rig: Any = HardwareRig(config)
        self._confirm = confirm

    async def wait(self, seconds: float) -> None:
        """Let time pass, with the links served."""
        await asyncio.sleep(seconds)

    async def ask(self, text: str) -> None:
        """Ask on the terminal while the links go on."""
        await asyncio.to_thread(self._confirm, text)

    async def hand_turn(self, turns: float) -> None:
        """Ask for the turn."""
        way = "counter-clockwise" if turns > 0 else "clockwise"
        await self.ask(f"Turn the base by hand, {way} seen from the base, {abs(turns):g} turn, mark to mark")

    async def hang(self, weight_nmm: float) -> None:
        """Ask for the weight."""
        await self.ask(
            f"Put {weight_nmm:g} N·mm on the load cell" if weight_nmm else "Take all weight off the cell"
        )


async def collect(stand: Stand, seconds: float, command: Command = STOP) -> Collected:
    """Send `command` every tick for so many seconds; the readings of each tick.

    Raises RigFault when the drive stops or a link is silent.
    """
    base, torque, angles, fields = [], [], [], []
    for _ in range(round(seconds / TICK_S)):
        stand.rig.write(command)
        await stand.wait(TICK_S)
        now = stand.rig.read()
        frame: HallFrame | None = stand.rig.hall_frame
        if frame is None or max(now.torque_age_s, now.drive_age_s, now.hall_age_s) > 0.5:
            raise RigFault("a link is silent; look at the cables, and again")
        if command.enable and now.drive_state is DriveState.FAULT:
            raise RigFault(f"the drive stopped ({now.drive_faults!r}); encoder calibrated? way free?")
        base.append(now.base_angle_rad)
        torque.append(nmm(now.torque_nm))
        angles.append(frame.angle_rad)
        fields.append(frame.field)
    return Collected(np.array(base), np.array(torque), np.array(angles), np.array(fields, dtype=np.float64))


async def make_ready(stand: Stand) -> None:
    """Clear the drive. Raises RigFault when it does not get ready."""
    for command, seconds in ((STOP, 0.05), (Command(clear=True), 0.2), (STOP, 0.05)):
        await collect(stand, seconds, command)
    if stand.rig.read().drive_state not in (DriveState.READY, DriveState.RUNNING):
        raise RigFault("the drive does not get ready within 0.3 s; needle-rig status tells why")


async def jog(stand: Stand, speed_deg_s: float, seconds: float) -> Collected:
    """Turn at this speed for so long, then hold."""
    moved = await collect(stand, seconds, Command(rad(speed_deg_s), enable=True))
    await collect(stand, 0.3)
    return moved
