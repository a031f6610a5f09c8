"""The picture of a run: what is drawn where, for whole and for broken runs."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from needle_rig.cli.main import run as needle_rig
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.figures.run import draw_run, find_motions, settled_angles
from needle_rig.recording import RunFile, RunWriter, run_tables


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """Every figure that is saved."""
    saved: list[Figure] = []
    save = Figure.savefig

    def keep(self: Figure, *arguments: Any, **options: Any) -> None:
        saved.append(self)
        return save(self, *arguments, **options)

    monkeypatch.setattr(Figure, "savefig", keep)
    return saved


def rewritten(
    path: Path,
    run_path: Path,
    change: Callable[[np.ndarray], np.ndarray],
    *,
    end: str | None = None,
    raw: bool = True,
) -> tuple[RunFile, RunWriter]:
    """A copy of a run with its ticks changed; `end` is the status it ended with, None leaves it cut off."""
    whole = RunFile(run_path)
    attributes = {name: value for name, value in whole.attributes.items() if name != "result"}
    writer = RunWriter(path, attributes, run_tables(sensors=4))
    writer.append("ticks", change(whole.table("ticks")))
    if raw:
        writer.append("torque", whole.table("torque"))
    if end is not None:
        writer.close({"status": end})
    return RunFile(path), writer


def texts(axes: Axes) -> list[str]:
    return [text.get_text() for text in axes.texts]


def labels(axes: Axes) -> list[str]:
    return axes.get_legend_handles_labels()[1]


def test_motions_are_found_where_the_waypoint_changes(run_path: Path) -> None:
    ticks = RunFile(run_path).table("ticks")
    motions = find_motions(ticks)
    assert [motion.name for motion in motions] == ["rotate", "overshoot", "back", "forward", "final"]
    assert motions[0].waypoint_deg == pytest.approx(45.0)
    assert all(motion.settled for motion in motions)
    for before, after in itertools.pairwise(motions):
        assert before.end_s == after.begin_s
    settled = settled_angles(ticks, motions, 0.5)
    assert settled.shape == (5, 5)
    # what lags of 19.6, 23.2, 25.3 and 26° leave after the first motion
    np.testing.assert_allclose(settled[0], [45.0, 25.4, 21.8, 19.7, 19.0], atol=0.15)


@pytest.mark.whole
def test_the_picture_of_a_whole_run(tmp_path: Path, run_path: Path, figures: list[Figure]) -> None:
    path = draw_run(RunFile(run_path), tmp_path / "new" / "run.png")
    pixels = matplotlib.image.imread(path)
    assert pixels.shape[1] == 1500
    assert len(np.unique(pixels.reshape(-1, pixels.shape[2]), axis=0)) > 100
    angles, torque, shaft = figures[0].axes
    assert texts(angles)[0] == "rotate\nto 45.0°"
    assert len(texts(angles)) == 5
    sensors = [f"hall_{k} ({at} mm)" for k, at in ((1, 220), (2, 285), (3, 350), (4, 396))]
    assert labels(angles) == ["target ±5°", *sensors, "base", "waypoint"]
    base = next(line for line in angles.lines if line.get_label() == "base")
    assert np.asarray(base.get_ydata())[-1] == pytest.approx(45.0, abs=0.1)
    cell = next(line for line in torque.lines if line.get_label() == "cell, every reading")
    assert np.max(cell.get_ydata()) == pytest.approx(0.0996, abs=0.004)
    motions = [f"after {name}" for name in ("rotate", "overshoot", "back", "forward", "final")]
    assert labels(shaft) == ["tissue", *motions, "target"]
    assert "the simulated shaft" in shaft.get_xlabel()
    picture = shaft.lines[0]
    assert np.asarray(picture.get_xdata())[-1] == pytest.approx(396.0)
    assert np.asarray(picture.get_ydata())[-1] == pytest.approx(19.0, abs=0.1)


def test_a_run_cut_off_says_so(tmp_path: Path, run_path: Path, figures: list[Figure]) -> None:
    run, writer = rewritten(tmp_path / "cut.h5", run_path, lambda ticks: ticks[: len(ticks) // 2])
    draw_run(run, tmp_path / "cut.png")
    writer.close()
    angles, _, shaft = figures[0].axes
    assert texts(angles)[-1] == "cut off"
    assert labels(shaft)[-2] == "stopped in back"
    assert "dashes only join them" in shaft.get_xlabel()
    assert "cut off" in figures[0].get_suptitle()


@pytest.mark.parametrize("status", ["aborted", "fault"])
def test_a_stopped_run_says_why(tmp_path: Path, run_path: Path, figures: list[Figure], status: str) -> None:
    def stopped(ticks: np.ndarray) -> np.ndarray:
        ticks = ticks[: len(ticks) // 2].copy()
        ticks["phase"][-5:] = status.encode()
        return ticks

    run, _ = rewritten(tmp_path / "stopped.h5", run_path, stopped, end=status, raw=False)
    draw_run(run, tmp_path / "stopped.png")
    angles, torque, shaft = figures[0].axes
    assert texts(angles)[-1] == status
    assert labels(shaft)[-2] == "stopped in back"
    cell = next(line for line in torque.lines if line.get_label() == "cell, every reading")
    assert len(np.asarray(cell.get_ydata())) == len(run.table("ticks"))


def test_many_short_motions_keep_their_own_colours(
    tmp_path: Path, run_path: Path, figures: list[Figure]
) -> None:
    def stepped(ticks: np.ndarray) -> np.ndarray:
        ticks = ticks.copy()
        ticks["motion"] = [f"step_{1 + number * 20 // len(ticks)}".encode() for number in range(len(ticks))]
        return ticks

    run, _ = rewritten(tmp_path / "steps.h5", run_path, stepped, end="not_aligned")
    draw_run(run, tmp_path / "steps.png")
    shaft = figures[0].axes[2]
    marks = {str(line.get_color()) for line in shaft.lines if line.get_marker() in ("s", "o")}
    assert len(marks) == 20


def test_gaps_in_the_readings_are_drawn_as_gaps(tmp_path: Path, run_path: Path) -> None:
    def gappy(ticks: np.ndarray) -> np.ndarray:
        ticks = ticks.copy()
        ticks["hall_rad"][100:200, 2] = np.nan
        ticks["torque_nm"][300:310] = np.nan
        return ticks

    run, _ = rewritten(tmp_path / "gaps.h5", run_path, gappy, end="aligned")
    assert draw_run(run, tmp_path / "gaps.png").stat().st_size > 20_000


def test_nothing_to_draw_and_nowhere_to_draw_it(tmp_path: Path, run_path: Path) -> None:
    run, _ = rewritten(tmp_path / "empty.h5", run_path, lambda ticks: ticks[:0], end="aborted")
    with pytest.raises(BadInput, match="holds no tick"):
        draw_run(run, tmp_path / "empty.png")
    (tmp_path / "file").write_text("")
    with pytest.raises(NeedleRigError, match="the picture cannot be written"):
        draw_run(RunFile(run_path), tmp_path / "file" / "run.png")


def test_export_draws_the_picture_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert needle_rig(["export", str(run_path), "--picture"]) == 0
    assert capsys.readouterr().out == f"{run_path.stem}.png\n"
    assert needle_rig(["export", str(run_path), "--picture"]) == 2
    assert "exists already" in capsys.readouterr().err
