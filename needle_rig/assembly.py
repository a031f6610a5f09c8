"""Builds everything from a rig file, once, in plain Python."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from needle_rig.control.brain import Brain
from needle_rig.control.strategy import find_strategies
from needle_rig.service.installed.logbook import Logbook
from needle_rig.service.tick.clock import Clock, TimerClock, VirtualClock
from needle_rig.service.tick.daemon import Daemon, Parts
from needle_rig.service.tick.notify import Notify
from needle_rig.service.tick.realtime import make_steady
from needle_rig.service.tick.thinker import Thinker

if TYPE_CHECKING:
    from needle_rig.config.schema import RigConfig
    from needle_rig.control.strategy import Trust
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.rig import RawReadings, Rig
    from needle_rig.simulation.firmware_rig import FirmwareRig
    from needle_rig.simulation.plant import Plant


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
    from needle_rig.service.tick.rig_on_bench import RigOnBench
    from needle_rig.simulation.bench.process import needs_bench

    if needs_bench(config):
        return RigOnBench(config, raw)
    rig = HardwareRig(config, raw)
    return LateRig(rig, len(config.layout.hall_sensors)) if resident else rig
