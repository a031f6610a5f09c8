"""Samples of one trial to a trial: gaps masked, angles unwrapped, sensors checked, what was done said."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import numpy as np
import numpy.typing as npt

from needle_rig.dataset.base_path import denoised_base
from needle_rig.dataset.channels import stuck_runs, unwrapped
from needle_rig.dataset.records import DatasetTrial, Start, TrialCommand
from needle_rig.dataset.table import MAX_SAMPLES
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial

FEWEST_SAMPLES = 10
SLOW_SHARE = 0.5
"""Share of the rows with a reading, below which a channel was read more slowly than the others."""
LONGEST_BLIND_S = 0.25
"""Without the encoder for longer than this, and the base elsewhere afterwards, the path is unknown."""
AT_REST_DEG = 1.0
AT_REST_DEG_S = 3.0


class LeftOut(Exception):
    """Why the trial at `place`, a file and its line, cannot be used though its file can be read."""

    def __init__(self, place: str, reason: str) -> None:
        super().__init__(f"{place}: left out: {reason}")
        self.place, self.reason = place, reason


def checked_trial(
    values: Array,
    phase: npt.NDArray[np.str_],
    line: npt.NDArray[np.int64],
    sensors: tuple[str, ...],
    shown: str,
    command: TrialCommand,
    start_s: float,
    notes: list[str],
    absent: Collection[str] = (),
    start: Start = "relaxed",
) -> DatasetTrial:
    """A trial of `values` (samples, 3 + sensors): time, base angle, torque, Hall angles; SI, NaN if missing.

    One more column is the torque on the tip.
    `line` says where each sample stands in the file called `shown`; what is handled is added to `notes`,
    which say already of the channels in `absent` that they have no column. Times must not go back. Raises
    LeftOut when the trial has no use.
    """
    if len(values) > 1.05 * MAX_SAMPLES:
        every = -(-len(values) // MAX_SAMPLES)
        notes.append(f"{shown}: has {len(values):,} samples; one in {every} is used")
        values, phase, line = values[::every], phase[::every], line[::every]
    time_s = values[:, 0]
    keep = np.concatenate(([True], np.diff(time_s) > 0.0))
    if not keep.all():
        first = int(line[np.flatnonzero(~keep)[0]])
        notes.append(f"{shown}:{first}: {int((~keep).sum())} rows repeat the time before them; left out")
        values, phase, line = values[keep], phase[keep], line[keep]
    if len(values) < FEWEST_SAMPLES:
        raise LeftOut(
            f"{shown}:{int(line[-1])}",
            f"{len(values)} samples, fewer than {FEWEST_SAMPLES}; record the trial again",
        )
    names = ["base_angle", "base_torque", *sensors]
    for k, name in enumerate(names, start=1):
        if name != "base_torque":
            values[:, k], place = unwrapped(values[:, k])
            if place is not None:
                notes.append(f"{shown}:{int(line[place])}: {name} wraps by a whole turn; unwrapped")
    values, phase, line = _without_blind_end(values, phase, line, shown, notes)
    time_s = values[:, 0]
    _note_gaps(values, line, names, shown, notes, absent)
    _mask_stuck(values, line, names, shown, notes)
    base_known = np.isfinite(values[:, 1])
    filled = np.interp(time_s, time_s[base_known], values[base_known, 1])
    path_in = denoised_base(time_s, filled)
    tip_nm = _tip_torque(values, len(names), line, shown, notes)
    if start == "relaxed":
        _check_rest(time_s, path_in.angle_rad, int(line[0]), shown)
    if not phase[0] and len(set(phase.tolist())) == 1:
        phase = _phases_from_motion(path_in.holding, command.kind)
        notes.append(f"{shown}:1: no column `phase`; motions are told apart by the base's holds")
    return DatasetTrial(
        trial=Trial(time_s.copy(), path_in.angle_rad, start_s, tip_torque_nm=tip_nm),
        base_measured_rad=values[:, 1].copy(),
        base_residual_rad=path_in.residual_rad,
        torque_nm=values[:, 2].copy(),
        hall_rad=values[:, 3 : 3 + len(sensors)].copy(),
        phase=phase,
        command=command,
        file=shown,
        notes=tuple(notes),
        start=start,
    )


def _without_blind_end(
    values: Array, phase: npt.NDArray[np.str_], line: npt.NDArray[np.int64], shown: str, notes: list[str]
) -> tuple[Array, npt.NDArray[np.str_], npt.NDArray[np.int64]]:
    """The samples up to the first long gap of the encoder over which the base moved.

    Friction remembers the way; what comes after a way that nobody saw cannot be compared.
    """
    time_s, base = values[:, 0], values[:, 1]
    known = np.flatnonzero(np.isfinite(base))
    if not len(known):
        raise LeftOut(f"{shown}:2", "the base angle is never known")
    if known[0] > 0:
        notes.append(
            f"{shown}:{int(line[0])}: the base angle is missing in the first {known[0]} rows; left out"
        )
        values, phase, line = values[known[0] :], phase[known[0] :], line[known[0] :]
        time_s, base = values[:, 0], values[:, 1]
        known = known - known[0]
    gaps = np.diff(time_s[known])
    moved = np.abs(np.diff(base[known]))
    blind = np.flatnonzero((gaps > max(LONGEST_BLIND_S, 3 * np.median(gaps))) & (moved > math.radians(1.0)))
    if blind.size:
        last = int(known[blind[0]])
        after = len(values) - last - 1
        notes.append(
            f"{shown}:{int(line[last])}: the base turned by {math.degrees(moved[blind[0]]):.1f}° in "
            f"{gaps[blind[0]]:.2f} s without the encoder; the {after} samples after it are not used"
        )
        values, phase, line = values[: last + 1], phase[: last + 1], line[: last + 1]
        if len(values) < FEWEST_SAMPLES:
            raise LeftOut(f"{shown}:{int(line[-1])}", f"{len(values)} samples before the encoder's gap")
    return values, phase, line


def _note_gaps(
    values: Array,
    line: npt.NDArray[np.int64],
    names: list[str],
    shown: str,
    notes: list[str],
    absent: Collection[str],
) -> None:
    for k, name in enumerate(names, start=1):
        missing = np.flatnonzero(~np.isfinite(values[:, k]))
        if missing.size == len(values) and name not in absent:
            notes.append(f"{shown}: {name} is missing in every sample; nothing is compared in this channel")
        if name != "base_angle" and is_slow(np.isfinite(values[:, k])):
            notes.append(
                f"{shown}: {name} has a reading in one of {round(len(values) / (len(values) - missing.size))}"
                " samples: compared where it was read"
            )
        elif 0 < missing.size < len(values):
            how = "filled along a straight line" if name == "base_angle" else "not compared"
            notes.append(
                f"{shown}:{int(line[missing[0]])}: {name} is missing in {missing.size} samples; {how}"
            )
    steps = np.diff(values[:, 0])
    wide = np.flatnonzero(steps > 5.0 * np.median(steps))
    if wide.size:
        notes.append(
            f"{shown}:{int(line[wide[0]])}: {wide.size} gaps in time, the longest {steps[wide].max():.2f} s"
        )


def is_slow(valid: npt.NDArray[np.bool_]) -> bool:
    """Whether a channel has samples in few of the rows (M,): beside a faster one, it was read more slowly."""
    return bool(valid.any() and valid.mean() < SLOW_SHARE)


def _tip_torque(
    values: Array, channels: int, line: npt.NDArray[np.int64], shown: str, notes: list[str]
) -> Array | None:
    """The torque on the tip at every sample, None without its column."""
    if values.shape[1] <= 1 + channels:
        return None
    time_s, torque_nm = values[:, 0], values[:, 1 + channels]
    known = np.isfinite(torque_nm)
    if not known.any():
        raise LeftOut(
            f"{shown}:{int(line[0])}", "the torque on the tip, which drives the model, is never known"
        )
    missing = np.flatnonzero(~known)
    if missing.size:
        notes.append(
            f"{shown}:{int(line[missing[0]])}: tip_torque is missing in {missing.size} samples; filled along"
            " a straight line"
        )
    return np.interp(time_s, time_s[known], torque_nm[known])


def _mask_stuck(
    values: Array, line: npt.NDArray[np.int64], names: list[str], shown: str, notes: list[str]
) -> None:
    """Dead stretches of a sensor become missing samples; the base's own holds are left alone."""
    noisy = [np.count_nonzero(np.diff(values[:10, k])) > 0 for k in range(2, len(names) + 1)]
    travel = float(np.nanmax(values[:, 1]) - np.nanmin(values[:, 1]))
    for k, name in enumerate(names[1:], start=2):
        channel = values[:, k]
        known = channel[np.isfinite(channel)]
        if len(known) and np.ptp(known) == 0.0:
            others = any(n for i, n in enumerate(noisy, start=2) if i != k)
            if others and travel > math.radians(5):
                channel[:] = np.nan
                notes.append(
                    f"{shown}:{int(line[0])}: {name} never changes: a dead sensor; it is not compared here"
                )
            continue
        for start, stop in stuck_runs(channel, values[:, 0]):
            channel[start:stop] = np.nan
            notes.append(
                f"{shown}:{int(line[start])}: {name} repeats one value for {stop - start} samples: "
                "a stuck sensor; they are not compared"
            )


def _first(time_s: Array) -> int:
    """Samples in which a base that is at rest shows it."""
    return max(3, int(np.searchsorted(time_s, time_s[0] + 0.1)))


def rest_rate_deg_s(time_s: Array, base_rad: Array) -> float:
    """The base's rate in the first tenth of a second."""
    last = min(_first(time_s), len(time_s)) - 1
    return math.degrees(float(base_rad[last] - base_rad[0]) / max(float(time_s[last] - time_s[0]), 1e-9))


def _check_rest(time_s: Array, base_rad: Array, line: int, shown: str) -> None:
    rate = rest_rate_deg_s(time_s, base_rad)
    start = math.degrees(float(base_rad[: _first(time_s)].mean()))
    if abs(rate) > AT_REST_DEG_S:
        raise LeftOut(
            f"{shown}:{line}",
            f"the base already turns at {rate:.0f}°/s; a trial must start at rest, with the shaft relaxed at"
            " 0°, unless it says `start: wound`",
        )
    if abs(start) > AT_REST_DEG:
        raise LeftOut(
            f"{shown}:{line}",
            f"the base starts at {start:.1f}°; a trial must start with the shaft relaxed at 0°, unless it"
            " says `start: wound`",
        )


_SEQUENCE = ("rotate", "overshoot", "back", "forward", "final")


def _phases_from_motion(holding: npt.NDArray[np.bool_], kind: str) -> npt.NDArray[np.str_]:
    """Names of motions from where the base moves: rest, then those of a compensation, or step_1, step_2…"""
    starts = np.flatnonzero(np.diff(holding.astype(np.int8)) == -1) + 1
    number = np.zeros(len(holding), dtype=np.int64)
    number[starts] = 1
    number = np.cumsum(number) + (0 if holding[0] else 1)
    motions = int(number[-1])
    name: Callable[[int], str] = (
        (lambda k: _SEQUENCE[k - 1])
        if kind == "compensate" and motions == len(_SEQUENCE)
        else (lambda k: f"step_{k}")
    )
    return np.array(["rest", *(name(k) for k in range(1, motions + 1))])[number]
