"""Where a recording is cut into trials, and how many samples of it a dataset keeps."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from needle_rig.dataset.description import RigPart
from needle_rig.dataset.samples import AT_REST_DEG_S, rest_rate_deg_s
from needle_rig.dataset.table import MAX_SAMPLES
from needle_rig.importing import names, signals
from needle_rig.importing.axes import SUMMED, USUAL_LEVER_MM, size_si, summed
from needle_rig.importing.guess.kinds import kind_of
from needle_rig.importing.guess.series import Series, may_wrap, turn_of
from needle_rig.importing.mapping import ChannelPart, TrialsPart
from needle_rig.importing.unit_text import unit_of
from needle_rig.numerics import Array
from needle_rig.physics.machine import NEEDLE

AT_REST = 0.005
"""Share of the largest rate up to which a base stands whose unit is not known."""
LEAST_OF_A_STROKE, MOST_OF_A_STROKE = 14, 64
"""Samples of a stroke of the base between two turns: one for each bin of a motion (`MOVING_BINS` of the
workbench), and four of the windows that noise is read from (`SMOOTH_WINDOW`): one with the turn, most
without, also in strokes half as long. 42 drive a model (`MOVING_BLOCKS`)."""
AT_RESTS = "cut where the base rests as it stood at the start, without torque or twist"


def trials_of(series: Sequence[Series]) -> tuple[TrialsPart, list[Series]]:
    """A column that numbers trials, or rests; with the other series."""
    for s in series:
        known = s.column.values[np.isfinite(s.column.values)]
        changes = np.flatnonzero(np.diff(known))
        if names.TRIAL.fullmatch(names.plain(s.column.name)) and 0 < len(changes) < 500:
            part = TrialsPart(
                at="column", clock=s.clock, source=s.column.name, why=f"name; {len(changes) + 1} stretches"
            )
            return part, [x for x in series if x is not s]
    return TrialsPart(at="rests", why=AT_RESTS), list(series)


def rate_of_dataset(series: Sequence[Series], channels: Sequence[ChannelPart]) -> float | None:
    """Samples a second that keep a trial of the whole length below what a dataset holds; None to keep all.

    Samples are averaged while each stroke of the base keeps one for each bin. Where it cannot, a stroke keeps
    what a model is driven by and noise is measured from, and a trial loses its end: an average over a turn
    rubs neither way.
    """
    s = _of_base(series, channels[0])
    rows = len(s.column.values)
    length_s = float(s.time_s[-1] - s.time_s[0])
    if rows <= MAX_SAMPLES or length_s <= 0:
        return None
    nice = [m * 10.0**e for e in range(-3, 6) for m in (1.0, 2.0, 5.0)]
    own_hz = rows / length_s
    even = max(r for r in nice if r <= min(MAX_SAMPLES / length_s, own_hz))
    stroke_s = signals.stroke_samples(_path(s)) / own_hz
    if even * stroke_s >= LEAST_OF_A_STROKE:
        return even
    wanted = min((r for r in nice if r * stroke_s >= MOST_OF_A_STROKE), default=own_hz)
    return max(even, *(r for r in nice if r <= min(wanted, own_hz)))


def _of_base(series: Sequence[Series], base: ChannelPart) -> Series:
    """The base's column on its clock."""
    return next(x for x in series if x.clock == base.clock and x.column.name == base.source)


def _path(s: Series) -> Array:
    """Every known sample of a base, unwrapped, or what its rate sums up to; in no unit."""
    values = s.column.values[np.isfinite(s.column.values)]
    if kind_of(s.column)[0] in SUMMED:
        return np.asarray(np.cumsum(values))
    return signals.without_wraps(values, turn_of(s.column)) if may_wrap(s.column) else values


def known_start(
    trials: TrialsPart,
    base: ChannelPart,
    series: Sequence[Series],
    rig: RigPart | None,
    lever_mm: float | None,
) -> TrialsPart:
    """`trials` with the line's state at the start: another machine is wound where its base turns already.

    One that turns already is one trial whole: it may come by its first angle at any speed.
    """
    unit = unit_of(base.unit or "")
    if rig is None or rig.machine == NEEDLE or trials.at == "column":
        return trials
    s = _of_base(series, base)
    if kind_of(s.column)[0] in SUMMED:
        s = replace(s, values=summed(s.time_s, s.values))
    # a scale that is asked may be any: of the largest rate there is then a share
    size = base.scale * size_si(unit, lever_mm or USUAL_LEVER_MM) if unit is not None else 1.0
    known = np.isfinite(s.values) & np.isfinite(s.time_s)
    if known.sum() < 2:
        return trials
    rate_deg_s = abs(rest_rate_deg_s(s.time_s[known], size * s.values[known]))
    limit_deg_s = AT_REST_DEG_S
    if unit is None:
        limit_deg_s = AT_REST * math.degrees(signals.peak_rate(s.time_s, s.values))
    if rate_deg_s <= limit_deg_s:
        return trials
    return TrialsPart(at="whole", start="wound", why="the base turns already when the recording begins")
