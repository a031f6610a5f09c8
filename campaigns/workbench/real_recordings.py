"""A real cable drive (config/recordings/davinci.yaml) held against the model, one part after the other.

`--png docs/pictures/real-recordings.png` draws the data and the best model.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from argparse import Namespace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from campaigns import ROOT
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.dataset import Dataset, DatasetTrial, TrialCommand, read_dataset, write_dataset
from needle_rig.importing import dataset_of, read_mapping
from needle_rig.numerics import Array
from needle_rig.physics.library import find_effects
from needle_rig.units import deg, nmm, per_100mm
from needle_rig.workbench.estimation.baseline import judged, null_model
from needle_rig.workbench.estimation.cross_validation import cross_validate
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.posterior import start_vector
from needle_rig.workbench.estimation.problem import Fit, ParameterVector, Problem
from needle_rig.workbench.observations.binning import BinnedTrial, bin_trial, bins_of_samples
from needle_rig.workbench.observations.measured_noise import measure_noise
from needle_rig.workbench.observations.noise import variance
from needle_rig.workbench.observations.noise_terms.white import White

RECORDED = ROOT / "config/recordings/davinci.yaml"
EFFECTS = ROOT / "config/recordings/effects"
ELEMENT_M = 0.02
FRICTION_N, RIGIDITY_NM2 = 0.003, 0.34
READ_OFF: dict[str, float] = {
    "hall_gain.gain_error": -0.06,
    "hall_offset.offset_deg": -2.0,
    "torque_bias.bias_nmm": 5.0,
    "bearing_drag.torque_nmm": 28.0,
    "bearing_drag.viscous_nmms_per_rad": 0.5,
    "bearing_drag.presliding_deg": 0.02,
    "return_spring.stiffness_nmm_per_rad_per_100mm": 4.0,
    "winding_hysteresis.torque_nmm": 12.0,
    "soft_cable.twist_deg": 3.0,
    "soft_cable.stiffness_ratio": 0.2,
    "pulley_friction.torque_nmm": 6.0,
    "pulley_friction.per_torque": 0.2,
    "gear_ripple.per_turn": 10.0,
    "gear_ripple.second_per_turn": 25.0,
}
"""Sizes as the loops show them, at which each fit starts beside those of the fit before."""
ENCODER_STEP_RAD = 2.0 * np.pi / 8192
ANGLES_DEG, BINS = (12.0, 52.0), 20
"""Angles of the base away from reversals, cut into so many bins."""
LINE = 2
"""Parameters of a straight line."""
LARGE_NMM = 20.0
"""Between the two loads."""
PARTS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("zeros and scales of the sensors", ("hall_gain", "hall_offset", "torque_bias")),
    ("drag of the spindle's bearing", ("bearing_drag",)),
    ("restoring spring of the wrist", ("return_spring",)),
    ("hysteresis of what the spindle winds", ("winding_hysteresis",)),
    ("cable softer at small pull", ("soft_cable",)),
    ("friction of a pulley", ("pulley_friction",)),
    ("ripple of the jaw's teeth or windings", ("gear_ripple",)),
    ("friction along the cable, with its pull", ("capstan_friction",)),
)
TRIED = ("hall_eccentricity", "loose_load", "tissue_elasticity", "chuck_compliance")
"""Parts that a cable drive may have, each added to all of the above."""


def recorded() -> Dataset:
    """The shipped excerpt after its run-in; a recording is a command, also where a trial of it is shorter."""
    mapping, places = read_mapping(RECORDED)
    with tempfile.TemporaryDirectory() as folder:
        written = write_dataset(dataset_of(mapping, RECORDED.parent, places), Path(folder) / "davinci")
        dataset = judged(read_dataset(written))
    found: dict[tuple[float | None, bool], TrialCommand] = {}
    commands = (
        found.setdefault((c.speed_deg_s, is_large(c)), c) for c in (t.command for t in dataset.trials)
    )
    trials = (dataclasses.replace(t, command=c) for t, c in zip(dataset.trials, commands, strict=True))
    return dataclasses.replace(dataset, trials=tuple(trials))


def is_large(command: TrialCommand) -> bool:
    """Whether a command is one with the larger load."""
    return float(dict(command.other)["tip_torque_nmm"]) > LARGE_NMM


def binned(given: DatasetTrial) -> BinnedTrial:
    """Bins of a trial, without the torque where the spindle stays within a step of its encoder.

    There the torque jumps by that of the bearing, and the angle that drives the model does not show when.
    """
    trial, of_sample = bin_trial(given), bins_of_samples(given)
    base_rad, mean = given.trial.base_angle_rad, trial.mean.copy()
    for k in range(mean.shape[1]):
        if np.ptp(base_rad[of_sample == k]) <= ENCODER_STEP_RAD:
            mean[0, k] = np.nan
    return dataclasses.replace(trial, mean=mean)


def once_each(trial: BinnedTrial) -> BinnedTrial:
    """Bins that count once: what differs between recordings does not average out over their samples."""
    return dataclasses.replace(trial, count=np.minimum(trial.count, 1))


def left(problem: Problem, found: Fit) -> list[Array]:
    """Data minus model in bin means (C, K) a trial."""
    readings = problem.predict(found.parameters, found.vector)
    return [b.mean - r for b, r in zip(problem.trials, readings, strict=True)]


def rms(values: list[Array], channel: int) -> float:
    """Root mean square over all bins that have a mean."""
    return float(np.sqrt(np.nanmean(np.concatenate([v[channel] for v in values]) ** 2)))


def starts(problem: Problem, names: tuple[str, ...], before: Fit | None) -> list[ParameterVector]:
    """Sizes as read off the loops; and the fit before, with what is new as read off."""
    parameters = problem.parameters(names)
    sizes = [READ_OFF.get(f"{p.effect}.{p.field}", p.info.at_strength(0.5)) for p in parameters]
    read_off = np.array([p.scaled_value(size) for p, size in zip(parameters, sizes, strict=True)])
    begin = start_vector(problem, float(np.log(FRICTION_N)), parameters)
    found = [dataclasses.replace(begin, log_rigidity=float(np.log(RIGIDITY_NM2)), scaled_values=read_off)]
    if before is not None:
        known = {
            (p.effect, p.field): float(v)
            for p, v in zip(before.parameters, before.vector.scaled_values, strict=True)
        }
        scaled = [known.get((p.effect, p.field), v) for p, v in zip(parameters, read_off, strict=True)]
        found.append(dataclasses.replace(before.vector, scaled_values=np.array(scaled)))
    return found


def with_more(problem: Problem, names: tuple[str, ...], before: Fit | None) -> Fit:
    """The best fit with more effects than the fit before has."""
    fits = [fit(problem, names, start) for start in starts(problem, names, before)]
    return min((f for f in fits if f is not None), key=lambda f: f.objective)


def ladder(problem: Problem, parts: int) -> list[tuple[str, Fit]]:
    """The best fit with each of the first parts added."""
    names: tuple[str, ...] = ()
    found: list[tuple[str, Fit]] = []
    for title, added in PARTS[:parts]:
        names += added
        best = with_more(problem, names, found[-1][1] if found else None)
        found.append((title, best))
    return found


def errors(problem: Problem, found: Fit, scatter: Array, repeat: Array) -> dict[str, float]:
    """Over all bins in noise, away from reversals in scatter, over all bins in what periods differ by."""
    out = cross_validate(problem, found)
    middle = [r[:, away_from_reversals(b)] for r, b in zip(out.residuals, problem.trials, strict=True)]
    torque_nm, jaw_rad = rms(middle, 0), rms(middle, 1)
    whole = np.concatenate([r / repeat[:, None] for r in out.residuals], axis=1)
    told = {
        "fitted × noise": np.sqrt(found.chi2 / problem.size),
        "left out × noise": out.error,
        "torque left out N·mm": nmm(torque_nm),
        "jaw left out °": deg(jaw_rad),
        "torque × scatter": torque_nm / scatter[0],
        "jaw × scatter": jaw_rad / scatter[1],
        "left out × difference of periods": np.sqrt(np.nanmean(whole**2)),
    }
    return {name: round(float(value), 3) for name, value in told.items()}


def between_periods(problem: Problem) -> Array:
    """By how much a bin's torque (N·m) and lag (rad) differ from period to period of a recording: medians."""
    channels = range(problem.trials[0].mean.shape[0])
    each = [np.concatenate([variance(problem.noise, b, c) for b in problem.trials]) for c in channels]
    return np.asarray(np.sqrt(np.nanmedian(each, axis=1)))


def away_from_reversals(trial: BinnedTrial) -> npt.NDArray[np.bool_]:
    """Which bins (K,) of a trial lie between `ANGLES_DEG`."""
    base_deg = deg(trial.base_rad)
    return np.asarray((base_deg >= ANGLES_DEG[0]) & (base_deg < ANGLES_DEG[1]))


def between_recordings(dataset: Dataset) -> Array:
    """By how much torque (N·m) and lag (rad) at one angle, direction and load differ between recordings.

    Root mean square, away from reversals, about the straight line over the speed of each angle, direction and
    load: what has an order in the speed is rate dependence, which a model could have.
    """
    edges = np.radians(np.linspace(*ANGLES_DEG, BINS + 1))
    cells: dict[tuple[bool, int, int], list[Array]] = {}
    for command, places in dataset.replicates.items():
        trials = [dataset.trials[p] for p in places]
        drives = [t.trial for t in trials]
        base, rate, torque, lag = (
            np.concatenate(each)
            for each in (
                [d.base_angle_rad for d in drives],
                [np.gradient(d.base_angle_rad, d.time_s) for d in drives],
                [t.torque_nm for t in trials],
                [d.base_angle_rad - t.hall_rad[:, -1] for d, t in zip(drives, trials, strict=True)],
            )
        )
        for way in (-1, 1):
            for k in range(BINS):
                here = (np.sign(rate) == way) & (base >= edges[k]) & (base < edges[k + 1])
                here &= np.isfinite(torque + lag)
                if here.any():
                    seen = np.array([np.abs(rate[here]).mean(), torque[here].mean(), lag[here].mean()])
                    cells.setdefault((is_large(command), way, k), []).append(seen)
    squares, dof = np.zeros(2), 0
    for seen_by_all in cells.values():
        table = np.array(seen_by_all)
        if len(table) > LINE:
            line = np.column_stack([np.ones(len(table)), table[:, 0]])
            about = table[:, 1:] - line @ np.linalg.lstsq(line, table[:, 1:], rcond=None)[0]
            squares += (about**2).sum(axis=0)
            dof += len(table) - LINE
    return np.asarray(np.sqrt(squares / dof))


def plan(given: Namespace) -> list[Row]:
    return [{"parts": given.size}]


def ask(task: Row, given: Namespace) -> Row:
    """Errors of every fit, and the values of the last one of the ladder."""
    dataset = recorded()
    trials = tuple(binned(t) for t in dataset.trials)
    noise = measure_noise(dataset.trials, trials, dataset.torque_scale)
    base = dataclasses.replace(null_model(dataset), element_length_m=ELEMENT_M)
    problem = Problem(
        dataset.name, base, find_effects([EFFECTS]), trials, noise, dataset.needle.rigidity_sigma
    )
    repeat, scatter = between_periods(problem), between_recordings(dataset)
    problem = problem.over([once_each(b) for b in trials]).with_noise(noise.having(White(scatter)))
    spans = [np.ptp(t.torque_nm[t.torque_ok]) for t in dataset.trials]
    found = ladder(problem, task["parts"])
    last = found[-1][1]
    tried = [(name, with_more(problem, (*last.effects, name), last)) for name in TRIED]
    if given.png is not None:
        from needle_rig.figures.recordings import draw

        draw(problem, left(problem, last), given.png)
    rigidity_nmm2 = float(np.exp(last.vector.log_rigidity)) * 1e6
    friction = per_100mm(float(np.exp(last.vector.log_friction)))
    fitted = zip(last.parameters, last.vector.scaled_values, strict=True)
    return {
        "data": {
            "periods": len(dataset.trials),
            "recordings": len(problem.groups),
            "span of the torque (median) N·mm": round(nmm(float(np.median(spans)))),
            "bins from period to period (medians) N·mm": round(nmm(float(repeat[0])), 2),
            "bins from period to period (medians) °": round(deg(float(repeat[1])), 3),
            "from recording to recording (scatter) N·mm": round(nmm(float(scatter[0])), 2),
            "from recording to recording (scatter) °": round(deg(float(scatter[1])), 3),
        },
        "ladder": {title: errors(problem, each, scatter, repeat) for title, each in found},
        "tried": {name: errors(problem, each, scatter, repeat) for name, each in tried},
        "values": [
            ["torsional rigidity of the cable line", rigidity_nmm2, "N·mm²"],
            ["friction", friction, "N·mm per 100 mm"],
            *([f"{p.effect}.{p.field}", p.value(float(value)), p.info.unit] for p, value in fitted),
        ],
    }


def table(rows: list[Row], _: Namespace) -> str:
    """The figures as Markdown."""
    parts = []
    for row in answered(rows):
        heads = ["parts, each added to those above", *next(iter(row["ladder"].values()))]
        parts.append(markdown(("data", "value"), row["data"].items()))
        parts.append(markdown(heads, ([title, *each.values()] for title, each in row["ladder"].items())))
        heads[0] = "tried beside all of these"
        parts.append(markdown(heads, ([name, *each.values()] for name, each in row["tried"].items())))
        values = (
            [name, f"{value:.3g}" if value < 1e5 else round(value), unit]
            for name, value, unit in row["values"]
        )
        parts.append(markdown(["parameter", "value", "unit"], values))
    return "\n\n".join(parts)


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--png", type=Path, help="file for a drawing of the last fit")


CAMPAIGN = Campaign(__doc__, plan, ask, table, len(PARTS), "parts of the ladder (all)", options)
