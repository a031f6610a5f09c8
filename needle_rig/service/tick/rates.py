"""How often each source of the rig is heard."""

from __future__ import annotations

from collections import Counter

from needle_rig.rig import RawReadings

_OVER_S = 1.0


class Rates:
    """Counts readings on their way to `receive`; `hz` has the rate of each source over the last second."""

    def __init__(self, receive: RawReadings) -> None:
        self._receive = receive
        self._counts: Counter[str] = Counter()
        self._since_s: float | None = None
        self.hz: dict[str, float] = {}

    def raw(self, source: str, row: tuple[float, ...]) -> None:
        """One reading; see `rig.RawReadings`."""
        self._counts[source] += 1
        self._receive(source, row)

    def step(self, now_s: float) -> None:
        """Call it every tick."""
        if self._since_s is None:
            self._since_s = now_s
        elapsed_s = now_s - self._since_s
        if elapsed_s >= _OVER_S:
            self.hz = {name: round(self._counts[name] / elapsed_s, 1) for name in {*self._counts, *self.hz}}
            self._counts.clear()
            self._since_s = now_s
