"""Builds everything from a rig file, once, in plain Python."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.control.brain import Brain
from needle_rig.control.strategy import find_strategies
from needle_rig.errors import RigFault
from needle_rig.service.logbook import Logbook
from needle_rig.service.tick.clock import Clock, TimerClock, VirtualClock
from needle_rig.service.tick.daemon import Daemon, Parts
from needle_rig.service.tick.notify import Notify
from needle_rig.service.tick.realtime import make_steady
from needle_rig.service.tick.thinker import Thinker

if TYPE_CHECKING:
    from needle_rig.config.schema import RigConfig
    from needle_rig.control.strategy import Trust
    from needle_rig.devices.hardware_rig import HardwareRig
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.records import Command, Firmware, Measurement
    from needle_rig.rig import RawReadings, Rig
    from needle_rig.simulation.bench import Bench
    from needle_rig.simulation.firmware_rig import FirmwareRig
    from needle_rig.simulation.plant import Plant

_HELD_UP_S = 0.05
_REMEMBERED_S = 1.0
_BENCH_START_S = 300.0
"""The first start ever compiles the needle's equations."""


def build_daemon(
    config: RigConfig,
    *,
    virtual: bool = False,
    runs: Path | None = None,
    model: NeedleModel | None = None,
    trust: Trust | None = None,
    resident: bool = False,
) -> Daemon:
    """The daemon of a rig file.

    `virtual` puts the plant, behind its nodes' firmware where the rig file asks for it, in the rig's place
    and lets time pass as fast as it can. `runs` stands in for the configured folder. `model` is what planning
    strategies know of the needle, `trust` how well. A `resident` one outlives its rig, which
    need not be there at the start.
    Raises BadInput.
    """
    period_s = 1.0 / config.tick_hz
    folder = Path(config.recording.directory) if runs is None else runs
    if virtual:
        parts = _virtual_parts(config, model, trust, period_s)
    else:
        parts = _real_parts(config, model, trust, period_s, resident=resident)
    return Daemon(parts, folder, Notify(), Logbook.of_service())


def _real_parts(
    config: RigConfig, model: NeedleModel | None, trust: Trust | None, period_s: float, *, resident: bool
) -> Parts:
    # imported now: looking for strategies within a run would hold up the tick
    find_strategies()
    thinker = Thinker(config.sequence.motion_timeout_s)
    return Parts(
        config,
        Brain(config, model, thinker, trust),
        make_rig=lambda raw: _real_rig(config, raw, resident=resident),
        make_clock=lambda _: TimerClock(period_s),
        make_steady=make_steady,
        simulated=config.kind == "simulated",
        thinker=thinker,
    )


def _virtual_parts(
    config: RigConfig, model: NeedleModel | None, trust: Trust | None, period_s: float
) -> Parts:
    from needle_rig.simulation.build import build_plant
    from needle_rig.simulation.firmware_rig import FirmwareRig

    rigs: list[Plant | FirmwareRig] = []

    def make_rig(raw: RawReadings) -> Rig:
        if config.simulation is not None and config.simulation.nodes != "python":
            rigs.append(FirmwareRig(config, build_plant(config), raw=raw))
        else:
            rigs.append(build_plant(config, raw))
        return rigs[-1]

    def make_clock(_: Rig) -> Clock:
        return VirtualClock(period_s, rigs[-1].advance)

    thinker = Thinker(config.sequence.motion_timeout_s)
    return Parts(
        config,
        Brain(config, model, thinker, trust),
        make_rig,
        make_clock,
        make_steady=list,
        simulated=True,
        thinker=thinker,
    )


def _real_rig(config: RigConfig, raw: RawReadings, *, resident: bool) -> Rig:
    """The rig behind its ports; the ports called `auto` belong to a simulated rig, which is started."""
    from needle_rig.devices.hardware_rig import HardwareRig
    from needle_rig.service.tick.late_rig import LateRig
    from needle_rig.simulation.bench import needs_bench

    if needs_bench(config):
        return RigOnBench(config, raw)
    rig = HardwareRig(config, raw)
    return LateRig(rig, len(config.layout.hall_sensors)) if resident else rig


class RigOnBench:
    """The ordinary drivers on the ports of a simulated rig, which runs as a child process meanwhile."""

    def __init__(self, config: RigConfig, raw: RawReadings) -> None:
        self._config, self._raw = config, raw
        self._bench: Bench | None = None
        self._hardware: HardwareRig | None = None
        self._held_up: tuple[float, float] | None = None

    async def open(self) -> None:
        """Start the bench and connect to it; BadInput or RigFault when either fails."""
        from needle_rig.devices.hardware_rig import HardwareRig
        from needle_rig.simulation.bench import spawn

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
