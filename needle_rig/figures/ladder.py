"""The ladder of a model: how the error fell, step by step."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from needle_rig.figures.figure import Figure
from needle_rig.figures.style import spelt
from needle_rig.model import ChannelErrors, SavedModel
from needle_rig.workbench.learning.history import ladder

LEAST_SPAN = 4.0
"""Largest over smallest error of an axis at least: a smaller fall is to look small."""
TICKS = np.array([1.0, 2.0, 5.0])


def ladder_figure(saved: SavedModel) -> Figure:
    """Training and held-out error over the steps, over all and for each channel, each with its own floor."""
    steps = ladder(saved)
    names = list(dict.fromkeys(n for s in steps for n in s.channels))
    columns = 3
    rows = max(1, -(-(len(names) + 1) // columns))
    figure = Figure(figsize=(4.2 * columns, 2.8 * rows + 0.8), layout="constrained")
    figure.suptitle("\n".join(_laws(saved)), fontsize=9, x=0.01, ha="left")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    place = list(range(len(steps)))

    def draw(axis: Any, title: str, *curves: list[Any]) -> None:
        as_numbers = np.array([[float("nan") if v is None else v for v in values] for values in curves])
        axis.plot(
            place, as_numbers[2], color="tab:red", lw=1, ls=":", label="floor: noise and scatter of trials"
        )
        axis.plot(place, as_numbers[3], color="0.5", lw=1, ls=":", label="floor: noise")
        axis.plot(place, as_numbers[0], "o--", color="0.5", markersize=5, label="training")
        axis.plot(place, as_numbers[1], "o-", color="tab:red", markersize=4, label="commands left out")
        for x, value in zip(place, as_numbers[1], strict=True):
            if np.isfinite(value):
                axis.annotate(
                    f"{value:.3g}",
                    (x, value),
                    (4, 5),
                    textcoords="offset points",
                    fontsize=7,
                    color="tab:red",
                )
        axis.set_title(title, fontsize=9)
        axis.set_xticks(place, [spelt(s.label) for s in steps], rotation=20, ha="right", fontsize=7)
        axis.margins(x=0.2)
        _logarithmic(axis, as_numbers)

    draw(
        grid[0],
        "all, in units of the noise",
        [s.training for s in steps],
        [s.held_out for s in steps],
        [s.floor for s in steps],
        [s.floor for s in steps],
    )
    grid[0].legend(fontsize=7)
    for axis, name in zip(grid[1:], names, strict=False):
        errors = [s.channels.get(name, ChannelErrors()) for s in steps]
        draw(
            axis,
            spelt(name.replace("_deg", " / °").replace("_nmm", " / N·mm")),
            [e.training_after for e in errors],
            [e.held_out_after for e in errors],
            [e.floor for e in errors],
            [e.training_floor for e in errors],
        )
    for axis in grid[1 + len(names) :]:
        axis.set_visible(False)
    return figure


def _laws(saved: SavedModel) -> list[str]:
    """What each step added, in the words of the effect's file."""
    added = [name for entry in saved.history for name in entry.added]
    words = {e.name(): (type(e).__doc__ or "").split("\n")[0] for e in saved.model.effects}
    return [f"+ {spelt(name)}: {words[name]}" for name in dict.fromkeys(added) if words.get(name)]


def _logarithmic(axis: Any, values: np.ndarray[Any, Any]) -> None:
    """A logarithmic axis with plain numbers, of at least `LEAST_SPAN`."""
    seen = values[np.isfinite(values) & (values > 0.0)]
    if not seen.size:
        return
    low, high = float(seen.min()), float(seen.max())
    # numbers stand above the points
    room = max(LEAST_SPAN / (high / low), 1.0) ** 0.5 * 1.25 * (high / low) ** 0.1
    low, high = low / room, high * room
    axis.set_yscale("log")
    axis.set_ylim(low, high)
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    axis.yaxis.set_major_locator(FixedLocator(np.outer(decades, TICKS).ravel().tolist()))
    axis.yaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.tick_params(axis="y", labelsize=8)
