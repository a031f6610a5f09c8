"""Figures of a comparison show what their names say, in the format that the file's ending says."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.figures.residuals import FIGURES, asked, drawn, write_figure
from needle_rig.model import SavedModel, load_parameters
from needle_rig.workbench.learning.compare import TraceComparison, compare
from tests.workbench.hidden import dataset, few

STARTS = {".png": b"\x89PNG", ".svg": b"<?xml", ".pdf": b"%PDF"}


@lru_cache
def found() -> TraceComparison:
    model = load_parameters("rig_rigid").replaced({"torsional_rigidity_nmm2": 65.0})
    return compare(dataset(seed=5), few(), SavedModel(model, "null"))


@pytest.mark.parametrize("ending", STARTS)
@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_written_in_every_format(tmp_path: Path, name: str, ending: str) -> None:
    path = tmp_path / "new" / f"{name}{ending}"
    write_figure(found(), path)
    assert path.read_bytes().startswith(STARTS[ending])


def test_the_loop_is_the_torque_over_the_base_angle_of_the_worst_trial() -> None:
    assert found().held is not None
    figure = drawn(found(), "loop")
    axis = figure.axes[0]
    measured, held, refit = (np.array(line.get_ydata()) for line in axis.lines)
    given = next(t for t in found().baseline.dataset.trials if t.file.endswith(axis.get_title()))
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
    profile, parabola = (np.array(line.get_ydata()) for line in axis.lines[:2])
    assert profile[3] == pytest.approx(0.0, abs=0.1)
    assert profile[[1, 5]] == pytest.approx(parabola[[1, 5]], rel=0.4)


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
