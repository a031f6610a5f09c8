"""Pictures of a comparison: traces with their noise band, the map of what is left, pulls; one HTML file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from needle_rig.figures.page import Picture, items, paragraph, png, row, shown, table, write_page
from needle_rig.workbench.learning.compare import TraceComparison, motion_words, scale_of

SHOWN_TRIALS = 4
SHOWN_SAMPLES = 2000
"""Samples of a trace that are drawn, at most twice as many: more than a picture has dots across."""


def traces(found: TraceComparison) -> Figure:
    """Measured and modelled traces of one trial of each command (at most four), with the ±2σ noise band."""
    problem, fit = found.baseline.problem, found.baseline.current
    shown = [group[0] for group in problem.groups][:SHOWN_TRIALS]
    names = ("torque", *found.baseline.dataset.sensor_names)
    width, height = 4.0 * len(shown), 1.7 * len(names) + 0.6
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(len(names), len(shown), squeeze=False, sharex="col")
    # margins in inches: a layout engine would draw everything once more to find them
    figure.subplots_adjust(
        left=0.9 / width,
        right=1 - 0.1 / width,
        bottom=0.5 / height,
        top=1 - 0.3 / height,
        wspace=0.2,
        hspace=0.12,
    )
    for column, t in enumerate(shown):
        given = found.baseline.dataset.trials[t]
        binned = problem.trials[t]
        reading = problem.model(fit.parameters, fit.vector, t).predict(binned.trial)
        model = np.vstack([reading.torque_nm[None, :], reading.hall_rad.T])
        data = np.vstack([given.torque_nm[None, :], given.hall_rad.T])
        thin = max(1, given.trial.time_s.size // SHOWN_SAMPLES)
        for c, name in enumerate(names):
            factor, unit = scale_of(c)
            noise = factor * float(np.hypot(problem.noise.white[c], problem.noise.correlated[c]))
            axis = axes[c, column]
            axis.plot(
                given.trial.time_s[::thin],
                factor * data[c][::thin],
                ".",
                ms=1.5,
                color="0.5",
                label="measured",
            )
            axis.plot(binned.trial.time_s, factor * model[c], color="tab:red", lw=1.0, label="model")
            axis.fill_between(
                binned.trial.time_s,
                factor * model[c] - 2 * noise,
                factor * model[c] + 2 * noise,
                color="tab:red",
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
                )
            if column == 0:
                axis.set_ylabel(f"{name} / {unit}")
            if c == 0:
                axis.set_title(_title(given.command), fontsize=9)
        axes[-1, column].set_xlabel("time / s")
    axes[0, 0].legend(fontsize=7, loc="upper right")
    figure.align_ylabels(axes[:, 0])
    return figure


def residual_map(found: TraceComparison) -> Figure:
    """Error in units of the noise, channel by motion and state, all directions."""
    from matplotlib.colors import LogNorm

    names = list(dict.fromkeys(p.channel for p in found.every_place))
    columns = list(dict.fromkeys((p.motion, p.direction, p.state) for p in found.every_place))
    values = np.full((len(names), len(columns)), np.nan)
    for place in found.every_place:
        values[names.index(place.channel), columns.index((place.motion, place.direction, place.state))] = (
            place.sigmas
        )
    figure = Figure(
        figsize=(max(6.0, 0.34 * len(columns) + 2.0), 0.45 * len(names) + 2.2), layout="constrained"
    )
    axis = figure.subplots()
    top = max(30.0, float(np.nanmax(values)))
    image = axis.imshow(np.clip(values, 0.5, None), cmap="magma_r", norm=LogNorm(0.5, top), aspect="auto")
    axis.set_yticks(range(len(names)), names)
    arrows = {"up": "↑", "down": "↓", "": ""}
    labels = [
        f"{motion_words(m)}{arrows[w]} {'moving' if s == 'moving' else 'settled'}" for m, w, s in columns
    ]
    axis.set_xticks(range(len(columns)), labels, rotation=90, fontsize=7)
    if len(columns) <= 24:
        for i in range(len(names)):
            for j in range(len(columns)):
                if np.isfinite(values[i, j]):
                    dark = values[i, j] > np.sqrt(top * 0.5)
                    axis.text(
                        j,
                        i,
                        f"{values[i, j]:.0f}",
                        ha="center",
                        va="center",
                        fontsize=6,
                        color="w" if dark else "k",
                    )
    figure.colorbar(image, label="error / noise")
    return figure


def pulls(found: TraceComparison) -> Figure:
    """Histogram of the whitened residuals beside the standard normal."""
    values = np.concatenate(found.baseline.current.residuals)
    figure = Figure(figsize=(5.0, 3.2), layout="constrained")
    axis = figure.subplots()
    edges = np.linspace(-6, 6, 61)
    outside = float(np.mean(np.abs(values) > 6))
    axis.hist(
        np.clip(values, -5.99, 5.99), edges.tolist(), density=True, color="0.7", label="residual / noise"
    )
    axis.plot(edges, np.exp(-(edges**2) / 2) / np.sqrt(2 * np.pi), color="tab:red", label="noise alone")
    axis.set_xlabel("whitened residual")
    axis.set_yticks([])
    axis.legend(fontsize=8)
    axis.set_title(f"{100 * outside:.1f} % lie outside ±6", fontsize=9)
    return figure


def _title(command: object) -> str:
    steps = getattr(command, "steps_deg", ())
    target = getattr(command, "target_deg", None)
    kind = getattr(command, "kind", "trial")
    speed = getattr(command, "speed_deg_s", None)
    goal = f"{len(steps)} steps" if steps else "" if target is None else f"to {target:g}°"
    return " ".join(p for p in (str(kind), goal, f"at {speed:g}°/s" if speed else "") if p)


def pictures(found: TraceComparison) -> tuple[Picture, ...]:
    """The three pictures of a comparison."""
    return (
        Picture("traces", "Measured and modelled", png(traces(found))),
        Picture("residuals", "Where it fails: error over noise", png(residual_map(found))),
        Picture("pulls", "Pulls", png(pulls(found))),
    )


def write_html(found: TraceComparison, drawn: Sequence[Picture], path: Path) -> None:
    """One self-contained file: the numbers in words and tables, and the three pictures."""
    left_out = f"{found.held_out_error:.2f}" if np.isfinite(found.held_out_error) else "—"
    channels = [
        row(name, (f"{v['rmse']} {v['unit']}", f"{v['noise']} {v['unit']}", str(v["whitened"])))
        for name, v in found.channels.items()
    ]
    worst = [f"{p.words} ({p.sigmas:.0f} × the noise)" for p in found.worst]
    write_page(
        path,
        f"{found.baseline.dataset.name} against the model {found.baseline.problem.base.name}",
        (
            paragraph(
                f"Error on commands left out: {left_out} in units of the noise (noise alone: 1.00);"
                f" reduced χ² {found.reduced_chi2:.2f}."
            ),
            table(("channel", "rmse", "noise", "in units of the noise"), channels),
            items("Worst places", worst or ["none above 3 × the noise"]),
            *map(shown, drawn),
            items("Notes", found.notes),
        ),
    )
