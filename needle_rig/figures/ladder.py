"""The ladder of a model: how the error fell, step by step."""

from __future__ import annotations

from typing import Any

from matplotlib.figure import Figure

from needle_rig.model import ChannelErrors, SavedModel
from needle_rig.workbench.learning.history import ladder


def ladder_figure(saved: SavedModel) -> Figure:
    """Training and held-out error over the steps, over all and for each channel, with the noise floor."""
    steps = ladder(saved)
    names = list(dict.fromkeys(n for s in steps for n in s.channels))
    columns = 3
    rows = max(1, -(-(len(names) + 1) // columns))
    figure = Figure(figsize=(4.2 * columns, 2.8 * rows + 0.4), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False).ravel()
    place = list(range(len(steps)))

    def draw(axis: Any, title: str, training: list[Any], held: list[Any], floor: list[Any]) -> None:
        as_numbers = [
            [float("nan") if v is None else v for v in values] for values in (training, held, floor)
        ]
        axis.plot(place, as_numbers[0], "o--", color="0.5", label="training")
        axis.plot(place, as_numbers[1], "o-", color="tab:red", label="commands left out")
        axis.plot(place, as_numbers[2], color="tab:green", lw=1, label="noise floor")
        axis.set_yscale("log")
        axis.set_title(title, fontsize=9)
        axis.set_xticks(place, [s.label for s in steps], rotation=20, ha="right", fontsize=7)

    draw(
        grid[0],
        "all, in units of the noise",
        [s.training for s in steps],
        [s.held_out for s in steps],
        [s.floor for s in steps],
    )
    grid[0].legend(fontsize=7)
    for axis, name in zip(grid[1:], names, strict=False):
        errors = [s.channels.get(name, ChannelErrors()) for s in steps]
        draw(
            axis,
            name.replace("_deg", " / °").replace("_nmm", " / N·mm"),
            [e.training_after for e in errors],
            [e.held_out_after for e in errors],
            [e.floor for e in errors],
        )
    for axis in grid[1 + len(names) :]:
        axis.set_visible(False)
    return figure
