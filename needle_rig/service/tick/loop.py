"""The tick: read the rig, let the brain decide, write the command."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from needle_rig.control.brain import Brain
from needle_rig.records import STOP, Sample
from needle_rig.rig import Rig
from needle_rig.service.tick.clock import Clock

_REMEMBERED_TICKS = 4096


@dataclass(frozen=True)
class Timing:
    """How well ticks kept their time. `missed` counts ticks skipped, or not done when the next was due."""

    ticks: int
    missed: int
    late_p50_s: float
    late_p99_s: float
    late_max_s: float


class ControlLoop:
    """Runs ticks until told to end, and always leaves the drive told to stop.

    `on_sample` receives each tick's sample; `on_met` is called with the time after every tick that met its
    deadline: it feeds the watchdog; `on_standstill` when time stood still in place of a tick.
    """

    def __init__(
        self,
        rig: Rig,
        brain: Brain,
        clock: Clock,
        on_sample: Callable[[Sample], None],
        on_met: Callable[[float], None],
        on_standstill: Callable[[], None] = lambda: None,
    ) -> None:
        self._rig, self._brain, self._clock = rig, brain, clock
        self._on_sample, self._on_met, self._on_standstill = on_sample, on_met, on_standstill
        self._ticks = 0
        self._missed = 0
        self._late_s = np.zeros(_REMEMBERED_TICKS)
        self._ending = False
        self._ended = False
        self._worked = asyncio.Event()
        self.busy = False
        """Something is going on; while nothing is, virtual time may stand still."""

    async def run(self) -> None:
        """Tick until `end`; whatever happens, the last word to the drive is stop."""
        brain, rig, clock = self._brain, self._rig, self._clock
        before_s: float | None = None
        try:
            while not self._ending:
                skipped = await clock.tick(self.busy)
                now_s = clock.now_s()
                if now_s == before_s:
                    self._on_standstill()
                    self._wake()
                    continue
                dt_s = clock.period_s if before_s is None else now_s - before_s
                before_s = now_s
                measurement = rig.read()
                command, sample = brain.step(measurement, dt_s)
                rig.write(command)
                self._on_sample(sample)
                self._late_s[self._ticks % _REMEMBERED_TICKS] = clock.lateness_s
                self._ticks += 1
                overrun = clock.overrun()
                self._missed += skipped + overrun
                if not overrun:
                    self._on_met(now_s)
                self._wake()
        finally:
            try:
                rig.write(STOP)
            finally:
                self._ended = True
                self._wake()

    async def worked(self) -> None:
        """Wait until a tick's work is done; what follows then has the longest time before the next tick."""
        if not self._ended:
            await self._worked.wait()

    def _wake(self) -> None:
        """Let those go on who wait now; who comes later waits for the next tick."""
        self._worked.set()
        self._worked.clear()

    def end(self) -> None:
        """Leave `run` after the present tick."""
        self._ending = True

    def timing(self) -> Timing:
        """Counts since the start; lateness over the newest ticks."""
        late_s = self._late_s[: max(self._ticks, 1)]
        places = [len(late_s) // 2, int(len(late_s) * 0.99), len(late_s) - 1]
        p50_s, p99_s, max_s = np.partition(late_s, places)[places]
        return Timing(self._ticks, self._missed, float(p50_s), float(p99_s), float(max_s))
