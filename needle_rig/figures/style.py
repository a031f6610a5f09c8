"""What figures for print share: the width of a column, letters, and colours that stay apart without hue."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.ticker import FuncFormatter, MaxNLocator, NullLocator

from needle_rig.figures.figure import Figure

COLUMN_IN = 85.0 / 25.4
"""One column of a journal with two."""
PAGE_IN = 178.0 / 25.4
"""Both columns."""
LETTERS_PT = 7.0
"""The smallest letters that journals print."""
MOST_TICKS = 7
"""Across a column, so that their numbers stand apart."""
# Okabe and Ito's palette: told apart by people with colour-blindness.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
MARKERS = "osv^Dx+"
SAMPLES: dict[str, Any] = {"ls": "", "marker": ".", "color": "0.45", "label": "measured", "rasterized": True}
"""What was measured: thousands of dots, which a vector file would hold one by one."""
HELD: dict[str, Any] = {"color": COLOURS[1], "lw": 1.2}
REFIT: dict[str, Any] = {"color": COLOURS[0], "lw": 0.9, "ls": "--"}
"""The model as it stands, and refitted: they differ in grey as well."""
NOISE = "0.88"
"""Ground of what noise alone does."""
LIMIT_SIGMAS = 3.0
"""A scale in σ runs evenly to here, by decades beyond."""


def plain(axis: Any) -> Any:
    """An axis with small letters, without a frame at the top and on the right."""
    axis.spines[["top", "right"]].set_visible(False)
    axis.tick_params(labelsize=LETTERS_PT, width=0.6, length=2.5)
    axis.xaxis.set_major_locator(MaxNLocator(MOST_TICKS, steps=[1, 2, 2.5, 5, 10]))
    axis.xaxis.label.set_size(LETTERS_PT)
    axis.yaxis.label.set_size(LETTERS_PT)
    return axis


def titled(axis: Any, text: str) -> None:
    """A title in small letters over the axis' left end."""
    axis.set_title(text, loc="left", fontsize=LETTERS_PT)


def column(height_in: float, rows: int = 1, **more: Any) -> tuple[Figure, Sequence[Any]]:
    """A figure as wide as a column, with `rows` plain axes one below the other."""
    figure = Figure(figsize=(COLUMN_IN, height_in), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False, **more)[:, 0]
    for axis in axes:
        plain(axis)
    return figure, list(axes)


def above(figure: Figure, axis: Any, columns: int = 3) -> None:
    """The legend of `axis` over the figure, where it hides nothing."""
    figure.legend(
        *axis.get_legend_handles_labels(),
        loc="outside upper center",
        ncols=columns,
        fontsize=LETTERS_PT,
        frameon=False,
        markerscale=2.5,
        handlelength=1.6,
        columnspacing=1.2,
    )


def in_sigmas(axis: Any, *values: Any) -> None:
    """A vertical scale for `values` in σ that keeps small ones apart beside large ones.

    Ticks and dotted lines mark ±3 σ, the farthest tick its last decade; the ground is the noise's ±2 σ.
    """
    seen = np.abs(np.concatenate([np.ravel(v) for v in values]))
    top = max(4.0, 1.3 * float(seen[np.isfinite(seen)].max(initial=0.0)))
    farthest = LIMIT_SIGMAS * 10.0 ** np.floor(np.log10(top / LIMIT_SIGMAS))
    axis.set_yscale("symlog", linthresh=LIMIT_SIGMAS)
    axis.set_ylim(-top, top)
    axis.set_yticks(sorted({-farthest, -LIMIT_SIGMAS, LIMIT_SIGMAS, farthest}))
    for limit in (-LIMIT_SIGMAS, LIMIT_SIGMAS):
        axis.axhline(limit, color="0.6", lw=0.5, ls=":", zorder=0)
    axis.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}".replace("-", "−")))
    axis.yaxis.set_minor_locator(NullLocator())
    axis.axhspan(-2.0, 2.0, color=NOISE, lw=0, zorder=0)
    axis.set_ylabel("σ")


def spelt(name: str) -> str:
    """A name of the program as people read it."""
    return name.replace("_", " ")
