"""Run files of the daemon as data for the workbench: whole, cut off, with gaps, truncated."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from needle_rig.dataset import write_dataset
from needle_rig.errors import BadInput
from needle_rig.questions.question import read_observations
from needle_rig.recording import RunFile, RunWriter, run_tables
from needle_rig.recording.retention import was_read
from needle_rig.workbench.learning.observations import SettledValues, Traces
from needle_rig.workbench.observations.sources import read_measurements


def rewritten(tmp_path: Path, run_path: Path, change: Callable[[np.ndarray], None]) -> Path:
    """A copy of the run with its ticks changed."""
    whole = RunFile(run_path)
    ticks = whole.table("ticks")
    change(ticks)
    path = tmp_path / "changed.h5"
    names = ("config", "strategy", "target_deg", "started_utc")
    with RunWriter(path, {n: whole.attributes[n] for n in names}, run_tables(sensors=4)) as writer:
        writer.append("ticks", ticks)
    return path


def test_runs_and_folders_of_one_rig_are_one_series(tmp_path: Path, run_path: Path) -> None:
    alone = read_measurements([run_path])
    assert len(alone.trials) == 1
    assert alone.trials[0].torque_ok.all()
    folder = write_dataset(alone, tmp_path / "folder")
    both = read_measurements([run_path, folder])
    assert len(both.trials) == 2
    assert len(both.replicates) == 1
    with pytest.raises(BadInput, match="no data was named"):
        read_measurements([])


def test_questions_take_runs_and_names_of_datasets(tmp_path: Path, run_path: Path) -> None:
    run = tmp_path / run_path.name
    run.write_bytes(run_path.read_bytes())
    (tmp_path / ".read").mkdir()
    assert isinstance(read_observations((run,)), Traces)
    assert was_read(run)
    settled = read_observations((Path("reed2008"),))
    assert isinstance(settled, SettledValues)
    assert settled.name == "reed2008"
    with pytest.raises(BadInput, match="holds settled values; give it alone"):
        read_observations((run_path, Path("reed2008")))
    with pytest.raises(BadInput, match="there is no such folder"):
        read_observations((Path("nowhere"),))


def test_gaps_of_a_run_are_masked_and_said(tmp_path: Path, run_path: Path) -> None:
    def spoil(ticks: np.ndarray) -> None:
        ticks["torque_nm"][300:340] = np.nan
        ticks["hall_rad"][:, 2] = np.nan

    dataset = read_measurements([rewritten(tmp_path, run_path, spoil)])
    trial = dataset.trials[0]
    assert (~trial.torque_ok).sum() == 40
    assert not trial.hall_ok[:, 2].any()
    assert any("base_torque is missing in 40 samples" in note for note in dataset.notes)
    assert any("hall_3 is missing in every sample" in note for note in dataset.notes)


def test_a_wrapped_sensor_of_a_run_is_unwrapped(tmp_path: Path, run_path: Path) -> None:
    whole = read_measurements([run_path]).trials[0].hall_rad[:, 3]

    def wrap(ticks: np.ndarray) -> None:
        ticks["hall_rad"][:, 3] = (ticks["hall_rad"][:, 3] + 5.9) % (2 * np.pi) - 5.9

    dataset = read_measurements([rewritten(tmp_path, run_path, wrap)])
    np.testing.assert_allclose(dataset.trials[0].hall_rad[:, 3], whole, atol=1e-6)
    assert any("hall_4 wraps" in note for note in dataset.notes)


def test_a_run_that_has_no_use_is_refused_with_its_place_and_the_reason(
    tmp_path: Path, run_path: Path
) -> None:
    def lose_the_base(ticks: np.ndarray) -> None:
        ticks["base_angle_rad"] = np.nan

    changed = rewritten(tmp_path, run_path, lose_the_base)
    with pytest.raises(BadInput) as refusal:
        read_measurements([changed])
    assert str(refusal.value) == f"{changed}:2: the base angle is never known"


@pytest.mark.parametrize("kept", [0.02, 0.3, 0.6, 0.97])
def test_a_run_file_that_lost_its_end_is_refused(tmp_path: Path, run_path: Path, kept: float) -> None:
    cut = tmp_path / "cut.h5"
    content = run_path.read_bytes()
    cut.write_bytes(content[: int(len(content) * kept)])
    with pytest.raises(BadInput, match=r"cut\.h5: lost its end on the way: it has \d+ of \d+ bytes"):
        read_measurements([cut])
