"""When the tick comes: by the kernel's timer, with a sensor's readings, or in virtual time."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Protocol

from needle_rig.service.kernel_timer import KernelTimer

_YIELD_EVERY_S = 0.002
_TICKS_AVERAGED = 16
"""For the interval between readings: some come in pairs, and a pause brings many at once."""


class Clock(Protocol):
    """Gives the time in seconds and paces the ticks."""

    period_s: float
    lateness_s: float
    """How late the newest tick woke up."""

    def now_s(self) -> float:
        """The time since an arbitrary origin; never goes back."""

    async def tick(self, busy: bool) -> int:
        """Wait for the next tick and return how many were skipped since the last one.

        Time may stand still while not `busy`: then `now_s` is what it was at the last tick.
        """

    def overrun(self) -> bool:
        """Whether the deadline of the present tick (the start of the next one) has passed already."""

    def close(self) -> None:
        """Release the timer."""


class TimerClock:
    """Ticks at absolute times start + n · period on the monotonic clock. Needs a running asyncio loop."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.lateness_s = 0.0
        self._period_ns = round(period_s * 1e9)
        self._deadline_ns = time.monotonic_ns() + self._period_ns
        self._loop = asyncio.get_running_loop()
        self._waiting: asyncio.Future[None] | None = None
        self._expired = 0
        self._timer = KernelTimer(self._on_expiry)
        self._timer.set(self._deadline_ns, self._period_ns)

    def now_s(self) -> float:
        """Seconds of the system's monotonic clock."""
        return time.monotonic_ns() * 1e-9

    def _on_expiry(self, times: int) -> None:
        self._expired += times
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)

    async def tick(self, busy: bool) -> int:  # noqa: ARG002 see Clock
        """Wait for the timer; see `Clock.tick`. Real time never stands still."""
        if not self._expired:
            self._waiting = self._loop.create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        else:
            await asyncio.sleep(0)
        passed, self._expired = self._expired, 0
        self._deadline_ns += passed * self._period_ns
        self.lateness_s = (time.monotonic_ns() - (self._deadline_ns - self._period_ns)) * 1e-9
        return passed - 1

    def overrun(self) -> bool:
        """Whether the next tick should have begun."""
        return time.monotonic_ns() > self._deadline_ns

    def close(self) -> None:
        """Close the timer; safe to call twice."""
        self._timer.close()


class Pace:
    """Which readings of a sensor ticks begin with, in ns of any clock.

    A tick begins with the reading nearest to its deadline, at most half the interval between readings before
    or after it; without one, at `latest_ns`, the end of that. The next deadline comes a period after a
    reading that was followed, so that ticks keep the sensor's pace; without readings they keep their own.
    """

    def __init__(self, period_ns: int, now_ns: int) -> None:
        self._period_ns = period_ns
        self._deadline_ns = now_ns + period_ns
        self._begun_ns = now_ns
        self._interval_ns = float(period_ns)
        self._readings = 0
        self.followed_ns: int | None = None
        """When the reading came with which the next tick begins; None while there is none."""

    @property
    def _tolerance_ns(self) -> int:
        return int(min(self._interval_ns, self._period_ns) / 2)

    @property
    def latest_ns(self) -> int:
        """When the next tick begins without a reading."""
        return self._deadline_ns + self._tolerance_ns

    def heard(self, at_ns: int) -> bool:
        """A reading came; whether the next tick begins with it."""
        self._readings += 1
        if self.followed_ns is not None or at_ns < self._deadline_ns - self._tolerance_ns:
            return False
        self.followed_ns = at_ns
        return True

    def begin(self, now_ns: int) -> tuple[int, int]:
        """A tick begins: by how much too late, and how many ticks were skipped before it."""
        skipped = max(now_ns - self.latest_ns, 0) // self._period_ns
        paced_ns = self._deadline_ns
        due_ns = self.latest_ns + skipped * self._period_ns
        if self.followed_ns is not None:
            paced_ns = due_ns = self.followed_ns
        passed = 1 + max(now_ns - paced_ns - self._tolerance_ns, 0) // self._period_ns
        self._deadline_ns = paced_ns + passed * self._period_ns
        if self._readings:
            interval_ns = (now_ns - self._begun_ns) / self._readings
            self._interval_ns += (interval_ns - self._interval_ns) / _TICKS_AVERAGED
        self._begun_ns, self._readings, self.followed_ns = now_ns, 0, None
        return now_ns - due_ns, skipped


class SensorClock:
    """Ticks that follow a sensor's readings (see `Pace`): one is answered as it comes, not a period later."""

    def __init__(self, period_s: float) -> None:
        self.period_s = period_s
        self.lateness_s = 0.0
        self._pace: Pace | None = None
        self._timer: KernelTimer | None = None
        self._waiting: asyncio.Future[None] | None = None

    def now_s(self) -> float:
        """Seconds of the system's monotonic clock."""
        return time.monotonic_ns() * 1e-9

    def heard(self, at_s: float) -> None:
        """A reading came at `at_s` of `now_s`."""
        if self._pace is not None and self._pace.heard(round(at_s * 1e9)):
            self._go_on()

    async def tick(self, busy: bool) -> int:  # noqa: ARG002 see Clock
        """Wait for the reading, or until it is too late for one; see `Clock.tick`."""
        if self._pace is None or self._timer is None:
            self._pace = Pace(round(self.period_s * 1e9), time.monotonic_ns())
            self._timer = KernelTimer(lambda _: self._go_on())
        if self._pace.followed_ns is None and time.monotonic_ns() < self._pace.latest_ns:
            self._timer.set(self._pace.latest_ns)
            self._waiting = asyncio.get_running_loop().create_future()
            try:
                await self._waiting
            finally:
                self._waiting = None
        else:
            await asyncio.sleep(0)
        late_ns, skipped = self._pace.begin(time.monotonic_ns())
        self.lateness_s = late_ns * 1e-9
        return skipped

    def overrun(self) -> bool:
        """Whether the next tick should have begun."""
        return self._pace is not None and time.monotonic_ns() > self._pace.latest_ns

    def close(self) -> None:
        """Close the timer; safe to call twice."""
        if self._timer is not None:
            self._timer.close()

    def _go_on(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class VirtualClock:
    """Time that moves by one period a tick, as fast as ticks are worked off, and rests while nobody is busy.

    `advance` receives each step in seconds: it moves the simulated world.
    """

    lateness_s = 0.0

    def __init__(self, period_s: float, advance: Callable[[float], None]) -> None:
        self.period_s = period_s
        self._advance = advance
        self._ticks = 0
        self._yielded_s = time.monotonic()

    def now_s(self) -> float:
        """Virtual seconds since the start."""
        return self._ticks * self.period_s

    async def tick(self, busy: bool) -> int:
        """Move the world on by one period when `busy`; let others run every few milliseconds."""
        if not busy and self._ticks:
            await asyncio.sleep(self.period_s)
            return 0
        if time.monotonic() - self._yielded_s > _YIELD_EVERY_S:
            await asyncio.sleep(0)
            self._yielded_s = time.monotonic()
        self._advance(self.period_s)
        self._ticks += 1
        return 0

    def overrun(self) -> bool:
        """Virtual time waits for everybody."""
        return False

    def close(self) -> None:
        """Nothing to release."""
