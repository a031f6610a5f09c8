"""Pictures of a comparison: traces with their noise band, the map of what is left, pulls; one HTML file."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from needle_rig.workbench.compare import Comparison, motion_words, scale_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

SHOWN_TRIALS = 4
SHOWN_SAMPLES = 2000
"""Samples of a trace that are drawn, at most twice as many: more than a picture has dots across."""


def traces(found: Comparison) -> Figure:
    """Measured and modelled traces of one trial of each command (at most four), with the ±2σ noise band."""
    from matplotlib.figure import Figure

    problem, fit = found.prepared.problem, found.prepared.present
    shown = [group[0] for group in problem.groups][:SHOWN_TRIALS]
    names = ("torque", *found.prepared.dataset.sensor_names)
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
        given = found.prepared.dataset.trials[t]
        binned = problem.trials[t]
        reading = problem.model(fit.axes, fit.point, t).predict(binned.trial)
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


def residual_map(found: Comparison) -> Figure:
    """Error in units of the noise, channel by motion and state, all directions."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    names = list(dict.fromkeys(p.channel for p in found.places))
    columns = list(dict.fromkeys((p.motion, p.direction, p.state) for p in found.places))
    values = np.full((len(names), len(columns)), np.nan)
    for place in found.places:
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


def pulls(found: Comparison) -> Figure:
    """Histogram of the whitened residuals beside the standard normal."""
    from matplotlib.figure import Figure

    values = np.concatenate(found.prepared.present.residuals)
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


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return buffer.getvalue()


def _text(data: bytes) -> str:
    return base64.b64encode(data).decode()


@dataclass(frozen=True)
class Picture:
    """A drawn picture."""

    name: str
    title: str
    png: bytes


def pictures(found: Comparison) -> tuple[Picture, ...]:
    """The three pictures of a comparison."""
    return (
        Picture("traces", "Measured and modelled", png(traces(found))),
        Picture("residuals", "Where it fails: error over noise", png(residual_map(found))),
        Picture("pulls", "Pulls", png(pulls(found))),
    )


def write_pngs(drawn: Sequence[Picture], folder: Path) -> list[Path]:
    """traces.png, residuals.png and pulls.png in `folder`, which is made when missing."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for picture in drawn:
        path = folder / f"{picture.name}.png"
        path.write_bytes(picture.png)
        written.append(path)
    return written


def write_html(found: Comparison, drawn: Sequence[Picture], path: Path) -> None:
    """One self-contained file: the numbers in words and tables, and the three pictures."""
    name = html.escape(found.prepared.dataset.name)
    rows = "".join(
        f"<tr><td>{html.escape(c)}</td><td>{v['rmse']} {v['unit']}</td><td>{v['noise']} {v['unit']}</td>"
        f"<td>{v['whitened']}</td></tr>"
        for c, v in found.channels.items()
    )
    worst = "".join(f"<li>{html.escape(p.words)} ({p.sigmas:.0f} × the noise)</li>" for p in found.worst)
    images = "".join(
        f'<h2>{p.title}</h2><img alt="{p.title}" src="data:image/png;base64,{_text(p.png)}">' for p in drawn
    )
    notes = "".join(
        f"<li>{html.escape(n)}</li>" for n in (*found.prepared.dataset.notes, *found.prepared.notes)
    )
    left_out = f"{found.held_out_error:.2f}" if np.isfinite(found.held_out_error) else "—"
    path.write_text(
        f"""<!doctype html><html lang="en"><meta charset="utf-8"><title>{name}</title>
<style>body{{font:15px/1.5 system-ui,sans-serif;max-width:80rem;margin:2rem auto;padding:0 1rem}}
td,th{{text-align:left;padding:.15rem 1rem .15rem 0}}img{{max-width:100%}}</style>
<h1>{name} against the model {html.escape(found.prepared.problem.base.name)}</h1>
<p>Error on commands left out: {left_out} in units of the noise (noise alone: 1.00);
reduced χ² {found.reduced_chi2:.2f}.</p>
<table><tr><th>channel</th><th>rmse</th><th>noise</th><th>in units of the noise</th></tr>{rows}</table>
<h2>Worst places</h2><ul>{worst or "<li>none above 3 × the noise</li>"}</ul>{images}
{"<h2>Notes</h2><ul>" + notes + "</ul>" if notes else ""}</html>
""",
        encoding="utf-8",
    )
