"""Figures of a comparison show what their names say, in the format that the file's ending says."""

from __future__ import annotations

import re
from functools import lru_cache
from itertools import islice, pairwise
from pathlib import Path

import numpy as np
import pytest
from matplotlib.text import Text

from needle_rig.errors import BadInput
from needle_rig.figures.residuals import FIGURES, _looks, asked, described, drawn, write_figure
from needle_rig.figures.style import LETTERS_PT
from needle_rig.model import SavedModel, load_parameters
from needle_rig.workbench.learning.compare import TraceComparison, compare
from tests.workbench.hidden import dataset, few

STARTS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@lru_cache
def found() -> TraceComparison:
    model = load_parameters("rig_rigid").replaced({"torsional_rigidity_nmm2": 65.0})
    return compare(dataset(seed=5), few(), SavedModel(model, "null"))


@pytest.mark.parametrize(
    "ending",
    [pytest.param(ending, marks=() if ending == ".png" else pytest.mark.whole) for ending in STARTS],
)
@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_written_in_every_format(tmp_path: Path, name: str, ending: str) -> None:
    path = tmp_path / "new" / f"{name}{ending}"
    write_figure(found(), path)
    assert path.read_bytes().startswith(STARTS[ending])


def test_the_loop_is_the_torque_over_the_base_angle_of_the_worst_trial() -> None:
    assert found().held is not None
    figure = drawn(found(), "loop")
    axis = figure.axes[0]
    measured, held, refit = (np.array(line.get_ydata()) for line in axis.lines[:3])
    file = axis.get_title(loc="left").split(",")[0]
    given = next(t for t in found().baseline.dataset.trials if t.file.endswith(file))
    assert measured == pytest.approx(1e3 * given.torque_nm)
    assert np.array(axis.lines[0].get_xdata()) == pytest.approx(np.degrees(given.trial.base_angle_rad))
    errors = [np.ptp(measured) - np.ptp(model) for model in (held, refit)]
    assert abs(errors[1]) < 0.1 * np.ptp(measured)
    assert not np.allclose(held, refit, rtol=1e-3)
    assert axis.get_xlabel() == "base angle / °"


def test_noise_alone_lies_on_the_line_of_the_quantiles_and_within_the_band() -> None:
    right = compare(dataset(seed=5), few())
    for line in drawn(right, "qq").axes[0].lines[:-1]:
        at, values = (np.array(d) for d in line.get_data())
        inside = np.abs(at) < 1.5
        assert np.abs(values[inside] - at[inside]).max() < 0.35
    band = drawn(right, "band")
    for axis in band.axes:
        points = np.column_stack([np.array(d) for d in axis.lines[0].get_data()])
        points = points[np.isfinite(points).all(axis=1)]
        paths = axis.collections[0].get_paths()
        inside = np.any([path.contains_points(points) for path in paths], axis=0)
        assert 0.85 < inside[1:-1].mean() <= 1.0


def test_the_profile_of_a_value_that_the_data_know_is_the_parabola_of_its_uncertainty() -> None:
    (axis,) = drawn(found(), "profile").axes
    (at, profile), (value, parabola) = (map(np.array, line.get_data()) for line in axis.lines[:2])
    assert profile[3] == pytest.approx(0.0, abs=0.1)
    assert profile[[1, 5]] == pytest.approx(np.interp(at[[1, 5]], value, parabola), rel=0.4)
    assert axis.get_xlabel() == "torsional rigidity / N·mm²"


def test_correlations_are_of_the_fitted_values_alone() -> None:
    image = drawn(found(), "correlation").axes[0].images[0].get_array()
    assert np.diag(np.array(image)) == pytest.approx(np.ones(2))


@pytest.mark.parametrize("name", ["loops.png", "loop.gif", "loop"])
def test_another_name_or_ending_is_a_sentence(name: str) -> None:
    with pytest.raises(BadInput, match=r"name the file after a figure \(traces, .*ending in .png"):
        asked(Path(name))


def test_python_names_the_figures_that_there_are() -> None:
    with pytest.raises(BadInput, match="figure loops: there are traces"):
        drawn(found(), "loops")


@pytest.mark.parametrize("name", FIGURES)
def test_every_text_is_legible_in_print_within_the_figure_and_beside_its_neighbours(name: str) -> None:
    figure = drawn(found(), name)
    figure.draw_without_rendering()
    ticks: set[Text] = set()
    shown: list[Text] = []
    for axis in figure.axes:
        for along, way in enumerate((axis.xaxis, axis.yaxis)):
            low, high = sorted(way.get_view_interval())
            ticks |= {*way.get_ticklabels(), *way.get_ticklabels(minor=True)}
            told = [t for t in way.get_ticklabels() if low <= t.get_position()[along] <= high]
            told = [t for t in told if t.get_visible() and t.get_text()]
            extents = [t.get_window_extent() for t in told]
            spans = sorted((box.min[along], box.max[along]) for box in extents)
            assert all(a[1] <= b[0] for a, b in pairwise(spans)), [t.get_text() for t in told]
            shown += told
    others = figure.findobj(lambda of: isinstance(of, Text) and of not in ticks)
    shown += [t for t in others if isinstance(t, Text) and t.get_visible() and t.get_text().strip()]
    for text in shown:
        box = text.get_window_extent()
        assert text.get_fontproperties().get_size_in_points() >= LETTERS_PT, text
        assert figure.bbox.padded(1.0).contains(*box.min), text
        assert figure.bbox.padded(1.0).contains(*box.max), text


@pytest.mark.parametrize(
    "name", ["loop", "strips", "qq", "over_time", "over_model", "autocorrelation", "band"]
)
def test_what_a_paper_takes_is_as_wide_as_its_column(name: str) -> None:
    assert 25.4 * drawn(found(), name).get_figwidth() == pytest.approx(85.0)


def test_channels_are_told_apart_by_marker_as_well_as_by_colour() -> None:
    lines = drawn(found(), "qq").axes[0].lines[:-1]
    assert len({line.get_marker() for line in lines}) == len(lines) > 1
    many = [(look["color"], look["marker"]) for look in islice(_looks(), 40)]
    assert len(set(many)) == len(many)
    held, refit = drawn(found(), "loop").axes[0].lines[1:3]
    assert held.get_linestyle() != refit.get_linestyle()


def test_the_strip_below_a_trace_marks_three_sigma_whatever_the_farthest_is() -> None:
    strip = drawn(found(), "strips").axes[1]
    data = [np.array(line.get_ydata()) for line in strip.lines]
    assert [float(d[0]) for d in data if d.size == 2] == [-3.0, 3.0]
    assert strip.get_ylim()[1] > max(float(np.nanmax(np.abs(d))) for d in data)


def test_a_file_says_in_words_what_it_shows(tmp_path: Path) -> None:
    path = tmp_path / "loop.svg"
    write_figure(found(), path)
    assert "the hysteresis loop, measured and modelled. Data " in path.read_text()
    for name in FIGURES:
        assert re.search(r"\w{4}.*\. Data \w+, model rig_rigid\.$", described(found(), name))
