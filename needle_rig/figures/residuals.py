"""Figures of a comparison, one function each, by the name that a person asks for (`FIGURES`).

All are of the column that counts (`TraceComparison.shown`); those of `figures.refit` are of the refit.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import betaincinv, ndtri

from needle_rig.errors import BadInput
from needle_rig.figures.comparison import pulls, residual_map, traces, trial_title
from needle_rig.figures.figure import FORMATS, Figure
from needle_rig.figures.refit import correlation, profile
from needle_rig.figures.style import (
    COLOURS,
    HELD,
    MARKERS,
    NOISE,
    REFIT,
    SAMPLES,
    above,
    column,
    in_sigmas,
    spelt,
    titled,
)
from needle_rig.numerics import Array
from needle_rig.units import deg
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.misfit import Misfit, modelled
from needle_rig.workbench.learning.places import scale_of
from needle_rig.workbench.observations.noise import variance
from needle_rig.workbench.selection.answer import SIGMAS_95

DOTS_PER_INCH = 300
"""As journals ask."""
MOST_LAGS = 30


def loop(found: TraceComparison) -> Figure:
    """Torque against the base angle in the worst trial: the hysteresis loop, measured and modelled."""
    t = found.worst_trials()[0]
    given, binned = found.baseline.dataset.trials[t], found.baseline.problem.trials[t]
    factor, unit = scale_of(0)
    figure, (axis,) = column(2.9)
    base_deg = deg(given.trial.base_angle_rad)
    axis.plot(base_deg, factor * given.torque_nm, ms=2, **SAMPLES)
    drive_deg = deg(binned.trial.base_angle_rad)
    for name, of, look in _columns(found):
        torque_nm = modelled(found.baseline.problem, of.fit, t)[0]
        axis.plot(drive_deg, factor * torque_nm, label=name, **look)
    for line in (axis.axhline, axis.axvline):
        line(0.0, color="0.8", lw=0.6, zorder=0)
    axis.set_xlabel("base angle / °")
    axis.set_ylabel(f"base torque / {unit}")
    titled(axis, trial_title(found, t))
    above(figure, axis)
    return figure


def strips(found: TraceComparison) -> Figure:
    """The worst trial, each channel with a strip of its residuals in units of the noise below it.

    A strip's scale is even up to 3 σ, where its dotted lines are, and logarithmic beyond.
    """
    problem, t = found.baseline.problem, found.worst_trials()[0]
    given, binned = found.baseline.dataset.trials[t], problem.trials[t]
    names = _names(found)
    figure, axes = column(
        1.5 * len(names) + 0.5, 2 * len(names), sharex=True, height_ratios=[1.8, 1.4] * len(names)
    )
    data = np.vstack([given.torque_nm[None, :], given.hall_rad.T])
    for c, name in enumerate(names):
        factor, unit = scale_of(c)
        trace, strip = axes[2 * c], axes[2 * c + 1]
        trace.plot(given.trial.time_s, factor * data[c], ms=1.2, **SAMPLES)
        trace.set_ylabel(f"{spelt(name)} / {unit}")
        away = []
        for label, of, look in _columns(found):
            model = factor * modelled(problem, of.fit, t)[c]
            trace.plot(binned.trial.time_s, model, label=label, **look)
            away.append(problem.raw(of.fit.residuals)[t][c] / _noise(found, t)[c])
            strip.plot(binned.time_s, away[-1], marker=".", ms=2, **{**look, "lw": 0.5})
        in_sigmas(strip, *away)
    above(figure, axes[0])
    titled(axes[0], trial_title(found, t))
    axes[-1].set_xlabel("time / s")
    figure.align_ylabels(axes)
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
    """Quantiles of the whitened residuals beside those of the standard normal, with noise's 95 % band."""
    figure, (axis,) = column(3.1)
    sizes = []
    for c, (name, look) in enumerate(zip(_names(found), _looks(), strict=False)):
        values = np.sort(np.concatenate(_whitened(found, c)))
        if values.size:
            sizes.append(values.size)
            axis.plot(_quantiles(values.size), values, ls="", ms=2, label=spelt(name), **look)
    if sizes:
        rank = np.arange(1, min(sizes) + 1)
        low, high = (ndtri(betaincinv(rank, min(sizes) + 1 - rank, p)) for p in (0.025, 0.975))
        axis.fill_between(_quantiles(min(sizes)), low, high, color=NOISE, lw=0, zorder=0, label="noise, 95 %")
    ends = np.array([-4.0, 4.0])
    axis.plot(ends, ends, color="k", lw=0.6, zorder=1)
    axis.set_xlabel("standard normal quantile")
    axis.set_ylabel("whitened residual / σ")
    above(figure, axis)
    return figure


def autocorrelation(found: TraceComparison) -> Figure:
    """Autocorrelation of the whitened residuals within trials, with the 95 % band of noise alone."""
    figure, (axis,) = column(2.4)
    size = 0
    for c, (name, look) in enumerate(zip(_names(found), _looks(), strict=False)):
        trials = [values for values in _whitened(found, c) if values.size > MOST_LAGS]
        if trials:
            size = max(size, sum(values.size for values in trials))
            power = sum(float(values @ values) for values in trials)
            seen = [
                sum(float(v[: v.size - lag] @ v[lag:]) for v in trials) / power
                for lag in range(1, MOST_LAGS + 1)
            ]
            axis.plot(range(1, MOST_LAGS + 1), seen, ms=2.5, lw=0.7, label=spelt(name), **look)
    if size:
        half = SIGMAS_95 / np.sqrt(size)
        axis.axhspan(-half, half, color=NOISE, lw=0, zorder=0)
        above(figure, axis)
    axis.axhline(0.0, color="k", lw=0.6)
    axis.set_xlabel("lag / bins")
    axis.set_ylabel("autocorrelation")
    return figure


def band(found: TraceComparison) -> Figure:
    """The worst trial with the 95 % band of the refit: its values, a trial's own friction, and the noise."""
    problem, of, t = found.baseline.problem, found.baseline.current, found.worst_trials()[0]
    binned = problem.trials[t]
    root = np.linalg.cholesky(of.covariance + 1e-18 * np.eye(len(of.covariance)))
    directions = np.zeros((root.shape[0] + 1, root.shape[0] + 1))
    directions[:-1, :-1], directions[-1, -1] = root, of.scatter
    moved = problem.raw([j @ directions for j in of.jacobians])[t]
    left, noise = problem.raw(of.residuals)[t], _noise(found, t)
    names = _names(found)
    figure, axes = column(0.95 * len(names) + 0.7, len(names), sharex=True)
    for c, (axis, name) in enumerate(zip(axes, names, strict=True)):
        factor, unit = scale_of(c)
        model = factor * (binned.mean[c] - left[c])
        half = factor * SIGMAS_95 * np.sqrt((moved[c] ** 2).sum(axis=1) + noise[c] ** 2)
        axis.fill_between(
            binned.time_s, model - half, model + half, color=COLOURS[5], lw=0, label="predicted, 95 %"
        )
        axis.plot(
            binned.time_s, factor * binned.mean[c], ".", ms=1.2, color="0.2", label="measured, bin means"
        )
        axis.set_ylabel(f"{spelt(name)} / {unit}")
    above(figure, axes[0])
    titled(axes[0], trial_title(found, t))
    axes[-1].set_xlabel("time / s")
    figure.align_ylabels(axes)
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
    return function(what)(found)


def function(what: str) -> Callable[[TraceComparison], Figure]:
    """What draws the figure of this name. Raises BadInput."""
    if what not in FIGURES:
        raise BadInput(f"figure {what[:40]}: there are {', '.join(FIGURES)}")
    return FIGURES[what]


def asked(path: Path) -> str:
    """The figure that a file is named after. Raises BadInput for another name or ending."""
    if path.suffix not in FORMATS or path.stem not in FIGURES:
        raise BadInput(
            f"--figure {path}: name the file after a figure ({', '.join(FIGURES)}), ending in"
            f" {', '.join(FORMATS)}"
        )
    return path.stem


def described(found: TraceComparison, what: str) -> str:
    """What the figure of this name shows, in words, for those who do not see it. Raises BadInput."""
    said = " ".join((inspect.getdoc(function(what)) or what).split())
    of = found.baseline
    return f"{said} Data {of.dataset.name}, model {of.problem.base.name}."


def write_figure(found: TraceComparison, path: Path) -> None:
    """The figure that `path` is named after, in the format of its ending. Raises BadInput."""
    what = asked(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    title = {"Title": described(found, what)}
    drawn(found, what).savefig(path, dpi=DOTS_PER_INCH, metadata=title)


def _columns(found: TraceComparison) -> list[tuple[str, Misfit, dict[str, Any]]]:
    """Name, misfit and look of each column."""
    if found.held is None:
        return [("model, fitted", found.refit, HELD)]
    return [("model as it stands", found.held, HELD), ("refitted", found.refit, REFIT)]


def _looks() -> Iterator[dict[str, Any]]:
    """Colour and marker of one channel after another; the two part ways where colours come again."""
    for k in count():
        marker = MARKERS[(k + k // len(COLOURS)) % len(MARKERS)]
        yield {"color": COLOURS[k % len(COLOURS)], "marker": marker, "mew": 0.4}


def _quantiles(size: int) -> Array:
    """Of the standard normal, for `size` values in order."""
    return np.asarray(ndtri((np.arange(size) + 0.5) / size))


def _names(found: TraceComparison) -> tuple[str, ...]:
    return ("torque", *found.baseline.dataset.sensor_names)


def _noise(found: TraceComparison, trial: int) -> Array:
    """Standard deviation of each bin mean (C, K) of one trial by the noise alone; NaN without a reading."""
    problem = found.baseline.problem
    binned = problem.trials[trial]
    return np.sqrt([variance(problem.noise, binned, c) for c in range(len(binned.mean))])


def _whitened(found: TraceComparison, channel: int) -> list[Array]:
    """Whitened residuals of one channel, an array a trial."""
    return [
        r[w.channel == channel]
        for r, w in zip(found.shown.fit.residuals, found.baseline.problem.whiteners, strict=True)
    ]


def _scattered(found: TraceComparison, words: str, across: Callable[[int, int], Array]) -> Figure:
    """Whitened residuals by channel over what `across` says of the bins of a trial and channel."""
    problem, names = found.baseline.problem, _names(found)
    by_model = words == "model"
    figure, axes = column((1.3 if by_model else 1.05) * len(names) + 0.4, len(names), sharex=not by_model)
    for c, (axis, name) in enumerate(zip(axes, names, strict=True)):
        for t, (values, look) in enumerate(zip(_whitened(found, c), _looks(), strict=False)):
            axis.plot(across(t, c)[problem.whiteners[t].use[c]], values, ls="", ms=1.8, **look)
        axis.axhspan(-2.0, 2.0, color=NOISE, lw=0, zorder=0)
        axis.set_ylabel(f"{spelt(name)} / σ")
        if by_model:
            axis.set_xlabel(f"predicted {spelt(name)} / {scale_of(c)[1]}")
    if not by_model:
        axes[-1].set_xlabel(words)
    figure.align_ylabels(axes)
    return figure
