"""Figures 3, 4, 6 and 7 of the paper by the model: angle and torque along the needle; a page of it all."""

from __future__ import annotations

import base64
import html
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT
from needle_rig.physics.rod import Layout
from needle_rig.units import deg, mm, nmm
from needle_rig.workbench.reproduce import STANDARD_ERROR_DEG, Reproduction, Row
from needle_rig.workbench.states import SettledState

# Okabe and Ito's palette: told apart by people with colour-blindness and in grey.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00")
TISSUE = "#EFEDE6"


@dataclass(frozen=True)
class Line:
    """One settled state in a figure."""

    state: SettledState
    label: str
    colour: str
    style: str = "-"


@dataclass(frozen=True)
class Picture:
    """One figure: its lines, and what the paper measured, as (position, angle, label)."""

    name: str
    title: str
    layout: Layout
    lines: tuple[Line, ...]
    measured: tuple[tuple[float, float, str], ...] = ()
    target_deg: float = 45.0


def pictures(runs: Reproduction) -> tuple[Picture, ...]:
    """The four figures."""
    turned, zero, at_tip = runs.relaxed[0], runs.relaxed[-1], runs.base_at_tip[-1]
    motions = (
        ("θd", "-"),
        ("θd + lag", "-"),
        ("θd − 0.75 lag", "-"),
        ("θd + 0.25 lag", "-"),
        ("θd again: the result", "-"),
    )
    tip = EXPERIMENT_LAYOUT.sensor_positions_m[-1]
    first = (tip, 45.0 - 26.0, "measured: 26° behind")
    return (
        Picture(
            "figure_3",
            "Figure 3: one turn to 45°, and two ways back (figure_3)",
            MODEL_LAYOUT,
            (
                Line(turned, "base at 45°", COLOURS[0]),
                Line(zero, "turned back to zero torque", COLOURS[1]),
                Line(at_tip, "turned back to the tip's angle", COLOURS[2]),
            ),
            ((MODEL_LAYOUT.needle_length_m, 33.0, "paper: tip at 33°"),),
        ),
        Picture(
            "figure_4",
            "Figure 4: the sequence in the simulation's layout (figure_3)",
            MODEL_LAYOUT,
            tuple(
                Line(state, f"{k}. {label}", COLOURS[k - 1], style)
                for k, (state, (label, style)) in enumerate(zip(runs.sequence, motions, strict=True), start=1)
            ),
        ),
        Picture(
            "figure_6",
            "Figure 6: first motion and end of the sequence, in the experiment's layout",
            EXPERIMENT_LAYOUT,
            (
                Line(runs.elastic[0], "first motion, elastic tissue", COLOURS[0]),
                Line(runs.elastic[-1], "end of the sequence, elastic tissue", COLOURS[1]),
                Line(runs.rigid[-1], "end of the sequence, rigid tissue", COLOURS[2], "--"),
            ),
            (first, (tip, 45.0 - 12.0, "measured: 12° behind")),
        ),
        Picture(
            "figure_7",
            "Figure 7: the first correction 12° further, in the experiment's layout",
            EXPERIMENT_LAYOUT,
            (
                Line(runs.elastic[0], "first motion, elastic tissue", COLOURS[0]),
                Line(runs.elastic_extra[-1], "end, 12° further, elastic tissue", COLOURS[1]),
                Line(runs.stiff_extra[-1], "end, 12° further, stiff needle", COLOURS[3], "--"),
            ),
            (first, (tip, 45.0 - 3.0, "measured: 3° behind")),
        ),
    )


def draw(picture: Picture) -> Figure:
    """Angle above, torque below, against the place along the needle; tissue shaded."""
    figure = Figure(figsize=(7.6, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    figure.suptitle(picture.title, fontsize=11, x=0.02, ha="left")
    for axes in (above, below):
        _shade(axes, picture.layout)
        axes.grid(axis="y", color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        axes.tick_params(labelsize=9)
    for number, line in enumerate(picture.lines):
        state = line.state
        place = mm(state.position_m)
        style: dict[str, Any] = {
            "color": line.colour,
            "linestyle": line.style,
            "linewidth": 3.2 - 0.45 * number,
        }
        above.plot(place, deg(state.angle_rad), label=line.label, **style)
        below.stairs(nmm(state.internal_torque_nm), place, baseline=None, **style)
    above.axhline(picture.target_deg, color="#555555", linewidth=0.8, linestyle=":")
    below.axhline(0.0, color="#555555", linewidth=0.8, linestyle=":")
    for number, (position, angle_deg, label) in enumerate(picture.measured):
        above.errorbar(
            [mm(position)],
            [angle_deg],
            yerr=None if picture.layout == MODEL_LAYOUT else [STANDARD_ERROR_DEG],
            fmt="os"[number % 2],
            color="black",
            markersize=5,
            capsize=3,
            linewidth=1.2,
            label=label,
            zorder=5,
        )
    above.set_ylabel("angle, °", fontsize=9)
    below.set_ylabel("torque in the needle, N·mm", fontsize=9)
    below.set_xlabel("distance from the base, mm", fontsize=9)
    below.set_xlim(0, mm(picture.layout.needle_length_m) * 1.015)
    low, high = above.get_ylim()
    above.set_ylim(low - 0.02 * (high - low), high)
    above.text(
        1.005,
        picture.target_deg,
        "target",
        transform=above.get_yaxis_transform(),
        fontsize=8,
        color="#555555",
        va="center",
    )
    figure.legend(
        *above.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=8.5, frameon=False
    )
    return figure


def write_pngs(runs: Reproduction, folder: Path) -> list[Path]:
    """The four figures as PNG files in `folder`, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    written = []
    for picture in pictures(runs):
        path = folder / f"{picture.name}.png"
        draw(picture).savefig(path, dpi=130)
        written.append(path)
    return written


def write_page(runs: Reproduction, rows: tuple[Row, ...], path: Path) -> None:
    """One HTML file with the table and the figures inside."""
    cells = []
    for row in rows:
        mark = "yes" if row.within else "no"
        reason = "" if row.within else html.escape(row.reason)
        numbers = "".join(f"<td>{_number(v)}</td>" for v in (row.paper, row.ours, row.difference))
        cells.append(
            f'<tr class="{mark}"><th>{html.escape(row.name)}</th>{numbers}<td>{row.unit}</td>'
            f"<td>{row.parameters}</td><td>{mark}</td><td>{reason}</td></tr>"
        )
    images = []
    for picture in pictures(runs):
        buffer = io.BytesIO()
        draw(picture).savefig(buffer, format="png", dpi=130)
        data = base64.b64encode(buffer.getvalue()).decode("ascii")
        images.append(f'<img alt="{html.escape(picture.title)}" src="data:image/png;base64,{data}">')
    path.write_text(
        _PAGE.format(rows="\n".join(cells), images="\n".join(images), error=STANDARD_ERROR_DEG),
        encoding="utf-8",
    )


def _shade(axes: Axes, layout: Layout) -> None:
    for start, stop in layout.tissue_sections_m:
        axes.axvspan(mm(start), mm(stop), color=TISSUE, linewidth=0, zorder=0)


def _number(value: float) -> str:
    return f"{np.round(value, 4) + 0.0:.4g}"


_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>The paper's results beside ours</title>
<style>
body {{ font: 15px/1.45 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto;
       padding: 0 1rem; color: #222 }}
table {{ border-collapse: collapse; margin: 1rem 0; font-size: 14px }}
th, td {{ padding: .3rem .6rem; border-bottom: 1px solid #ddd; vertical-align: top; text-align: left }}
td:nth-child(2), td:nth-child(3), td:nth-child(4) {{ text-align: right; font-variant-numeric: tabular-nums }}
tbody th {{ font-weight: 400 }}
tr.no td:nth-child(7) {{ color: #b3400a; font-weight: 600 }}
tr.yes td:nth-child(7) {{ color: #14713f; font-weight: 600 }}
img {{ max-width: 100%; margin: 1rem 0; border: 1px solid #e5e5e5 }}
</style>
<h1>The paper's results beside ours</h1>
<p>K. B. Reed, <i>Compensating for Torsion Windup in Steerable Needles</i>, BioRob 2008. A row is within when
it differs by no more than the paper's standard error of {error}°, or the torque whose lag that is; equations
are held to the digits that the paper prints.</p>
<table><thead><tr><th>result</th><th>paper</th><th>ours</th><th>difference</th><th>unit</th><th>parameters</th>
<th>within</th><th>why not</th></tr></thead><tbody>
{rows}
</tbody></table>
{images}
</html>
"""
