"""Checks that need the whole dataset: units by their scale, and shafts that did not start relaxed."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from needle_rig.config.hints import UNITS, split_unit
from needle_rig.dataset.channels import suspected_factor, white_noise
from needle_rig.dataset.description import UNTOLD_NM2
from needle_rig.dataset.records import UNKNOWN_SIGMA, DatasetTrial, Needle
from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.rod import Layout
from needle_rig.physics.torque_scale import torque_scale

LEAST_TWIST_DEG = 3.0
"""Below it the twist is the sensors' noise."""
FARTHER = 1.5
"""Decimal places between two units from which the twist, a factor of two uncertain, tells them apart."""
WOUND_DEG = 3.0
"""A shaft whose sensors start this far from where the other trials start was not relaxed."""


def check_units(
    trials: Sequence[DatasetTrial], layout: Layout, needle: Needle, sensors: tuple[str, ...]
) -> None:
    """Raise BadInput when a column has the scale of another unit than its name says."""
    for trial in trials:
        _check_base(trial)
        _check_time(trial)
    for sensor, name in enumerate(sensors):
        for trial in trials:
            _check_hall(trial, sensor, name)
    for trial in trials:
        _check_torque(trial, layout, needle)


def guessed_rigidity(trials: Sequence[DatasetTrial], layout: Layout) -> tuple[Needle, str]:
    """The shaft with the rigidity that the torque's span over that of the twist tells, within a factor of
    about two; and a sentence of what cannot be known."""
    known = {s: place for s, place in enumerate(layout.sensor_positions_m) if place > 0}
    found: list[float] = []
    beside = False
    for trial in trials:
        base, torque = trial.trial.base_angle_rad, trial.torque_nm
        for sensor, place in sorted(known.items(), key=lambda item: item[1]):
            twist = base - trial.hall_rad[:, sensor]
            both = np.isfinite(twist) & np.isfinite(torque)
            beside = beside or both.sum() >= 20
            if both.sum() >= 20 and np.ptp(twist[both]) > math.radians(LEAST_TWIST_DEG):
                found.append(float(np.ptp(torque[both]) / np.ptp(twist[both])) * place)
                break
    said = "rig.needle: the torsional rigidity is unknown"
    if found:
        rigidity = float(np.median(found))
        return Needle.of_rigidity(rigidity, UNKNOWN_SIGMA), (
            f"{said}: about {rigidity * 1e6:.2g} N·mm² from torque over twist, and learnt from there; a gain"
            " of the torque sensor and a rigidity that is off cannot be told apart"
        )
    spans = [float(np.ptp(t.torque_nm[t.torque_ok])) for t in trials if t.torque_ok.any()]
    untold_nm2 = UNTOLD_NM2 * (torque_scale(float(np.median(spans)), None) if spans else 1.0)
    why = (
        f"no trial with a torque twists the shaft by more than {LEAST_TWIST_DEG:g}° up to a sensor"
        if beside
        else "no trial has a torque beside an angle of the shaft"
    )
    return Needle.of_rigidity(untold_nm2, UNKNOWN_SIGMA), (
        f"{said} and {why}: {untold_nm2 * 1e6:g} N·mm² stands for it; angles alone tell friction over"
        " rigidity, a torque alone tells them only as far as the shaft's spring shows at reversals"
    )


def judge_starts(
    trials: Sequence[DatasetTrial], sensors: tuple[str, ...]
) -> tuple[list[DatasetTrial], list[str]]:
    """The trials, those that start unlike the others as wound; and a sentence for each.

    A shaft that was left wound shows it before the first motion: in the torque, or in two angles or more.
    One angle alone that begins elsewhere is a sensor that has moved: its trial is left out. Offsets that all
    trials share stay.
    """
    relaxed = [t for t in trials if t.start == "relaxed" and not t.turns_before_rad]
    if len(relaxed) < 3:
        return list(trials), []
    with np.errstate(invalid="ignore"):
        usual = _median(np.array([_at_start(t) for t in relaxed]))
    largest = float(np.nanmax([np.nanmax(np.abs(t.torque_nm), initial=0.0) for t in trials]) or 0.0)
    limits = np.array([max(0.3 * largest, 1e-6), *([math.radians(WOUND_DEG)] * len(sensors))])
    kept: list[DatasetTrial] = []
    notes: list[str] = []
    for trial in trials:
        start = _at_start(trial)
        with np.errstate(invalid="ignore"):
            away = np.where(np.isfinite(start), np.abs(start - usual), 0.0)
        unlike = np.flatnonzero(away > limits)
        if trial.start != "relaxed" or trial.turns_before_rad or not unlike.size:
            kept.append(trial)
            continue
        worst = int(unlike[np.argmax(away[unlike] / limits[unlike])])
        if worst:
            words = f"{sensors[worst - 1]} begins at {math.degrees(start[worst]):.1f}°"
            others = f"others at {math.degrees(usual[worst]):.1f}°"
        else:
            words = f"the torque starts at {start[0] * 1e3:.3f} N·mm"
            others = f"other trials at {usual[0] * 1e3:.3f} N·mm"
        if unlike[0] == 0 or unlike.size > 1:
            notes.append(f"{trial.file}:2: {words}, {others}: taken as a wound start")
            kept.append(dataclasses.replace(trial, start="wound"))
        else:
            notes.append(
                f"{trial.file}:2: left out: {words}, {others}; where the shaft was wound: `start: wound`"
            )
    return kept, notes


def _at_start(trial: DatasetTrial) -> Array:
    """Torque and Hall angles before the first motion, NaN where unknown."""
    base = trial.trial.base_angle_rad
    moving = np.flatnonzero(np.abs(base - base[0]) > math.radians(0.2))
    rows = slice(0, max(3, min(int(moving[0]) if moving.size else len(base), 50)))
    values = np.column_stack([trial.torque_nm[rows], trial.hall_rad[rows]])
    return _median(values)


def _median(values: Array) -> Array:
    """Median of each column over its known values, NaN when there is none."""
    result = np.full(values.shape[1], np.nan)
    for k in range(values.shape[1]):
        known = values[np.isfinite(values[:, k]), k]
        if len(known):
            result[k] = np.median(known)
    return result


def _check_base(trial: DatasetTrial) -> None:
    targets = [abs(s) for s in trial.command.steps_deg]
    if trial.command.target_deg is not None:
        targets.append(abs(trial.command.target_deg))
    target = math.radians(max(targets, default=0.0))
    reached = float(np.max(np.abs(trial.trial.base_angle_rad)))
    if suspected_factor(reached, target, 180.0 / math.pi, 3.0):
        raise BadInput(
            f"{trial.file}:1: base_angle_deg reaches {math.degrees(reached):.3g} where dataset.yaml has a "
            f"target of {math.degrees(target):g}°: it looks like radians; convert it, or call the column "
            "base_angle_rad"
        )
    if suspected_factor(reached, target, math.pi / 180.0, 3.0):
        raise BadInput(
            f"{trial.file}:1: base_angle reaches {math.degrees(reached):.4g}° where dataset.yaml has a "
            f"target of {math.degrees(target):g}°: it looks like degrees in a column of radians; rename it"
        )


def _check_time(trial: DatasetTrial) -> None:
    told = trial.command.speed_deg_s
    if told is None:
        return
    time_s, base = trial.trial.time_s, trial.trial.base_angle_rad
    travel = float(np.ptp(base))
    if travel < math.radians(5):
        return
    # The fastest tenth of the moving samples shows the commanded speed.
    rates = np.sort(np.abs(np.diff(base) / np.diff(time_s)))
    fastest = float(np.mean(rates[-max(1, len(rates) // 50) :]))
    for factor, unit in ((1e3, "milliseconds"), (1e6, "microseconds")):
        if suspected_factor(math.degrees(fastest), told, factor, 8.0):
            raise BadInput(
                f"{trial.file}:1: the base turns at {math.degrees(fastest):.3g}°/s where dataset.yaml says "
                f"{told:g}°/s: time_s looks like {unit}; convert it, or call the column "
                f"{'time_ms' if factor == 1e3 else 'time_us'}"
            )


def _check_hall(trial: DatasetTrial, sensor: int, name: str) -> None:
    angle = trial.hall_rad[:, sensor]
    base = trial.trial.base_angle_rad
    known = np.isfinite(angle)
    if known.sum() < 20 or np.ptp(base[known]) < math.radians(10):
        return
    seen, driven = angle[known], base[known]
    spread = float(np.ptp(seen))
    if spread == 0.0:
        return
    # Until the base first turns back, every sensor goes along with it.
    rising = slice(0, max(10, int(np.argmax(np.abs(driven))) + 1))
    if np.ptp(seen[rising]) == 0.0 or np.ptp(driven[rising]) == 0.0:
        return
    together = float(np.corrcoef(seen[rising], driven[rising])[0, 1])
    ratio = spread / float(np.ptp(driven))
    as_if = ratio * 180.0 / math.pi
    if together > 0.8 and 0.2 < as_if < 1.6 and math.degrees(white_noise(seen)) < 0.08:
        raise BadInput(
            f"{trial.file}:1: {name}_deg follows the base with 1/{1 / ratio:.0f} of its motion: it looks "
            f"like radians; convert it, or call the column {name}_rad"
        )
    if together > 0.5 and 0.2 < ratio * math.pi / 180.0 < 1.6:
        raise BadInput(
            f"{trial.file}:1: {name} turns {ratio:.0f} times as far as the base: it looks like degrees in a "
            f"column of radians; call the column {name}_deg"
        )


def _check_torque(trial: DatasetTrial, layout: Layout, needle: Needle) -> None:
    """The twist up to the first sensor gives the torque to a factor of about two."""
    if not layout.sensor_positions_m or not layout.tissue_sections_m or not needle.rigidity_is_known:
        return
    nearest = int(np.argmin(layout.sensor_positions_m))
    twist = trial.trial.base_angle_rad - trial.hall_rad[:, nearest]
    known = np.isfinite(twist) & np.isfinite(trial.torque_nm)
    if known.sum() < 20 or np.ptp(twist[known]) < math.radians(3):
        return
    span = float(np.ptp(twist[known]))
    expected = span * needle.torsional_rigidity_nm2 / layout.sensor_positions_m[nearest]
    seen = float(np.ptp(trial.torque_nm[known]))
    stem, own, dimension = split_unit(trial.torque_column)
    units = UNITS[dimension]
    for other, (size, unit) in units.items():
        factor = size / units[own][0]
        if abs(math.log10(factor)) > FARTHER and suspected_factor(seen, expected, factor, 8.0):
            one = 1e-3 * units[own][0]  # of the column's unit, in N·m
            raise BadInput(
                f"{trial.file}:1: {trial.torque_column} spans {seen / one:.3g} {units[own][1]} where the"
                f" twist up to the first sensor asks for about {expected / one:.2g}: it looks like {unit};"
                f" convert it, or call the column {stem}_{other}"
            )
