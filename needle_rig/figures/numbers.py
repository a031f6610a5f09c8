"""The numbers that a figure shows, as a table: whoever draws it anew needs no picture."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.figures.figure import Figure

HEADINGS = ("panel", "series", "x", "y", "value")


def write_numbers(figure: Figure, path: Path) -> None:
    """Every dot of every line, and every cell of every map of `figure`, as CSV at `path`.

    A row has the panel, the name of the series, x and y; a cell of a map has its value as well.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(HEADINGS)
        for number, axis in enumerate(figure.axes, 1):
            panel = " over ".join(filter(None, (axis.get_ylabel(), axis.get_xlabel()))) or f"panel {number}"
            for line in axis.lines:
                name = str(line.get_label())
                told = "" if name.startswith("_") else name
                for x, y in zip(*(np.atleast_1d(v) for v in line.get_data(orig=False)), strict=True):
                    rows.writerow((panel, told, f"{x:.9g}", f"{y:.9g}", ""))
            for image in axis.images:
                cells: Any = np.ma.asarray(image.get_array()).filled(np.nan)
                for (y, x), value in np.ndenumerate(cells):
                    rows.writerow((panel, "", x, y, f"{value:.9g}"))
