"""Figures 3, 4, 6 and 7 of the paper by the model: angle and torque along the needle; a page of it all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TypedDict

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needle_rig.figures.figure import Figure, png
from needle_rig.figures.page import Picture, paragraph, row, shown, table, write_page
from needle_rig.figures.style import COLOURS
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT
from needle_rig.numerics import Array
from needle_rig.physics.rod import Layout
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import deg, mm, nmm
from needle_rig.workbench.paper.reproduce import STANDARD_ERROR_DEG, Reproduction, Row

TISSUE = "#EFEDE6"
_LONG_MM = 5.0


@dataclass(frozen=True)
class Line:
    """A settled needle in a figure."""

    needle: SettledNeedle
    label: str
    colour: str
    style: str = "-"


class _Style(TypedDict):
    color: str
    linestyle: str
    linewidth: float


@dataclass(frozen=True)
class Plot:
    """One figure: its lines, and what the paper measured, as (position, angle, label)."""

    name: str
    title: str
    layout: Layout
    lines: tuple[Line, ...]
    measured: tuple[tuple[float, float, str], ...] = ()
    target_deg: float = 45.0


def plots(runs: Reproduction) -> tuple[Plot, ...]:
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
        Plot(
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
        Plot(
            "figure_4",
            "Figure 4: the sequence in the simulation's layout (figure_3)",
            MODEL_LAYOUT,
            tuple(
                Line(needle, f"{k}. {label}", COLOURS[k - 1], style)
                for k, (needle, (label, style)) in enumerate(
                    zip(runs.sequence, motions, strict=True), start=1
                )
            ),
        ),
        Plot(
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
        Plot(
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


def draw(picture: Plot) -> Figure:
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
        needle = line.needle
        place = mm(needle.position_m)
        style: _Style = {
            "color": line.colour,
            "linestyle": line.style,
            "linewidth": 3.2 - 0.45 * number,
        }
        above.plot(place, deg(needle.angle_rad), label=line.label, **style)
        below.plot(*_torque_nmm(needle), **style)
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
    above.set_ylabel("angle / °", fontsize=9)
    below.set_ylabel("torque in the needle / N·mm", fontsize=9)
    below.set_xlabel("distance from the base / mm", fontsize=9)
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


def drawn(runs: Reproduction) -> list[Picture]:
    """The four figures as PNG."""
    return [Picture(plot.name, plot.title, png(draw(plot), dpi=130)) for plot in plots(runs)]


def write_paper_page(runs: Reproduction, rows: tuple[Row, ...], path: Path) -> None:
    """One HTML file with the table and the figures inside."""
    beside = [
        row(
            one.name,
            (
                *(float(np.round(v, 4)) for v in (one.paper, one.ours, one.difference)),
                one.unit,
                one.parameters,
                "yes" if one.within else "no",
                "" if one.within else one.reason,
            ),
            mark=one.within,
        )
        for one in rows
    ]
    head = ("result", "paper", "ours", "difference", "unit", "parameters", "within", "why not")
    told = (
        "K. B. Reed, Compensating for Torsion Windup in Steerable Needles, BioRob 2008. A row is within when"
        f" it differs by no more than the paper's standard error of {STANDARD_ERROR_DEG}°, or the torque"
        " whose lag that is; equations are held to the digits that the paper prints."
    )
    blocks = (paragraph(told), table(head, beside), *map(shown, drawn(runs)))
    write_page(path, "The paper's results beside ours", blocks)


def _torque_nmm(needle: SettledNeedle) -> tuple[Array, Array]:
    """Places / mm and torque / N·mm there: in the middle of an element, at both ends of a long, free one."""
    place, torque = mm(needle.position_m), nmm(needle.internal_torque_nm)
    start, end = place[:-1], place[1:]
    long = end - start > _LONG_MM
    at = np.concatenate([(start + end)[~long] / 2.0, start[long], end[long]])
    order = np.argsort(at)
    return at[order], np.concatenate([torque[~long], torque[long], torque[long]])[order]


def _shade(axes: Axes, layout: Layout) -> None:
    for start, stop in layout.tissue_sections_m:
        axes.axvspan(mm(start), mm(stop), color=TISSUE, linewidth=0, zorder=0)
