"""A chart of the page, drawn for print: the same lines, bands and units, in the width of a column."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from needle_rig.figures.style import COLOURS, NOISE, above, column
from needle_rig.numerics import Array

HEIGHT_IN = 2.2
LOOKS: Mapping[str, dict[str, Any]] = {
    "line": {"lw": 0.9},
    "dashed": {"lw": 0.9, "ls": "--"},
    "dots": {"ls": "", "marker": ".", "ms": 1.5},
}
Look = Literal["line", "dashed", "dots", "edge"]


@dataclass(frozen=True)
class Line:
    """One series; an `edge` bounds a band, and is not drawn itself. NaN interrupts it."""

    label: str
    look: Look
    x: Array
    y: Array


def write_chart(
    path: Path,
    title: str,
    axes: tuple[str, str],
    lines: Sequence[Line],
    bands: Sequence[tuple[int, int]] = (),
    level: float | None = None,
) -> Path:
    """Draw it at `path`, in the format of its ending.

    `axes` are the labels of x and y with their units, `bands` pairs of lines by number, `level` shades from
    −level to +level.
    """
    figure, (axis,) = column(HEIGHT_IN)
    if level is not None:
        axis.axhspan(-level, level, color=NOISE, lw=0, zorder=0)
    for upper, lower in bands:
        axis.fill_between(lines[upper].x, lines[lower].y, lines[upper].y, color=NOISE, lw=0, zorder=0)
    drawn = [line for line in lines if line.look != "edge"]
    for k, line in enumerate(drawn):
        colour = COLOURS[k % len(COLOURS)]
        axis.plot(line.x, line.y, color=colour, label=_plain(line.label), **LOOKS[line.look])
    axis.set_xlabel(_plain(axes[0]))
    axis.set_ylabel(_plain(axes[1]))
    if drawn:
        above(figure, axis)
    figure.savefig(path, metadata={"Title": title})
    return path


def values(given: Sequence[float | None]) -> Array:
    """Numbers of a document (samples,), where None is a gap."""
    return np.array([np.nan if value is None else value for value in given], dtype=float)


def _plain(text: str) -> str:
    """Text as it stands: a dollar sign begins no formula, an underscore hides nothing from the legend."""
    return text.replace("$", r"\$").lstrip("_")
