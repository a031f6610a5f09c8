"""The rig whose ports belong to a simulated one, which this process starts and ends."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace

from needle_rig.config.schema import RigConfig
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.errors import RigFault
from needle_rig.records import Command, Firmware, Measurement
from needle_rig.rig import RawReadings
from needle_rig.simulation.bench.process import Bench, spawn

_HELD_UP_S = 0.05
_REMEMBERED_S = 1.0
_BENCH_START_S = 300.0
"""The first start ever compiles the needle's equations."""


class RigOnBench:
    """The ordinary drivers on the ports of a simulated rig, which runs as a child process meanwhile."""

    def __init__(self, config: RigConfig, raw: RawReadings) -> None:
        self._config, self._raw = config, raw
        self._bench: Bench | None = None
        self._hardware: HardwareRig | None = None
        self._held_up: tuple[float, float] | None = None

    async def open(self) -> None:
        """Start the bench and connect to it; BadInput or RigFault when either fails."""
        self._bench = spawn(self._config)
        try:
            await asyncio.to_thread(self._bench.wait_until_ready, _BENCH_START_S)
        except asyncio.CancelledError:
            self._bench.kill()  # the thread, which cannot be cancelled, sees it end
            raise
        self._hardware = HardwareRig(self._bench.configured(self._config), self._raw)
        await self._hardware.open()

    def read(self) -> Measurement:
        """See `Rig.read`; old values of a bench that this machine kept waiting are reported as that."""
        assert self._hardware is not None
        now = self._hardware.read()
        if max(now.torque_age_s, now.hall_age_s, now.drive_age_s) < _HELD_UP_S:
            return now
        assert self._bench is not None
        with contextlib.suppress(RigFault):  # a bench that is gone shows in the ages
            while (said := self._bench.heard(0.0)) is not None:
                if said.get("event") == "late":
                    self._held_up = (float(said["time_s"]), float(said["late_s"]))
        if self._held_up is None or now.time_s - self._held_up[0] > _REMEMBERED_S:
            return now
        told = (
            f"this machine held up the simulated rig for {self._held_up[1] * 1e3:.0f} ms;"
            " leave it a core, or give --fast"
        )
        return replace(now, torque_complaint=told, hall_complaint=told)

    def write(self, command: Command) -> None:
        """See `Rig.write`."""
        if self._hardware is not None:
            self._hardware.write(command)

    def firmware(self) -> dict[str, Firmware]:
        """See `Rig.firmware`."""
        return {} if self._hardware is None else self._hardware.firmware()

    async def close(self) -> None:
        """Stop the drive, release the ports and end the bench."""
        if self._hardware is not None:
            await self._hardware.close()
        if self._bench is not None:
            await asyncio.to_thread(self._bench.close)
