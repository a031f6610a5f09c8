"""Judges which frames of a link are news, and how old the newest is."""

from __future__ import annotations

import math

_LATENCY_LIMIT_S = 0.25
_CONFIRMATIONS = 3
_CONFIRMATION_S = 0.02
_DRIFT = 0.02


class LinkClock:
    """Follows the counter and the clock of one node, so that a value is as old as its sample.

    A frame is news when its counter and its node time both moved on, and its node time is where the node's
    clock must be by now; a repeated frame, a replay and random bytes that pass the checksum are not.
    The first frames, and those of a node that started again, count after three in a row that agree over 20 ms
    of host time: old data that arrive in one lump after a pause agree too.

    Host minus node time is tracked as the least seen, which is the shortest way through the link; it may
    drift upwards by 2 % (an RC oscillator), so that data queueing up anywhere on the way shows as age.
    """

    def __init__(self, clock_period_s: float) -> None:
        self._period_s = clock_period_s
        self._counter: int | None = None
        self._node_s = 0.0
        self._arrival_s = 0.0
        self._offset_s = math.nan
        self._sampled_s = -math.inf
        self._candidate: LinkClock | None = None
        self._agreed = 0
        self._begun_s = 0.0

    def accept(self, counter: int, node_time_s: float, now_s: float) -> bool:
        """Whether this frame, received at `now_s` on the host's clock, is news; if so, age counts from it."""
        if self._counter is None:
            return self._reconsider(counter, node_time_s, now_s)
        if counter == self._counter or node_time_s == self._node_s:
            return False
        # The offset at which this frame fits best, allowing for any number of turns of the node's clock.
        least_s = self._offset_s + _DRIFT * (now_s - self._arrival_s)
        latency_s = math.remainder(now_s - node_time_s - least_s, self._period_s)
        if abs(latency_s) > _LATENCY_LIMIT_S:
            return self._reconsider(counter, node_time_s, now_s)
        self._candidate = None
        self._counter, self._node_s, self._arrival_s = counter, node_time_s, now_s
        self._offset_s = least_s + min(latency_s, 0.0)
        self._sampled_s = now_s - max(latency_s, 0.0)
        return True

    def age_s(self, now_s: float) -> float:
        """Time since the newest reading was sampled; infinite before the first."""
        return max(now_s - self._sampled_s, 0.0)

    def _reconsider(self, counter: int, node_time_s: float, now_s: float) -> bool:
        """Take over another clock once enough frames in a row agree on it."""
        candidate = self._candidate
        if candidate is None or not candidate.accept(counter, node_time_s, now_s):
            self._candidate = LinkClock(self._period_s)
            self._candidate._start(counter, node_time_s, now_s)
            return False
        candidate._agreed += 1
        if candidate._agreed < _CONFIRMATIONS or now_s - candidate._begun_s < _CONFIRMATION_S:
            return False
        self._start(counter, node_time_s, now_s)
        self._candidate = None
        return True

    def _start(self, counter: int, node_time_s: float, now_s: float) -> None:
        self._counter, self._node_s, self._arrival_s = counter, node_time_s, now_s
        self._offset_s, self._sampled_s, self._agreed = now_s - node_time_s, now_s, 1
        self._begun_s = now_s
