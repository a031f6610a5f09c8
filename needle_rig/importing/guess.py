"""A mapping proposed from recordings: every line with its reason, and with its doubt where there is one."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from needle_rig.config.places import show_path
from needle_rig.dataset.description import RigPart, needle_of
from needle_rig.dataset.table import MAX_SAMPLES
from needle_rig.errors import BadInput
from needle_rig.importing import names, signals
from needle_rig.importing.mapping import BASE, TORQUE, ChannelPart, ClockPart, FilePart, Mapping, TrialsPart
from needle_rig.importing.recording import Column, Recording
from needle_rig.importing.unit_text import UNITS, Unit, unit_of
from needle_rig.numerics import Array

TORQUE_UNITS = ("N·m", "N·cm", "N·mm", "µN·m")
"""What torques of needles are written in."""
UNIT_WITHIN = 5.0
"""Factor to the torque that is asked for beyond which a written unit is doubted; N·cm for N·mm makes ten."""
LEAST_TWIST_RAD = math.radians(2.0)
"""Below it the sensors' noise is the twist."""
FIRST_DEG = 5.0
"""Of the base's first motion, before friction lets much of the shaft slip."""
FASTEST_HZ = 200_000.0
"""Above any data logger of a needle; a millisecond taken for a second, or the reverse, is a factor 1000."""
SLOWEST_HZ = 0.5
FASTEST_DEG_S = 1500.0
"""250 rpm: ten times what needle drives do."""
SLOWEST_DEG_S = 0.2
LARGEST_DEG = 1800.0
SMALLEST_DEG = 3.0
"""A base that turns less winds nothing up that a model could be held against."""
LEAST_FOLLOWED, MOST_FOLLOWED = 0.02, 1.3
"""Share of the base's travel that a sensor on the needle sees; above 1 by noise and overshoot alone."""
CLEAR_LAG = 0.004
"""Of the product of travels: two records of one angle with 0.25° of noise differ by 0.002, the angles of the
practice needles come 0.13 and more after their base (test_thresholds)."""
CLEAR_WORK = 0.15
"""Share of the work: noise alone gives some 1.8/√samples, the practice needles 0.23 and more."""
ROUND = 0.75
"""Share of levels at multiples of 5°; two of two at random are one in 150."""
LEAST_RADIANS = 0.6
"""A range without unit that is below it can be radians or turns: 34° or 216°."""
COMMON = 0.01
"""Of its span: what differs between two records of one quantity; a practice needle's loop leaves 0.09."""
WEAK = 0.4
"""Correlation of an angle with the base below which its sign is asked; noise has some 1/√samples."""
LARGEST_NUMBER = 1e30
"""In any unit; above it a bit is wrong, and its square overflows."""
EPOCH_S = 1e8
"""Seconds since 1970 that a clock shows which knows the date; any other counts from its start."""


@dataclass(frozen=True)
class _Series:
    """A column of a file on its clock in seconds, thinned to what is looked at."""

    column: Column
    clock: str
    time_s: Array
    values: Array

    @property
    def span(self) -> float:
        known = self.values[np.isfinite(self.values)]
        return float(np.ptp(known)) if len(known) else 0.0


@dataclass(frozen=True)
class _Unit:
    """A unit found for a column; None where it cannot be told."""

    unit: Unit | None
    why: str
    doubt: str = ""


def guess(recordings: Sequence[Recording], name: str, rig: RigPart | None, folder: Path) -> Mapping:
    """The mapping of `recordings`: files with the same columns are one recording after the other.

    `rig` says what the shaft looks like, where it is known; paths are written relative to `folder`. Raises
    BadInput when there is nothing that could be the base's angle.
    """
    kinds: dict[tuple[tuple[str, str], ...], list[Recording]] = {}
    for recording in recordings:
        kinds.setdefault(tuple((c.table, c.name) for c in recording.columns), []).append(recording)
    clocks: dict[str, ClockPart] = {}
    series: list[_Series] = []
    not_used: list[str] = []
    for files in kinds.values():
        first = files[0]
        parts = tuple(FilePart(path=_relative(r.path, folder), sha256=r.sha256) for r in files)
        for table, columns in first.tables().items():
            label = _label(first.path, table, clocks, len(first.tables()) > 1)
            part, time_s, source = _clock(columns, first, table, parts)
            clocks[label] = part
            if time_s is None:
                time_s = np.arange(len(columns[0].values), dtype=np.float64)
            every = max(1, len(time_s) // signals.LOOKED_AT)
            for column in columns:
                if column.name == source:
                    continue
                if column.labels or names.says(column.name, names.TIME):
                    not_used.append(column.name)
                    continue
                seen = column.values[::every]
                seen = np.where(np.abs(seen) < LARGEST_NUMBER, seen, math.nan)
                series.append(_Series(column, label, time_s[::every], seen))
    if len({len(c.files) for c in clocks.values()}) > 1:
        told = "; ".join(f"{k}: {len(c.files)}" for k, c in clocks.items())
        raise BadInput(
            f"files of different kinds do not pair ({told}); import the recordings one by one, "
            "each with the files of its own"
        )
    trials, series, more = _trials(series)
    clocks, series = _on_one_clock(clocks, series)
    channels, unused = _channels(series, rig, recordings)
    used = {(c.clock, c.source) for c in channels}
    clocks = {k: v for k, v in clocks.items() if any(c.clock == k for c in channels)}
    clocks = _sane_clocks(clocks, channels, series)
    not_used += [s.column.name for s in series if (s.clock, s.column.name) not in used] + more
    return Mapping(
        name=name,
        clocks=clocks,
        channels=tuple(channels),
        trials=trials,
        rate_hz=_rate_hz(series, channels),
        not_used=tuple(dict.fromkeys([*unused, *not_used])),
        rig=rig,
    )


def _relative(path: Path, folder: Path) -> str:

    return os.path.relpath(path, folder)


def _label(path: Path, table: str, taken: dict[str, ClockPart], several: bool) -> str:
    stem = path.name.split(".")[0] or "clock"
    label = f"{stem}/{table}" if several and table else stem
    label = label.replace(" ", "_")
    number = 2
    while label in taken:
        label, number = f"{label}_{number}", number + 1
    return label


# ── clocks ──


def _clock(
    columns: Sequence[Column], recording: Recording, table: str, files: tuple[FilePart, ...]
) -> tuple[ClockPart, Array | None, str]:
    """The clock of a table, its times in s (None when they are not known), and the column that it is."""
    told_hz = recording.rates_hz.get(table, recording.rates_hz.get(""))
    found = [c for c in columns if not c.labels and _is_clock(c.values)]
    named = [c for c in found if names.says(c.name, names.TIME) or _dimension(c) == "time"]
    # A header's own stamp is nearer to the sample than the recorder's.
    named.sort(key=lambda c: ("stamp" not in c.name, "recorded at" in c.name))
    column = named[0] if named else None
    if column is None and told_hz is None:
        even = [c for c in found if _is_even(c.values) and not names.says(c.name, names.OTHER)]
        column = even[0] if even else None
    if column is None:
        if told_hz is not None:
            time_s = np.arange(len(columns[0].values)) / told_hz
            why = f"the file says {told_hz:g} samples a second"
            return ClockPart(files=files, rate_hz=told_hz, why=why), time_s, ""
        doubt = "no column counts up as a time does, and the file says no rate; write rate_hz"
        return ClockPart(files=files, doubt=doubt), None, ""
    unit = _time_unit(column, told_hz, bool(named))
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


def _is_even(values: Array) -> bool:
    steps = np.diff(values[np.isfinite(values)])
    usual = float(np.median(steps))
    return usual > 0 and bool(np.mean(np.abs(steps - usual) < 0.2 * usual) > 0.9)


def _dimension(column: Column) -> str:
    unit = unit_of(column.unit)
    return "" if unit is None else unit.dimension


def _time_unit(column: Column, told_hz: float | None, named: bool) -> _Unit:
    values = column.values[np.isfinite(column.values)]
    step = float(np.median(np.diff(values)))
    if step <= 0:
        step = float(np.ptp(values)) / (len(values) - 1)
    written = unit_of(column.unit)
    if written is not None and written.dimension == "time":
        rate = 1.0 / (step * written.si)
        if SLOWEST_HZ <= rate <= FASTEST_HZ and (told_hz is None or 0.5 < told_hz / rate < 2.0):
            return _Unit(written, f"unit {column.unit!r}; {rate:.4g} samples a second")
        other = told_hz or 0.0
        fit = [u for u in ("s", "ms", "µs", "ns") if _sane_rate(1.0 / (step * UNITS[u].si), other)]
        meant = UNITS[fit[0]] if fit else None
        what = (
            f"the header says {told_hz:g} Hz"
            if told_hz and not 0.5 < told_hz / rate < 2.0
            else "no logger does that"
        )
        return _Unit(
            meant,
            f"{column.name}: steps of {step:g}",
            f"its unit is written as {column.unit}, which makes {rate:.4g} samples a second; {what}"
            + (f"; taken as {meant.text}" if meant else ""),
        )
    if told_hz is not None:
        fit = [u for u in ("s", "ms", "µs", "ns") if abs(math.log(told_hz * step * UNITS[u].si)) < 0.1]
        if fit:
            return _Unit(
                UNITS[fit[0]], f"steps of {step:g} at {told_hz:g} samples a second, as the file says"
            )
    if np.median(values) > EPOCH_S:
        power = round(math.log10(float(np.median(values)) / 1.7e9) / 3)
        if power in (0, 1, 2, 3):
            unit = UNITS[("s", "ms", "µs", "ns")[power]]
            return _Unit(unit, f"counts {unit.text} since 1970")
    candidates = [u for u in ("s", "ms", "µs", "ns") if 5.0 <= 1.0 / (step * UNITS[u].si) <= 20_000.0]
    whole = bool(np.all(values[:1000] == np.round(values[:1000])))
    if len(candidates) == 1 and named and not (whole and abs(step - 1.0) < 1e-9):
        return _Unit(
            UNITS[candidates[0]],
            f"steps of {step:g}: {1 / (step * UNITS[candidates[0]].si):.4g} samples a second",
        )
    if whole and abs(step - 1.0) < 1e-9:
        return _Unit(None, "", f"{column.name} counts rows or milliseconds; write rate_hz, or its unit")
    taken = UNITS[candidates[0]] if candidates else None
    return _Unit(
        taken,
        f"{column.name} counts up in steps of {step:g}",
        f"the unit of time is not written; {' or '.join(candidates) or 'none known'} would do",
    )


def _sane_rate(rate_hz: float, told_hz: float) -> bool:
    return 0.5 < told_hz / rate_hz < 2.0 if told_hz else 5.0 <= rate_hz <= 20_000.0


# ── channels ──


def _channels(
    series: Sequence[_Series], rig: RigPart | None, recordings: Sequence[Recording]
) -> tuple[list[ChannelPart], list[str]]:
    live = [s for s in series if s.span > 0.0 and np.isfinite(s.values).sum() >= 10]
    dead = [s.column.name for s in series if s not in live]
    angles: list[_Series] = []
    torques: list[_Series] = []
    loose: list[_Series] = []
    for s in live:
        kind = _kind(s)
        (angles if kind == "angle" else torques if kind == "torque" else loose if kind == "" else []).append(
            s
        )
    if not angles and not loose:
        raise BadInput(
            f"{', '.join(show_path(r.path) for r in recordings)}: no column can be the base's angle "
            f"(columns: {', '.join(s.column.name for s in series)[:300]}); write a mapping by hand"
        )
    base, base_why, base_doubt = _base(angles or loose, loose if angles else [])
    rest = [s for s in (angles or loose) if s is not base]
    if not angles:
        rest, torques = _split_loose(base, rest, torques)
    sensors = [s for s in rest if _seen_on_needle(base, s) and not _is_copy(base, s)]
    unit = _base_unit(base, sensors)
    channels = [
        ChannelPart(
            role=BASE,
            clock=base.clock,
            source=base.column.name,
            unit=None if unit.unit is None else unit.unit.text,
            zero="start",
            why="; ".join(filter(None, (base_why, unit.why))),
            doubt="; ".join(filter(None, (base_doubt, unit.doubt))),
        )
    ]
    roles = _places(sensors, base, rig)
    base_si = None if unit.unit is None else _at_start(base) * unit.unit.si
    for s, (role, why, doubt) in zip(sensors, roles, strict=True):
        if role is not None:
            channels.append(_sensor(s, role, base, base_si, why, doubt))
    torque = _torque(base, torques or ([] if angles else loose), bool(torques))
    if torque is not None and torque not in sensors:
        channels.append(_torque_channel(torque, torques, base, base_si, sensors, channels, rig))
    return channels, dead


def _kind(s: _Series) -> str:
    """angle, torque, other, or nothing where neither name nor unit says it."""
    dimension, name = _dimension(s.column), s.column.name
    if names.says(name, names.COMMAND):
        return "other"
    if dimension in ("angle", "torque"):
        return dimension
    if s.column.unit.lower() in ("counts", "count", "cts", "v", "mv", "volt", "volts"):
        if names.says(name, names.TORQUE):
            return "torque"
        return "angle" if names.says(name, names.ANGLE) or names.says(name, names.BASE) else "other"
    if dimension in ("other", "time") or s.column.unit:
        return "other"
    if names.says(name, names.TORQUE):
        return "torque"
    if names.says(name, names.OTHER):
        return "other"
    if any(names.says(name, p) for p in (names.ANGLE, names.BASE, names.SENSOR)):
        return "angle"
    return ""


def _base(angles: Sequence[_Series], loose: Sequence[_Series]) -> tuple[_Series, str, str]:
    """The base among the angles: by name, and by what comes first. Why, and what speaks against it."""
    named: list[_Series] = []
    for s in sorted(angles, key=lambda s: -len(s.column.values)):
        if names.is_base(s.column.name) and not any(
            _is_copy(kept, s) for kept in named if kept.clock != s.clock
        ):
            named.append(s)
    leads = sorted(angles, key=lambda s: _leads(s, angles), reverse=True)
    first = leads[0]
    others = [s for s in angles if s is not first]
    clear = bool(others) and all(_lag(first, s) > CLEAR_LAG for s in others)
    if len(named) == 1 or (named and first not in named):
        base = named[0]
        late = [s.column.name for s in angles if s is not base and _lag(base, s) < -CLEAR_LAG]
        doubt = (
            f"{late[0]} moves before it, which no needle does; are the columns or the clocks swapped?"
            if late
            else ""
        )
        lagging = sum(1 for s in angles if s is not base and _lag(base, s) > CLEAR_LAG)
        extra = f"; {lagging} of {len(angles) - 1} other angles come after it" if lagging else ""
        return base, f"name{extra}", doubt
    if len(named) > 1:
        same = [
            s for s in named if s is not first and abs(_lag(first, s)) < CLEAR_LAG and _ratio(first, s) > 0.98
        ]
        doubt = (
            ""
            if first in named and (clear or len(angles) > len(named)) and not same
            else (
                f"{', '.join(s.column.name for s in named)} could each be the base; keep what is mounted at "
                "it"
            )
        )
        return first, "name; all other angles come after it" if clear else "name", doubt
    if len(angles) == 1 and not loose and names.says(first.column.name, names.SENSOR):
        return (
            first,
            "the only angle",
            "its name is that of a sensor on the needle; is it the base's encoder?",
        )
    if len(angles) == 1 and _dimension(first.column) == "angle":
        return first, "the only angle", ""
    if clear:
        plain = all(_dimension(s.column) == "angle" or names.says(s.column.name, names.ANGLE) for s in angles)
        return first, "all other angles come after it", "" if plain else "no name says so"
    if all(names.says(s.column.name, names.SENSOR) for s in others) and not names.says(
        first.column.name, names.SENSOR
    ):
        return first, "the only angle that is not called a sensor's", ""
    return first, "the widest motion", "no name says so, and none of the angles clearly comes first"


def _leads(s: _Series, angles: Sequence[_Series]) -> float:
    lags = [_lag(s, other) for other in angles if other is not s]
    return min(lags) if lags else 0.0


def _on(s: _Series, other: _Series) -> Array:
    """`other` at the times of `s`, NaN outside of its own."""
    if s.clock == other.clock and len(s.values) == len(other.values):
        return other.values
    known = np.isfinite(other.values)
    return np.interp(s.time_s, other.time_s[known], other.values[known], left=math.nan, right=math.nan)


def _lag(leader: _Series, follower: _Series) -> float:
    """How far an angle comes after another; 0 on different clocks, where it is a question of the clocks."""
    if leader.clock != follower.clock:
        return 0.0
    every = max(1, len(leader.values) // 4000)
    return signals.lag_share(_smooth(leader.values)[::every], _smooth(follower.values)[::every])


def _smooth(values: Array) -> Array:
    width = max(1, min(len(values) // 400, 25))
    known = np.isfinite(values)
    if not known.all():
        values = np.interp(np.arange(len(values)), np.flatnonzero(known), values[known])
    if width == 1:
        return values
    total = np.cumsum(np.concatenate(([0.0], values)))
    return np.asarray((total[width:] - total[:-width]) / width)


def _ratio(a: _Series, b: _Series) -> float:
    return b.span / a.span if a.span else 0.0


def _seen_on_needle(base: _Series, s: _Series) -> bool:
    return abs(signals.follow_sign(base.values, _on(base, s))) > 0.3


def _is_copy(base: _Series, s: _Series) -> bool:
    """Whether a column is the base's angle once more."""
    left = signals.difference_share(s.time_s, s.values, base.time_s, base.values)
    return left < COMMON and (s.clock != base.clock or names.is_base(s.column.name))


def _split_loose(
    base: _Series, rest: Sequence[_Series], torques: list[_Series]
) -> tuple[list[_Series], list[_Series]]:
    """Columns without name and unit: a torque is what relaxes and reverses while angles stay."""
    angles: list[_Series] = []
    for s in rest:
        follows = abs(signals.follow_sign(base.values, _on(base, s)))
        (angles if follows > 0.85 else torques).append(s)
    return angles, torques


def _at_start(s: _Series) -> Array:
    return signals.from_rest(s.values, signals.rest_before_motion(s.values))


# ── units of angles ──


def _base_unit(base: _Series, sensors: Sequence[_Series]) -> _Unit:
    written = unit_of(base.column.unit)
    if written is not None and written.dimension == "other":
        return _Unit(None, "", f"its unit is {base.column.unit}; write unit: turn and scale: 1/counts a turn")
    known = np.isfinite(base.values)
    at = signals.levels(base.time_s[known], base.values[known])
    rate = signals.peak_rate(base.time_s, base.values)
    peak = float(np.nanmax(np.abs(_at_start(base))))
    fitting, round_share = [], {}
    for text in ("deg", "rad", "turn"):
        degrees = math.degrees(UNITS[text].si)
        round_share[text] = signals.roundness(at * degrees)
        if SMALLEST_DEG <= peak * degrees <= LARGEST_DEG and rate * degrees <= FASTEST_DEG_S:
            fitting.append(text)
    rounds = [u for u in fitting if round_share[u] >= ROUND]
    # Turns are written as such, or are seen by their round degrees; as a range alone they are a radian's.
    if "turn" in fitting and "turn" not in rounds and peak > LEAST_RADIANS:
        fitting.remove("turn")
    if written is not None and written.dimension == "angle":
        degrees = math.degrees(written.si)
        better = [u for u in rounds if u != written.text]
        if not (1.0 <= peak * degrees <= 2 * LARGEST_DEG) or rate * degrees > FASTEST_DEG_S:
            likely = next(iter(rounds or fitting), None)
            return _Unit(
                UNITS[likely] if likely else None,
                f"unit {base.column.unit!r}",
                f"in {written.text} it would reach {peak * degrees:.4g}° at {rate * degrees:.3g}°/s"
                + (f"; taken as {likely}" if likely else ""),
            )
        if better and signals.roundness(at * degrees) < 0.5:
            return _Unit(
                UNITS[better[0]],
                f"unit {base.column.unit!r}",
                f"it rests at multiples of 5° when read as {better[0]} and not as {written.text}; "
                f"taken as {better[0]}",
            )
        return _Unit(written, f"unit {base.column.unit!r}, up to {peak * degrees:.3g}°")
    ratios = [
        (unit_of(s.column.unit), _ratio(base, s))
        for s in sensors
        if _dimension(s.column) == "angle" and base.span
    ]
    for unit, ratio in ratios:
        assert unit is not None
        fit = [u for u in fitting if 0.1 < ratio * unit.si / UNITS[u].si < MOST_FOLLOWED]
        if len(fit) == 1:
            return _Unit(UNITS[fit[0]], f"the angles in {unit.text} follow it when it is in {fit[0]}")
    if len(rounds) == 1 and (len(at) > 1 or len(fitting) == 1):
        degrees = math.degrees(UNITS[rounds[0]].si)
        return _Unit(
            UNITS[rounds[0]],
            f"it rests or turns at multiples of 5° when read as {rounds[0]}: {_told(at * degrees)}",
        )
    if len(fitting) == 1:
        reach = peak * math.degrees(UNITS[fitting[0]].si)
        return _Unit(UNITS[fitting[0]], f"its range: {reach:.3g}° as {fitting[0]}, no other unit would do")
    if rounds:
        return _Unit(UNITS[rounds[0]], "", f"the unit is not written; {' or '.join(fitting)} would do")
    return _Unit(None, "", f"the unit is not written; {' or '.join(fitting) or 'none known'} would do")


def _told(degrees: Array) -> str:
    return ", ".join(f"{d:.3g}°" for d in degrees[:4])


def _sensor(s: _Series, role: str, base: _Series, base_si: Array | None, why: str, doubt: str) -> ChannelPart:
    values = _on(base, s)
    follow = signals.follow_sign(base.values, values)
    sign: Literal[1, -1] = 1 if follow >= 0 else -1
    unit = _sensor_unit(s, base_si)
    turned = "" if sign > 0 else "it falls while the base rises"
    weak = f"it follows the base weakly (correlation {follow:.2f})" if abs(follow) < WEAK else ""
    if sign > 0 and not weak:
        turned = "it turns with the base"
    return ChannelPart(
        role=role,
        clock=s.clock,
        source=s.column.name,
        unit=None if unit.unit is None else unit.unit.text,
        sign=sign,
        zero="start",
        why="; ".join(filter(None, (why, unit.why, turned))),
        doubt="; ".join(filter(None, (doubt, unit.doubt, weak))),
    )


def _sensor_unit(s: _Series, base_si: Array | None) -> _Unit:
    written = unit_of(s.column.unit)
    if base_si is None:
        angle = written if written is not None and written.dimension == "angle" else None
        return _Unit(
            angle, f"unit {s.column.unit!r}" if angle else "", "" if angle else "its unit is not known"
        )
    travel = float(np.nanmax(base_si) - np.nanmin(base_si))
    share = {u: s.span * UNITS[u].si / travel for u in ("deg", "rad", "turn")}
    fit = [u for u, part in share.items() if LEAST_FOLLOWED <= part <= MOST_FOLLOWED]
    if written is not None and written.dimension == "angle":
        part = s.span * written.si / travel
        if LEAST_FOLLOWED <= part <= MOST_FOLLOWED:
            return _Unit(written, f"unit {s.column.unit!r}, {part:.0%} of the base's motion")
        likely = fit[0] if fit else None
        return _Unit(
            UNITS[likely] if likely else None,
            f"unit {s.column.unit!r}",
            f"in {written.text} it would turn {part:.3g} times as far as the base"
            + (f"; taken as {likely}" if likely else ""),
        )
    if written is not None or s.column.unit:
        return _Unit(None, "", f"its unit is {s.column.unit}; write `unit` and `scale`")
    strong = [u for u in fit if share[u] > 0.1]
    if len(strong) == 1:
        return _Unit(UNITS[strong[0]], f"{share[strong[0]]:.0%} of the base's motion as {strong[0]}")
    taken = next(iter(strong or fit), None)
    return _Unit(
        UNITS[taken] if taken else None, "", "the unit is not written, and its motion does not tell it"
    )


def _places(sensors: list[_Series], base: _Series, rig: RigPart | None) -> list[tuple[str | None, str, str]]:
    """Role, reason and doubt of each angle on the needle; no role for one that the layout has no sensor for.

    Puts `sensors` in the order along the shaft that their names say, or else their lag behind the base.
    """
    numbered = all(names.numbers_in(s.column.name) for s in sensors)
    by_lag = sorted(sensors, key=lambda s: _lag(base, s))
    if numbered:
        sensors.sort(key=lambda s: (names.numbers_in(s.column.name), s.column.name))
    elif len(sensors) > 1:
        sensors[:] = by_lag
    against = numbered and any(
        _lag(sensors[k + 1], sensors[k]) > CLEAR_LAG and sensors[k].clock == sensors[k + 1].clock
        for k in range(len(sensors) - 1)
    )
    order = "number in its name" if numbered else "its lag behind the base"
    if len(sensors) == 1:
        order = "the only angle on the needle"
    doubt = (
        "the sensors' numbers do not run from the base to the tip: what has the higher number moves first"
        if against
        else ""
    )
    if rig is None:
        return [(f"angle_{k + 1}", order, doubt) for k in range(len(sensors))]
    known = [s.name for s in sorted(rig.hall_sensors, key=lambda p: p.position_mm)]
    same = {s.column.name: n for s in sensors for n in known if names.plain(s.column.name) == names.plain(n)}
    if len(same) == len(sensors):
        return [(same[s.column.name], "name", doubt) for s in sensors]
    if len(sensors) == len(known):
        return [(n, order, doubt) for n in known]
    if not known:
        return [(None, "", "") for _ in sensors]
    few = f"the layout has {len(known)} sensors, the recording {len(sensors)} angles; say which is which"
    return [(known[k] if k < len(known) else None, order, few) for k in range(len(sensors))]


# ── torque ──


def _torque(base: _Series, torques: Sequence[_Series], named: bool) -> _Series | None:
    if not torques:
        return None
    if len(torques) == 1:
        return torques[0]
    best = [s for s in torques if names.says(s.column.name, names.BASE)]
    if len(best) == 1:
        return best[0]
    return max(
        torques, key=lambda s: abs(signals.work_share(_at_start(base), _zeroed(base, s))) if named else s.span
    )


def _zeroed(base: _Series, s: _Series) -> Array:
    return signals.from_rest(_on(base, s), signals.rest_before_motion(base.values))


def _torque_channel(
    s: _Series,
    torques: Sequence[_Series],
    base: _Series,
    base_si: Array | None,
    sensors: Sequence[_Series],
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> ChannelPart:
    work = signals.work_share(_at_start(base), _zeroed(base, s))
    doubts = []
    if abs(work) < CLEAR_WORK:
        doubts.append(
            f"torque and angle agree in sign for {50 + 50 * work:.0f} % of the work; check the sign"
        )
    named = names.says(s.column.name, names.TORQUE) or _dimension(s.column) == "torque"
    if not named:
        doubts.append("neither name nor unit says that it is a torque")
    if len(torques) > 1 and not names.says(s.column.name, names.BASE):
        rest = ", ".join(o.column.name for o in torques if o is not s)
        doubts.append(f"{rest} could be it as well")
    unit = _torque_unit(s, base_si, sensors, base, channels, rig)
    if unit.doubt:
        doubts.append(unit.doubt)
    way = "it rises" if work > 0 else "it falls, so its sign is turned:"
    agreed = (
        f"{way} while the base winds up ({abs(work):.0%} of the work)"
        if work > 0
        else (f"it falls while the base winds up ({abs(work):.0%} of the work), so its sign is turned")
    )
    return ChannelPart(
        role=TORQUE,
        clock=s.clock,
        source=s.column.name,
        unit=None if unit.unit is None else unit.unit.text,
        sign=1 if work >= 0 else -1,
        zero="start",
        why="; ".join(filter(None, ("name" if named else "", unit.why, agreed))),
        doubt="; ".join(doubts),
    )


def expected_torque_nm(twist_rad: float, position_m: float, rigidity_nm2: float) -> float:
    """GJ · twist / length: what a shaft free up to `position_m` asks for."""
    return twist_rad * rigidity_nm2 / position_m


def _stiffness_unit(s: _Series, written: Unit, base: _Series, base_si: Array, rig: RigPart) -> _Unit | None:
    """A doubt on a written unit when the torque first rises as no shaft of this length does, else None."""
    rigidity = needle_of(rig.needle).torsional_rigidity_nm2
    slope = signals.first_stiffness(base_si, _zeroed(base, s), math.radians(FIRST_DEG))
    least, most = rigidity / (rig.needle_length_mm * 1e-3), math.inf
    if rig.tissue_sections_mm and rig.tissue_sections_mm[0][0] > 0:
        most = rigidity / (rig.tissue_sections_mm[0][0] * 1e-3)
    if slope == 0.0 or least / UNIT_WITHIN <= slope * written.si <= most * UNIT_WITHIN:
        return None
    fit = [u for u in TORQUE_UNITS if least / 2 < slope * UNITS[u].si < most * 2]
    meant = UNITS[fit[0]] if fit else None
    return _Unit(
        meant,
        f"unit {s.column.unit!r}",
        f"in {written.text} it first rises by {slope * written.si * 1e3:.2g} N·mm/rad where the shaft has "
        f"{least * 1e3:.2g} to {most * 1e3:.2g}" + (f"; taken as {meant.text}" if meant else ""),
    )


def _torque_unit(
    s: _Series,
    base_si: Array | None,
    sensors: Sequence[_Series],
    base: _Series,
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> _Unit:
    written = unit_of(s.column.unit)
    if written is not None and written.dimension == "other":
        return _Unit(None, "", f"its unit is {s.column.unit}; write `unit` and `scale` of its calibration")
    expected = _of_twist(base_si, sensors, base, channels, rig)
    if written is not None and written.dimension == "torque":
        why = f"unit {s.column.unit!r}"
        if expected is None:
            doubted = None
            if rig is not None and base_si is not None:
                doubted = _stiffness_unit(s, written, base, base_si, rig)
            return doubted or _Unit(written, why)
        torque_nm, how = expected
        ratio = s.span * written.si / torque_nm
        if 1 / UNIT_WITHIN < ratio < UNIT_WITHIN:
            return _Unit(written, f"{why}, {ratio:.2g} times what {how} asks for")
        fit = [u for u in TORQUE_UNITS if 1 / 3 < s.span * UNITS[u].si / torque_nm < 3]
        meant = UNITS[fit[0]] if fit else None
        doubt = f"in {written.text} it spans {ratio:.3g} times what {how} asks for"
        return _Unit(meant, why, doubt + (f"; taken as {meant.text}" if meant else ""))
    if expected is not None:
        torque_nm, how = expected
        # Neighbouring units are a factor ten apart, so no two of them fit.
        fit = [u for u in TORQUE_UNITS if 1 / 3 < s.span * UNITS[u].si / torque_nm < 3]
        if fit:
            return _Unit(UNITS[fit[0]], f"{how} asks for {torque_nm * 1e3:.2g} N·mm")
    return _Unit(None, "", "its unit is not written, and the recording cannot tell it; write `unit`")


def _of_twist(
    base_si: Array | None,
    sensors: Sequence[_Series],
    base: _Series,
    channels: Sequence[ChannelPart],
    rig: RigPart | None,
) -> tuple[float, str] | None:
    """Span of the torque that the twist up to the nearest sensor asks for, N·m, and how it is known."""
    if rig is None or base_si is None:
        return None
    places = {p.name: p.position_mm * 1e-3 for p in rig.hall_sensors if p.position_mm > 0}
    near = [c for c in channels if c.role in places and c.unit is not None]
    if not near:
        return None
    c = min(near, key=lambda c: places[c.role])
    s = next(x for x in sensors if x.clock == c.clock and x.column.name == c.source)
    unit = unit_of(c.unit or "")
    assert unit is not None
    rest = signals.rest_before_motion(base.values)
    lag = base_si - c.sign * unit.si * signals.from_rest(_on(base, s), rest)
    lag = lag[np.isfinite(lag)]
    twist = float(np.ptp(lag)) if len(lag) else 0.0
    if twist < LEAST_TWIST_RAD:
        return None
    rigidity = needle_of(rig.needle).torsional_rigidity_nm2
    return expected_torque_nm(twist, places[c.role], rigidity), f"the twist up to {c.role}"


def _trials(series: Sequence[_Series]) -> tuple[TrialsPart, list[_Series], list[str]]:
    """A column that numbers trials, or rests; with the other series and the names of the unused ones."""
    for s in series:
        known = s.column.values[np.isfinite(s.column.values)]
        changes = np.flatnonzero(np.diff(known))
        if names.TRIAL.fullmatch(names.plain(s.column.name)) and 0 < len(changes) < 500:
            part = TrialsPart(
                at="column", clock=s.clock, source=s.column.name, why=f"name; {len(changes) + 1} stretches"
            )
            return part, [x for x in series if x is not s], []
    part = TrialsPart(
        at="rests", why="cut where the base rests as it stood at the start, without torque or twist"
    )
    return part, list(series), []


def _rate_hz(series: Sequence[_Series], channels: Sequence[ChannelPart]) -> float | None:
    """Samples a second that keep a trial of the whole length below what a dataset holds; None to keep all."""
    base = channels[0]
    s = next(x for x in series if x.clock == base.clock and x.column.name == base.source)
    rows = len(s.column.values)
    if rows <= MAX_SAMPLES:
        return None
    length_s = float(s.time_s[-1] - s.time_s[0])
    if length_s <= 0:
        return None
    allowed = min(MAX_SAMPLES / length_s, rows / length_s)
    nice = [m * 10.0**e for e in range(-3, 6) for m in (1.0, 2.0, 5.0)]
    return max(r for r in nice if r <= allowed)


def _sane_clocks(
    clocks: dict[str, ClockPart], channels: Sequence[ChannelPart], series: Sequence[_Series]
) -> dict[str, ClockPart]:
    """A doubt on the base's clock when the base then turns too slowly or too fast."""
    base = channels[0]
    part = clocks[base.clock]
    s = next(x for x in series if x.clock == base.clock and x.column.name == base.source)
    if base.unit is None or part.doubt or (part.unit is None and part.rate_hz is None):
        return clocks
    rate = signals.peak_rate(s.time_s, s.values) * math.degrees(UNITS[unit_of(base.unit).text].si)  # type: ignore[union-attr]
    if SLOWEST_DEG_S <= rate <= FASTEST_DEG_S:
        return clocks
    doubt = f"the base would turn at {rate:.3g}°/s; is the unit of time right?"
    return {**clocks, base.clock: part.model_copy(update={"doubt": doubt})}


def _on_one_clock(
    clocks: dict[str, ClockPart], series: Sequence[_Series]
) -> tuple[dict[str, ClockPart], list[_Series]]:
    """Clocks brought onto that of the fastest one with an angle, each with its reason; and the series on it.

    Only the offset of the first recording is found; of several, each further one is doubted.
    """
    angles = [s for s in series if s.span > 0 and _kind(s) in ("angle", "")]
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
        moved.append(_Series(s.column, s.clock, s.time_s + shifts[s.clock], s.values))
    return result, moved


def _rate(s: _Series) -> Array:
    known = np.isfinite(s.values)
    filled = np.interp(s.time_s, s.time_s[known], s.values[known])
    return np.asarray(np.gradient(_smooth_same(filled), s.time_s))


def _smooth_same(values: Array) -> Array:
    kernel = np.ones(5) / 5
    padded = np.concatenate((np.full(2, values[0]), values, np.full(2, values[-1])))
    return np.asarray(np.convolve(padded, kernel, mode="valid"))
