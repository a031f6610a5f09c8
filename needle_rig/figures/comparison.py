"""Pictures of a comparison: traces with their noise band, the map of residuals, pulls; one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.figures.figure import Figure, png
from needle_rig.figures.page import Picture, items, paragraph, row, shown, table, write_page
from needle_rig.figures.style import (
    COLOURS,
    HELD,
    LETTERS_PT,
    PAGE_IN,
    REFIT,
    SAMPLES,
    above,
    column,
    spelt,
    titled,
)
from needle_rig.workbench.learning.compare import TraceComparison
from needle_rig.workbench.learning.misfit import modelled
from needle_rig.workbench.learning.places import NOISE_LIMIT, motion_words, scale_of

SHOWN_TRIALS = 4
MAP_SIGMAS = (0.5, 100.0)
"""Ends of the map's colour scale, the same for all data, so that maps can be laid side by side."""
STATES = ("moving", "settled")
"""Of a motion, in their order in time."""
MOST_NUMBERED = 24
"""Columns of the map whose cells have room for a number."""
MOST_MOTIONS = 36
"""Names that have room below the map, upright."""
MOST_LETTERS = 90
"""Of these names in one line."""
SHOWN_SAMPLES = 2000
"""Samples of a trace that are drawn, at most twice as many: more than a picture has dots across."""


def traces(found: TraceComparison) -> Figure:
    """Measured and modelled traces with the ±2σ noise band, the worst trial first, few of all."""
    problem, shown = found.baseline.problem, found.worst_trials()[:SHOWN_TRIALS]
    names = ("torque", *found.baseline.dataset.sensor_names)
    width, height = 4.0 * len(shown), 1.7 * len(names) + 1.25
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(len(names), len(shown), squeeze=False, sharex="col")
    # margins in inches: a layout engine would draw everything once more to find them
    figure.subplots_adjust(
        left=0.9 / width,
        right=1 - 0.1 / width,
        bottom=0.5 / height,
        top=1 - 0.9 / height,
        wspace=0.2,
        hspace=0.12,
    )
    for k, t in enumerate(shown):
        given = found.baseline.dataset.trials[t]
        binned = problem.trials[t]
        model = modelled(problem, found.shown.fit, t)
        again = None if found.held is None else modelled(problem, found.refit.fit, t)
        data = np.vstack([given.torque_nm[None, :], given.hall_rad.T])
        thin = max(1, given.trial.time_s.size // SHOWN_SAMPLES)
        for c, name in enumerate(names):
            factor, unit = scale_of(c)
            noise = factor * float(problem.noise.within_trial[c])
            axis = axes[c, k]
            axis.plot(given.trial.time_s[::thin], factor * data[c][::thin], ms=1.5, **SAMPLES)
            axis.plot(
                binned.trial.time_s,
                factor * model[c],
                label="model" if again is None else "model as it stands",
                **HELD,
            )
            if again is not None:
                axis.plot(
                    binned.trial.time_s,
                    factor * again[c],
                    label="refitted",
                    **REFIT,
                )
            axis.fill_between(
                binned.trial.time_s,
                factor * model[c] - 2 * noise,
                factor * model[c] + 2 * noise,
                color=HELD["color"],
                alpha=0.2,
                lw=0,
                label="±2σ of the noise",
            )
            if c:
                axis.plot(
                    binned.trial.time_s,
                    np.degrees(binned.trial.base_angle_rad),
                    color="0.8",
                    lw=0.6,
                    zorder=0,
                    label="base",
                )
            if k == 0:
                axis.set_ylabel(f"{spelt(name)} / {unit}")
            if c == 0:
                axis.set_title(f"{trial_title(found, t)}\n{_how_bad(found, t)}", fontsize=8)
        axes[-1, k].set_xlabel("time / s")
    figure.legend(
        *axes[-1, 0].get_legend_handles_labels(),
        loc="upper center",
        bbox_to_anchor=(0.5, 1 - 0.26 / height),
        ncols=5,
        fontsize=8,
        frameon=False,
        markerscale=3,
    )
    name, count, of = found.baseline.dataset.name, len(shown), len(problem.trials)
    hidden = f"; {of - count} left out" if of > count else ""
    figure.suptitle(f"{name}: {count} of {of} trials, those of the worst places first{hidden}", fontsize=9)
    figure.align_ylabels(axes[:, 0])
    return figure


def residual_map(found: TraceComparison) -> Figure:
    """Error in units of the noise, channel by motion and state, all directions; one scale for all data."""
    from matplotlib.colors import LogNorm

    places = found.shown.places
    names = list(dict.fromkeys(p.channel for p in places))
    motions = list(dict.fromkeys((p.motion, p.direction) for p in places))
    seen = {(p.motion, p.direction, p.state) for p in places}
    columns = [(*motion, state) for motion in motions for state in STATES if (*motion, state) in seen]
    values = np.full((len(names), len(columns)), np.nan)
    for place in places:
        values[names.index(place.channel), columns.index((place.motion, place.direction, place.state))] = (
            place.sigmas
        )
    figure = Figure(figsize=(PAGE_IN, 0.35 * len(names) + 2.0), layout="constrained")
    axis = figure.subplots()
    low, top = MAP_SIGMAS
    image = axis.imshow(
        np.clip(values, low, top), cmap="magma_r", norm=LogNorm(low, top), aspect="auto", interpolation="none"
    )
    titled(axis, " ".join(found.headline()).split(":")[0])
    axis.set_yticks(range(len(names)), [spelt(n) for n in names], fontsize=LETTERS_PT)
    _motions_below(axis, columns)
    if len(columns) <= MOST_NUMBERED:
        for i in range(len(names)):
            for j in range(len(columns)):
                if np.isfinite(values[i, j]):
                    dark = values[i, j] > np.sqrt(low * top)
                    axis.text(
                        j,
                        i,
                        f"{values[i, j]:.0f}",
                        ha="center",
                        va="center",
                        fontsize=LETTERS_PT,
                        color="w" if dark else "k",
                    )
    bar = figure.colorbar(image, extend="both", pad=0.01, aspect=15)
    bar.set_label("error / σ of the noise", size=LETTERS_PT)
    bar.set_ticks([1.0, NOISE_LIMIT, 10.0, 30.0, 100.0], labels=["1", "3", "10", "30", "100"])
    bar.ax.tick_params(labelsize=LETTERS_PT)
    bar.ax.axhline(NOISE_LIMIT, color=COLOURS[5], lw=2)
    return figure


def _motions_below(axis: Any, columns: Sequence[tuple[str, str, str]]) -> None:
    """A name below the columns of each motion, as many as have room, and a line between two motions."""
    arrows = {"up": " ↑", "down": " ↓", "": ""}
    groups: dict[tuple[str, str], list[int]] = {}
    for k, (motion, direction, _) in enumerate(columns):
        groups.setdefault((motion, direction), []).append(k)
    step = -(-len(groups) // MOST_MOTIONS)
    told = list(groups.items())[::step]
    words = [motion_words(motion) + arrows[direction] for (motion, direction), _ in told]
    upright = len(words) * max(map(len, words), default=0) > MOST_LETTERS
    axis.set_xticks(
        [float(np.mean(where)) for _, where in told],
        words,
        rotation=90 if upright else 0,
        fontsize=LETTERS_PT,
    )
    if step == 1:
        ends = [where[0] - 0.5 for where in list(groups.values())[1:]]
        axis.vlines(ends, *axis.get_ylim(), color="w", lw=0.5)
    axis.set_xlabel(
        "motion and direction of the base; moving on the left, settled on the right", size=LETTERS_PT
    )


def pulls(found: TraceComparison) -> Figure:
    """Histogram of the whitened residuals beside the standard normal."""
    values = np.concatenate(found.shown.fit.residuals)
    figure, (axis,) = column(2.3)
    edges = np.linspace(-6, 6, 61)
    outside = float(np.mean(np.abs(values) > 6))
    axis.hist(
        np.clip(values, -5.99, 5.99), edges.tolist(), density=True, color="0.75", label="residual / noise"
    )
    axis.plot(
        edges, np.exp(-(edges**2) / 2) / np.sqrt(2 * np.pi), color=COLOURS[0], lw=1.2, label="noise alone"
    )
    axis.set_xlabel("whitened residual / σ")
    axis.set_yticks([])
    titled(axis, f"{100 * outside:.1f} % lie outside ±6 σ")
    above(figure, axis)
    return figure


def _how_bad(found: TraceComparison, trial: int) -> str:
    """What `worst_trials` orders by: the worst place of a trial, then its error over all."""
    file = found.baseline.problem.trials[trial].file
    worst = max((place.sigmas for place in found.shown.places if place.trial == file), default=None)
    place = "" if worst is None else f"worst place {worst:.0f} σ; "
    return f"{place}over all {found.shown.trial_errors[trial]:.3g} × the noise"


def trial_title(found: TraceComparison, trial: int) -> str:
    """File and command of a trial."""
    given = found.baseline.dataset.trials[trial]
    return f"{Path(given.file).name}, {_title(given.command)}"


def _title(command: object) -> str:
    steps = getattr(command, "steps_deg", ())
    target = getattr(command, "target_deg", None)
    kind = getattr(command, "kind", "trial")
    speed = getattr(command, "speed_deg_s", None)
    goal = f"{len(steps)} steps" if steps else "" if target is None else f"to {target:g}°"
    return " ".join(p for p in (str(kind), goal, f"at {speed:g}°/s" if speed else "") if p).replace("-", "−")


def pictures(found: TraceComparison) -> tuple[Picture, ...]:
    """The three pictures of a comparison."""
    return (
        Picture("traces", "Measured and modelled", png(traces(found))),
        Picture("residuals", "Where it fails: error over noise", png(residual_map(found))),
        Picture("pulls", "Pulls", png(pulls(found))),
    )


def write_html(found: TraceComparison, drawn: Sequence[Picture], path: Path) -> None:
    """One self-contained file: the numbers in words and tables, and the pictures."""
    name, said = found.headline()
    headings, rows = found.rows()
    worst = [f"{p.words} ({p.sigmas:.0f} × the noise)" for p in found.shown.worst]
    write_page(
        path,
        f"{name} against the model {found.baseline.problem.base.name}",
        (
            paragraph(f"{name} {said}."),
            table(headings, [row(first, cells) for first, *cells in rows]),
            items("Values", found.value_sentences()),
            items("Worst places", worst or ["none above 3 × the noise"]),
            *map(shown, drawn),
            items("Notes", found.notes),
        ),
    )
