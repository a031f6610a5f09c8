"""Stretches in which a channel is nothing but 0, as where a file was overwritten or a wire was off."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needle_rig.importing.guess.series import FEWEST, Series, values_at
from needle_rig.importing.mapping import BASE, TORQUE, ChannelPart
from needle_rig.numerics import Array

CHANCE = 1e-3
"""Probability below which a run of equal values is none of those that the channel has elsewhere."""
NOTHING = 1e-12
"""Of the largest value: a number most of whose bytes are 0 is smaller."""
EDGE = 2
"""Rows of a jump: where a number is overwritten in part, it stands between both sides."""
FARTHER = 2.0
"""Times the largest change elsewhere: a motion that is fastest where it begins is no jump."""
MOVED = 0.01
"""Share of the base's span that it turns by at least where it moves."""


def doubt_dropouts(channels: Sequence[ChannelPart], series: Sequence[Series]) -> list[ChannelPart]:
    """The channels; of one that drops out it is asked whether it really was 0."""
    by_place = {(s.clock, s.column.name): s for s in series}
    base = next(by_place[c.clock, c.source] for c in channels if c.role == BASE)
    told = []
    for channel in channels:
        s = by_place[channel.clock, channel.source]
        # an angle stands where a play is between it and the base, a torque that resists does not
        found = dropout(s.values, values_at(s, base) if channel.role == TORQUE else None)
        if found is not None:
            begin_s, end_s = (float(s.time_s[k] - s.time_s[0]) for k in (found[0], found[1] - 1))
            doubt = (
                f"it is 0 from {begin_s:.6g} s to {end_s:.6g} s after its start, and nowhere else so long: is"
                " it a dropout? Leave these fields empty, or record it again"
            )
            channel = channel.model_copy(update={"doubt": "; ".join(filter(None, (channel.doubt, doubt)))})
        told.append(channel)
    return told


def dropout(values: Array, base: Array | None = None) -> tuple[int, int] | None:
    """Samples [begin, end) of `values` (samples,) in which a channel drops out; None where it does not.

    It is 0 for longer than its other runs of equal values make likely. It enters or leaves by more than twice
    what it changes in as many samples elsewhere, or is 0 while its `base` (samples,) moves. Runs of a chance
    p for each value are about ln N/ln(1/p) long in N samples, and longer ones as p to their length: so the
    longest of the others says how long one may be.
    """
    known = np.flatnonzero(np.isfinite(values))
    x = values[known]
    if len(x) <= FEWEST:
        return None
    x = np.where(np.abs(x) > NOTHING * float(np.abs(x).max()), x, 0.0)
    edges = np.concatenate(([0], np.flatnonzero(np.diff(x)) + 1, [len(x)]))
    lengths = np.diff(edges)
    zeros = np.flatnonzero(x[edges[:-1]] == 0.0)
    if not len(zeros) or len(lengths) < 2:
        return None
    run = int(zeros[np.argmax(lengths[zeros])])
    begin, end, longest = int(edges[run]), int(edges[run + 1]), int(lengths[run])
    usual = int(np.delete(lengths, run).max())
    if longest < FEWEST or longest < usual * (1.0 - math.log(CHANCE) / math.log(len(x))):
        return None
    if not _jumps(x, begin, end) and (base is None or not _moves(base[known], begin, end)):
        return None
    return int(known[begin]), int(known[end - 1]) + 1


def _jumps(x: Array, begin: int, end: int) -> bool:
    outside = np.r_[max(0, begin - EDGE) : begin, end : min(len(x), end + EDGE)]
    changes = np.abs(x[EDGE:] - x[:-EDGE])
    elsewhere = np.r_[changes[: max(0, begin - EDGE)], changes[end:]]
    return bool(len(elsewhere) > 0 and np.abs(x[outside]).max() > FARTHER * elsewhere.max())


def _moves(base: Array, begin: int, end: int) -> bool:
    there = base[begin:end][np.isfinite(base[begin:end])]
    span = float(np.ptp(base[np.isfinite(base)])) if len(there) else 0.0
    return span > 0.0 and float(np.ptp(there)) > MOVED * span
