"""A chart of the page for print, and the numbers of a figure."""

from __future__ import annotations

import csv
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib", reason="no matplotlib here: pip install 'needle-rig[figures]'")

from needle_rig.figures.chart import Line, values, write_chart
from needle_rig.figures.figure import Figure
from needle_rig.figures.numbers import HEADINGS, write_numbers

TIME_S = np.linspace(0.0, 1.0, 50)


def test_a_chart_is_drawn_with_gaps_bands_and_any_name(tmp_path: Path) -> None:
    broken = values([*([1.0] * 20), None, *([2.0] * 29)])
    lines = [
        Line("_hidden $x_{$ <i>", "dots", TIME_S, broken),
        Line("model", "dashed", TIME_S, np.sin(TIME_S)),
        Line("upper", "edge", TIME_S, np.sin(TIME_S) + 1),
        Line("lower", "edge", TIME_S, np.sin(TIME_S) - 1),
    ]
    path = write_chart(tmp_path / "chart.svg", "t", ("time / s", "$ / °"), lines, [(2, 3)], 2.0)
    assert ElementTree.parse(path).getroot().tag.endswith("svg")
    without = write_chart(tmp_path / "without.svg", "t", ("time / s", "°"), lines[:2])
    assert path.stat().st_size > without.stat().st_size, "the band is drawn"


def test_a_chart_of_gaps_alone_is_empty_and_no_error(tmp_path: Path) -> None:
    nothing = values([None] * 50)
    assert write_chart(tmp_path / "a.svg", "", ("", ""), [Line("a", "line", TIME_S, nothing)]).is_file()


def test_the_numbers_of_a_figure_are_those_of_its_lines_and_maps(tmp_path: Path) -> None:
    figure = Figure()
    above, below = figure.subplots(2, 1)
    above.plot([0.0, 1.0, 2.0], [3.0, 4.0, np.nan], label='torque, "raw"')
    above.set_ylabel("N·mm")
    above.set_xlabel("s")
    below.imshow(np.ma.masked_less(np.array([[1.0, 2.0], [-3.0, 4.0]]), 0.0))
    write_numbers(figure, tmp_path / "numbers.csv")
    with (tmp_path / "numbers.csv").open(encoding="utf-8", newline="") as file:
        head, *rows = csv.reader(file)
    assert tuple(head) == HEADINGS
    assert rows[:3] == [
        ["N·mm over s", 'torque, "raw"', "0", "3", ""],
        ["N·mm over s", 'torque, "raw"', "1", "4", ""],
        ["N·mm over s", 'torque, "raw"', "2", "nan", ""],
    ]
    assert [row[4] for row in rows[3:]] == ["1", "2", "nan", "4"]
