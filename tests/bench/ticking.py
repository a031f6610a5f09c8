"""A brain on a rig in real time, without the daemon around it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

from needle_rig.control.brain import Brain
from needle_rig.records import STOP, Command, DriveState, Measurement
from needle_rig.rig import Rig


class Ticking:
    """Steps `brain` on `rig` every `tick_s` of the loop's clock from `start` to `end`."""

    def __init__(self, rig: Rig, brain: Brain, tick_s: float = 0.005) -> None:
        self.rig, self.brain, self._tick_s = rig, brain, tick_s
        self.measurement: Measurement = rig.read()
        self.command: Command = STOP
        self.tick_s: list[float] = []
        self._waiting: list[tuple[Callable[[], bool], asyncio.Future[None]]] = []
        self._loop = asyncio.get_running_loop()
        self._deadline_s = self._loop.time() + tick_s
        self._handle = self._loop.call_at(self._deadline_s, self._tick)

    async def until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> None:
        """Wait for `condition`, looked at after every tick."""
        future = self._loop.create_future()
        self._waiting.append((condition, future))
        try:
            async with asyncio.timeout(timeout_s):
                await future
        except TimeoutError:
            raise AssertionError(
                f"not within {timeout_s:g} s: {self.brain.state} {self.measurement} {self.command}"
            ) from None

    async def ready(self, timeout_s: float = 20.0) -> None:
        """Clear as a person does until the drive is awake: look first, and again at whatever is new.

        A bench that was starved of its core reads the frames of the last host and of this one at once,
        and takes them for two masters.
        """
        try:
            async with asyncio.timeout(timeout_s):
                while True:
                    await asyncio.sleep(0.2)
                    if self.brain.state.fault is None or self.brain.state.latched:
                        self.brain.clear()
                    await asyncio.sleep(0.2)
                    if self.measurement.drive_state is DriveState.READY and self.brain.state.fault is None:
                        return
        except TimeoutError:
            raise AssertionError(f"not awake within {timeout_s:g} s: {self.brain.state}") from None

    def end(self) -> None:
        self._handle.cancel()

    def _tick(self) -> None:
        now_s = time.monotonic()
        dt_s = now_s - self.tick_s[-1] if self.tick_s else self._tick_s
        self.tick_s.append(now_s)
        self.measurement = self.rig.read()
        self.command, _ = self.brain.step(self.measurement, dt_s)
        self.rig.write(self.command)
        for condition, future in self._waiting:
            if not future.done() and condition():
                future.set_result(None)
        while self._deadline_s <= self._loop.time():
            self._deadline_s += self._tick_s
        self._handle = self._loop.call_at(self._deadline_s, self._tick)
