"""Which column is the time of a table, its unit, and how the clocks of several files stand to each other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from needle_rig.importing import names, signals
from needle_rig.importing.axes import size_si
from needle_rig.importing.guess.kinds import kind_of
from needle_rig.importing.guess.series import COMMON, Series, UnitGuess, written_dimension
from needle_rig.importing.mapping import ChannelPart, ClockPart, FilePart
from needle_rig.importing.messages import STAMP
from needle_rig.importing.recording import Column, Recording
from needle_rig.importing.unit_text import known_unit, unit_of
from needle_rig.numerics import Array
from needle_rig.physics.machine import Machine

FASTEST_HZ = 200_000.0
"""Above any data logger of a needle; a millisecond taken for a second, or the reverse, is a factor 1000."""
SLOWEST_HZ = 0.5
EPOCH_S = 1e8
"""Seconds since 1970 that a clock shows which knows the date; any other counts from its start."""
SLOWEST_DEG_S = 0.2


def clock_of(
    columns: Sequence[Column], recording: Recording, table: str, files: tuple[FilePart, ...]
) -> tuple[ClockPart, Array | None, str]:
    """The clock of a table, its times in s (None when they are not known), and the column that it is."""
    stated_hz = recording.rates_hz.get(table, recording.rates_hz.get(""))
    found = [c for c in columns if not c.labels and _is_clock(c.values)]
    named = [c for c in found if names.says(c.name, names.TIME) or written_dimension(c) == "time"]
    # A header's own stamp is nearer to the sample than the recorder's.
    named.sort(key=lambda c: ("stamp" not in c.name, "recorded at" in c.name))
    column = named[0] if named else None
    if column is None and stated_hz is None:
        even = [c for c in found if is_even(c.values) and not names.says(c.name, names.OTHER)]
        # a stream writes its time first, at whatever steps
        first = [c for c in found[:1] if c is columns[0] and not names.says(c.name, names.OTHER)]
        column = next(iter((*even, *first)), None)
    if column is None:
        if stated_hz is not None:
            time_s = np.arange(len(columns[0].values)) / stated_hz
            why = f"the file says {stated_hz:g} samples a second"
            return ClockPart(files=files, rate_hz=stated_hz, why=why), time_s, ""
        doubt = "no column counts up as a time does, and the file says no rate; write rate_hz"
        return ClockPart(files=files, doubt=doubt), None, ""
    unit = _time_unit(column, stated_hz, bool(named))
    part = ClockPart(
        files=files,
        source=column.name,
        unit=None if unit.unit is None else unit.unit.text,
        why=unit.why,
        doubt=unit.doubt,
    )
    if unit.unit is None:
        return part, None, column.name
    return part, column.values * unit.unit.si, column.name


def _is_clock(values: Array) -> bool:
    known = values[np.isfinite(values)]
    steps = np.diff(known)
    return len(known) >= 10 and bool(np.mean(steps >= 0) > 0.999) and bool(np.mean(steps > 0) > 0.5)


def is_even(values: Array) -> bool:
    """Whether a column counts up by equal steps."""
    steps = np.diff(values[np.isfinite(values)])
    usual = float(np.median(steps)) if len(steps) else 0.0
    return usual > 0 and bool(np.mean(np.abs(steps - usual) < 0.2 * usual) > 0.9)


def _time_unit(column: Column, stated_hz: float | None, named: bool) -> UnitGuess:
    values = column.values[np.isfinite(column.values)]
    step = float(np.median(np.diff(values)))
    if step <= 0:
        step = float(np.ptp(values)) / (len(values) - 1)
    written = unit_of(column.unit)
    if written is not None and written.dimension == "time":
        rate = 1.0 / (step * written.si)
        if SLOWEST_HZ <= rate <= FASTEST_HZ and (stated_hz is None or 0.5 < stated_hz / rate < 2.0):
            return UnitGuess(written, f"unit {column.unit!r}; {rate:.4g} samples a second")
        other = stated_hz or 0.0
        fit = [u for u in ("s", "ms", "µs", "ns") if _sane_rate(1.0 / (step * known_unit(u).si), other)]
        what = (
            f"the header says {stated_hz:g} Hz"
            if stated_hz and not 0.5 < stated_hz / rate < 2.0
            else "no logger does that"
        )
        return UnitGuess(
            written,
            f"{column.name}: steps of {step:g}",
            f"its unit is written as {column.unit}, which makes {rate:.4g} samples a second; {what}"
            + (f"; {fit[0]} would do" if fit else ""),
        )
    if column.unit and written is None:
        return UnitGuess(None, "", f"its unit {column.unit[:30]!r} is not known; write it as `unit`, as ms")
    if stated_hz is not None:
        fit = [u for u in ("s", "ms", "µs", "ns") if abs(math.log(stated_hz * step * known_unit(u).si)) < 0.1]
        if fit:
            return UnitGuess(
                known_unit(fit[0]), f"steps of {step:g} at {stated_hz:g} samples a second, as the file says"
            )
    if np.median(values) > EPOCH_S:
        power = round(math.log10(float(np.median(values)) / 1.7e9) / 3)
        if power in (0, 1, 2, 3):
            unit = known_unit(("s", "ms", "µs", "ns")[power])
            return UnitGuess(unit, f"counts {unit.text} since 1970")
    candidates = [u for u in ("s", "ms", "µs", "ns") if 5.0 <= 1.0 / (step * known_unit(u).si) <= 20_000.0]
    whole = bool(np.all(values[:1000] == np.round(values[:1000])))
    if len(candidates) == 1 and named and not (whole and abs(step - 1.0) < 1e-9):
        return UnitGuess(
            known_unit(candidates[0]),
            f"steps of {step:g}: {1 / (step * known_unit(candidates[0]).si):.4g} samples a second",
        )
    if whole and abs(step - 1.0) < 1e-9:
        return UnitGuess(None, "", f"{column.name} counts rows or milliseconds; write rate_hz, or its unit")
    taken = known_unit(candidates[0]) if candidates else None
    return UnitGuess(
        taken,
        f"{column.name} counts up in steps of {step:g}",
        f"the unit of time is not written; {' or '.join(candidates) or 'none known'} would do",
    )


def _sane_rate(rate_hz: float, stated_hz: float) -> bool:
    return 0.5 < stated_hz / rate_hz < 2.0 if stated_hz else 5.0 <= rate_hz <= 20_000.0


def on_one_clock(
    clocks: dict[str, ClockPart], series: Sequence[Series]
) -> tuple[dict[str, ClockPart], list[Series]]:
    """Clocks brought onto that of the fastest one with an angle, each with its reason; and the series on it.

    Only the offset of the first recording is found; of several, each further one is doubted.
    """
    angles = [s for s in series if s.span > 0 and kind_of(s.column)[0] in ("angle", "")]
    if len(clocks) < 2 or not angles:
        return clocks, list(series)
    lead = max(angles, key=lambda s: (names.is_base(s.column.name), len(s.column.values)))
    result, moved = dict(clocks), []
    shifts = dict.fromkeys(clocks, 0.0)
    for name, part in clocks.items():
        own = [s for s in series if s.clock == name and s.span > 0]
        if name == lead.clock or not own:
            continue
        if min(float(np.nanmedian(s.time_s)) for s in (lead, own[0])) > EPOCH_S:
            result[name] = part.model_copy(update={"why": f"{part.why}; both clocks count from 1970"})
            continue
        if _of_one_recorder(part, clocks[lead.clock]):
            result[name] = part.model_copy(update={"why": f"{part.why}; both are the recorder's clock"})
            continue
        on_lead = [s for s in series if s.clock == lead.clock and s.span > 0]
        pairs = []
        for a in on_lead:
            for b in own:
                offset, match = signals.clock_offset_s(a.time_s, np.abs(_rate(a)), b.time_s, np.abs(_rate(b)))
                slow, fast = (b, a) if len(a.values) > len(b.values) else (a, b)
                step = float(np.median(np.diff(slow.time_s)))
                turn = -1.0 if slow is b else 1.0
                near, left = signals.refined_offset_s(
                    slow.time_s, slow.values, fast.time_s, fast.values, turn * offset, step
                )
                offset = turn * near
                pairs.append((left, -match, offset, a.column.name, b.column.name))
        left, match, offset, a_name, b_name = min(pairs)
        if left < COMMON:
            doubt, how = "", f"{b_name} is {a_name}, {left:.1%} apart"
        else:
            _, match, offset, a_name, b_name = min(pairs, key=lambda p: p[1])
            how = f"{b_name} moves as {a_name} (correlation {-match:.2f})"
            doubt = f"no quantity is in both files; offset_s {offset:+.3f} has the needle's own lag in it"
        if len(part.files) > 1:
            doubt = doubt or "offset_s was found for the first file alone; write that of the others"
        files = (part.files[0].model_copy(update={"offset_s": round(offset, 4)}), *part.files[1:])
        shifts[name] = offset
        result[name] = part.model_copy(
            update={
                "files": files,
                "why": f"{part.why}; {how} at {offset:+.3f} s",
                "doubt": "; ".join(filter(None, (part.doubt, doubt))),
            }
        )
    for s in series:
        moved.append(Series(s.column, s.clock, s.time_s + shifts[s.clock], s.values))
    return result, moved


def _of_one_recorder(one: ClockPart, other: ClockPart) -> bool:
    """Whether two tables of one file have the times at which one recorder received them."""
    same = [f.path for f in one.files] == [f.path for f in other.files]
    return same and all((clock.source or "").endswith(STAMP) for clock in (one, other))


def _rate(s: Series) -> Array:
    known = np.isfinite(s.values)
    filled = np.interp(s.time_s, s.time_s[known], s.values[known])
    return np.asarray(np.gradient(_smooth_same(filled), s.time_s))


def _smooth_same(values: Array) -> Array:
    kernel = np.ones(5) / 5
    padded = np.concatenate((np.full(2, values[0]), values, np.full(2, values[-1])))
    return np.asarray(np.convolve(padded, kernel, mode="valid"))


def doubt_speed(
    clocks: dict[str, ClockPart],
    channels: Sequence[ChannelPart],
    series: Sequence[Series],
    machine: Machine,
    lever_mm: float | None,
) -> dict[str, ClockPart]:
    """A doubt on the base's clock when the base then turns too slowly or too fast for the machine."""
    base = channels[0]
    part = clocks[base.clock]
    s = next(x for x in series if x.clock == base.clock and x.column.name == base.source)
    if base.unit is None or part.doubt or (part.unit is None and part.rate_hz is None):
        return clocks
    rate = signals.peak_rate(s.time_s, s.values) * math.degrees(size_si(known_unit(base.unit), lever_mm))
    if not math.isfinite(rate) or SLOWEST_DEG_S <= rate <= machine.fastest_deg_s:
        return clocks
    doubt = f"the base would turn at {rate:.3g}°/s; is the unit of time right?"
    return {**clocks, base.clock: part.model_copy(update={"doubt": doubt})}
