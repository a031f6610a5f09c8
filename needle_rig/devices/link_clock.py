"""Judges which frames of a link are news, and how old the newest is."""

from __future__ import annotations

import math

from needle_rig.devices.shortest_way import RC_TOLERANCE, STEP_S, ShortestWay

_LATENCY_LIMIT_S = 0.25
_CONFIRMATIONS = 3
_CONFIRMATION_S = 0.02
_FRAMES_LOST = 4
"""Steps of the node's clock from one frame to the next, when frames were lost and the clock went on."""


class LinkClock:
    """Follows the counter and the clock of one node, so that a value is as old as its sample.

    A frame is news when its counter and its node time both moved on, and its node time is where the node's
    clock must be by now; a repeated frame, a replay and random bytes that pass the checksum are not.
    The first frames, and those of a node that started again, count after three in a row that agree over 20 ms
    of host time: old data that arrive in one lump after a pause agree too.

    A frame is as late as its offset (host minus node time) is above the shortest way through the link. Times
    cannot tell a clock that is slow from a queue that grows at a constant pace, so `rate_tolerance` bounds
    what is hidden: a queue that grows from the first frame on hides that share of the time. In the first ten
    seconds the rate is learnt. At 50 frames a second a queue that begins to grow by 0.5 % or more afterwards
    hides 50 ms at most. Once it is later than 0.25 s its frames are no news. Growth by less than 0.15 % may
    be a node that warms up, and is hidden. A delay that comes at once and with lost frames may be another
    clock, whose rate is learnt anew.
    """

    def __init__(self, clock_period_s: float, rate_tolerance: float = RC_TOLERANCE) -> None:
        self._period_s = clock_period_s
        self._tolerance = rate_tolerance
        self._counter: int | None = None
        self._node_s = 0.0
        self._node_step_s = math.inf
        self._arrival_s = 0.0
        self._offset_s = math.nan
        self._way: ShortestWay
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
        # The offset nearest to that of the frame before, whatever turns the node's clock made.
        expected_s = self._offset_s
        if now_s != self._arrival_s:  # else they were read at once
            expected_s += self._way.at(now_s) - self._way.at(self._arrival_s)
        step_s = math.remainder(now_s - node_time_s - expected_s, self._period_s)
        if abs(step_s) > _LATENCY_LIMIT_S:
            return self._reconsider(counter, node_time_s, now_s)
        self._candidate = None
        node_step_s = (node_time_s - self._node_s) % self._period_s
        if abs(step_s) <= STEP_S:
            self._node_step_s = node_step_s
        elif step_s > 0.0 and node_step_s > _FRAMES_LOST * self._node_step_s:
            self._way.forget(now_s)
        self._counter, self._node_s, self._arrival_s = counter, node_time_s, now_s
        self._offset_s = expected_s + step_s
        late_s = self._way.take(self._offset_s, now_s)
        if late_s > _LATENCY_LIMIT_S:
            return False
        self._sampled_s = now_s - late_s
        return True

    def age_s(self, now_s: float) -> float:
        """Time since the newest reading was sampled; infinite before the first."""
        return max(now_s - self._sampled_s, 0.0)

    def _reconsider(self, counter: int, node_time_s: float, now_s: float) -> bool:
        """Take over another clock once enough frames in a row agree on it."""
        candidate = self._candidate
        if candidate is None or not candidate.accept(counter, node_time_s, now_s):
            self._candidate = LinkClock(self._period_s, self._tolerance)
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
        self._node_step_s = math.inf
        self._way = ShortestWay(self._offset_s, now_s, self._tolerance)
        self._begun_s = now_s
