"""Figures of a comparison, one function each, by the name that a person asks for (`FIGURES`).

All are of the column that counts (`TraceComparison.shown`); those of `figures.refit` are of the refit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from needle_rig.errors import BadInput
from needle_rig.figures.comparison import pulls, residual_map, traces, worst_trials
from needle_rig.figures.figure import Figure
from needle_rig.figures.refit import correlation, profile
from needle_rig.numerics import Array
from needle_rig.units import deg
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.misfit import modelled
from needle_rig.workbench.learning.places import scale_of
from needle_rig.workbench.selection.answer import SIGMAS_95

FORMATS = (".png", ".svg", ".pdf")
DOTS_PER_INCH = 150
MOST_LAGS = 30


def loop(found: TraceComparison) -> Figure:
    """Torque against the base angle in the worst trial: the hysteresis loop, measured and modelled."""
    t = worst_trials(found)[0]
    given, binned = found.baseline.dataset.trials[t], found.baseline.problem.trials[t]
    factor, unit = scale_of(0)
    figure = Figure(figsize=(5.0, 4.0), layout="constrained")
    axis = figure.subplots()
    base_deg = deg(given.trial.base_angle_rad)
    axis.plot(base_deg, factor * given.torque_nm, ".", ms=1.5, color="0.5", label="measured")
    drive_deg = deg(binned.trial.base_angle_rad)
    for name, of, colour in _columns(found):
        torque_nm = modelled(found.baseline.problem, of.fit, t)[0]
        axis.plot(drive_deg, factor * torque_nm, color=colour, lw=1.0, label=name)
    axis.set_xlabel("base angle / °")
    axis.set_ylabel(f"base torque / {unit}")
    axis.set_title(Path(given.file).name, fontsize=9)
    axis.legend(fontsize=8)
    return figure


def strips(found: TraceComparison) -> Figure:
    """The worst trial, each channel with a strip of its residuals in units of the noise below it."""
    problem, t = found.baseline.problem, worst_trials(found)[0]
    given, binned = found.baseline.dataset.trials[t], problem.trials[t]
    names = ("torque", *found.baseline.dataset.sensor_names)
    figure = Figure(figsize=(6.5, 1.9 * len(names) + 0.6), layout="constrained")
    axes = figure.subplots(2 * len(names), 1, sharex=True, height_ratios=[3, 1] * len(names), squeeze=False)[
        :, 0
    ]
    data = np.vstack([given.torque_nm[None, :], given.hall_rad.T])
    for c, name in enumerate(names):
        factor, unit = scale_of(c)
        above, below = axes[2 * c], axes[2 * c + 1]
        above.plot(given.trial.time_s, factor * data[c], ".", ms=1.0, color="0.6", label="measured")
        above.set_ylabel(f"{name} / {unit}", fontsize=8)
        for label, of, colour in _columns(found):
            model = factor * modelled(problem, of.fit, t)[c]
            above.plot(binned.trial.time_s, model, color=colour, lw=1.0, label=label)
            left, noise = problem.raw(of.fit.residuals)[t][c], _noise(found, t)[c]
            below.plot(binned.time_s, left / noise, ".-", ms=2, lw=0.5, color=colour)
        below.axhspan(-2.0, 2.0, color="0.9", lw=0)
        below.set_ylabel("σ", fontsize=8)
    axes[0].legend(fontsize=7)
    axes[0].set_title(Path(given.file).name, fontsize=9)
    axes[-1].set_xlabel("time / s")
    return figure


def over_time(found: TraceComparison) -> Figure:
    """Whitened residuals of every trial over the time within the trial, by channel."""
    return _scattered(found, "time / s", lambda t, _: found.baseline.problem.trials[t].time_s)


def over_model(found: TraceComparison) -> Figure:
    """Whitened residuals of every trial over what the model predicts, by channel."""
    problem = found.baseline.problem
    raw = problem.raw(found.shown.fit.residuals)

    def predicted(t: int, c: int) -> Array:
        return np.asarray(scale_of(c)[0] * (problem.trials[t].mean[c] - raw[t][c]))

    return _scattered(found, "model", predicted)


def qq(found: TraceComparison) -> Figure:
    """Quantiles of the whitened residuals beside those of the standard normal."""
    figure = Figure(figsize=(4.5, 4.2), layout="constrained")
    axis = figure.subplots()
    for c, name in enumerate(_names(found)):
        values = np.sort(np.concatenate(_whitened(found, c)))
        if values.size:
            at = ndtri((np.arange(values.size) + 0.5) / values.size)
            axis.plot(at, values, ".", ms=2, label=name)
    ends = np.array([-4.0, 4.0])
    axis.plot(ends, ends, color="k", lw=0.8)
    axis.set_xlabel("standard normal quantile")
    axis.set_ylabel("whitened residual / σ")
    axis.legend(fontsize=7)
    return figure


def autocorrelation(found: TraceComparison) -> Figure:
    """Autocorrelation of the whitened residuals within trials, with the 95 % band of noise alone."""
    figure = Figure(figsize=(5.5, 3.4), layout="constrained")
    axis = figure.subplots()
    size = 0
    for c, name in enumerate(_names(found)):
        trials = [values for values in _whitened(found, c) if values.size > MOST_LAGS]
        if trials:
            size = max(size, sum(values.size for values in trials))
            power = sum(float(values @ values) for values in trials)
            seen = [
                sum(float(v[: v.size - lag] @ v[lag:]) for v in trials) / power
                for lag in range(1, MOST_LAGS + 1)
            ]
            axis.plot(range(1, MOST_LAGS + 1), seen, ".-", ms=3, lw=0.7, label=name)
    if size:
        half = SIGMAS_95 / np.sqrt(size)
        axis.axhspan(-half, half, color="0.9", lw=0)
        axis.legend(fontsize=7)
    axis.axhline(0.0, color="k", lw=0.6)
    axis.set_xlabel("lag / bins")
    axis.set_ylabel("autocorrelation")
    return figure


def band(found: TraceComparison) -> Figure:
    """The worst trial with the 95 % band of the refit: its values, a trial's own friction, and the noise."""
    problem, of, t = found.baseline.problem, found.baseline.current, worst_trials(found)[0]
    binned = problem.trials[t]
    root = np.linalg.cholesky(of.covariance + 1e-18 * np.eye(len(of.covariance)))
    directions = np.zeros((root.shape[0] + 1, root.shape[0] + 1))
    directions[:-1, :-1], directions[-1, -1] = root, of.scatter
    moved = problem.raw([j @ directions for j in of.jacobians])[t]
    left, noise = problem.raw(of.residuals)[t], _noise(found, t)
    names = _names(found)
    figure = Figure(figsize=(6.5, 1.5 * len(names) + 0.6), layout="constrained")
    axes = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    for c, (axis, name) in enumerate(zip(axes, names, strict=True)):
        factor, unit = scale_of(c)
        model = factor * (binned.mean[c] - left[c])
        half = factor * SIGMAS_95 * np.sqrt((moved[c] ** 2).sum(axis=1) + noise[c] ** 2)
        axis.fill_between(
            binned.time_s, model - half, model + half, color="tab:blue", alpha=0.3, lw=0, label="95 %"
        )
        axis.plot(binned.time_s, factor * binned.mean[c], ".", ms=2, color="0.3", label="measured, bin means")
        axis.set_ylabel(f"{name} / {unit}", fontsize=8)
    axes[0].legend(fontsize=7)
    axes[0].set_title(Path(binned.file).name, fontsize=9)
    axes[-1].set_xlabel("time / s")
    return figure


FIGURES: dict[str, Callable[[TraceComparison], Figure]] = {
    "traces": traces,
    "residuals": residual_map,
    "pulls": pulls,
    "loop": loop,
    "strips": strips,
    "over_time": over_time,
    "over_model": over_model,
    "qq": qq,
    "autocorrelation": autocorrelation,
    "correlation": correlation,
    "profile": profile,
    "band": band,
}
"""By the name that a person asks for."""


def drawn(found: TraceComparison, what: str) -> Figure:
    """The figure of this name. Raises BadInput."""
    if what not in FIGURES:
        raise BadInput(f"figure {what}: there are {', '.join(FIGURES)}")
    return FIGURES[what](found)


def asked(path: Path) -> str:
    """The figure that a file is named after. Raises BadInput for another name or ending."""
    if path.suffix not in FORMATS or path.stem not in FIGURES:
        raise BadInput(
            f"--figure {path}: name the file after a figure ({', '.join(FIGURES)}), ending in"
            f" {', '.join(FORMATS)}"
        )
    return path.stem


def write_figure(found: TraceComparison, path: Path) -> None:
    """The figure that `path` is named after, in the format of its ending. Raises BadInput."""
    figure = drawn(found, asked(path))
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=DOTS_PER_INCH)


def _columns(found: TraceComparison) -> list[tuple[str, Any, str]]:
    """Name, misfit and colour of each column."""
    if found.held is None:
        return [("model, fitted", found.refit, "tab:red")]
    return [("model as it stands", found.held, "tab:red"), ("refitted", found.refit, "tab:blue")]


def _names(found: TraceComparison) -> tuple[str, ...]:
    return ("torque", *found.baseline.dataset.sensor_names)


def _noise(found: TraceComparison, trial: int) -> Array:
    """Standard deviation of each bin mean (C, K) of one trial by the noise alone; NaN without a reading."""
    problem = found.baseline.problem
    spread = np.full(problem.trials[trial].mean.shape, np.nan)
    whitening = problem.whiteners[trial]
    for c, (use, inverse) in enumerate(zip(whitening.use, whitening.inverse, strict=True)):
        spread[c, use] = np.linalg.norm(np.linalg.inv(inverse), axis=1) if use.size else 0.0
    return spread


def _whitened(found: TraceComparison, channel: int) -> list[Array]:
    """Whitened residuals of one channel, an array a trial."""
    return [
        r[w.channel == channel]
        for r, w in zip(found.shown.fit.residuals, found.baseline.problem.whiteners, strict=True)
    ]


def _scattered(found: TraceComparison, words: str, across: Callable[[int, int], Array]) -> Figure:
    """Whitened residuals by channel over what `across` says of the bins of a trial and channel."""
    problem, names = found.baseline.problem, _names(found)
    figure = Figure(figsize=(6.5, 1.4 * len(names) + 0.6), layout="constrained")
    axes = figure.subplots(len(names), 1, squeeze=False)[:, 0]
    for c, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for t, values in enumerate(_whitened(found, c)):
            axis.plot(across(t, c)[problem.whiteners[t].use[c]], values, ".", ms=2)
        axis.axhspan(-2.0, 2.0, color="0.9", lw=0, zorder=0)
        axis.set_ylabel(f"{name} / σ", fontsize=8)
        if words == "model":
            axis.set_xlabel(f"predicted {name} / {scale_of(c)[1]}", fontsize=8)
    if words != "model":
        axes[-1].set_xlabel(words)
    return figure
