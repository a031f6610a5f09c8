"""A measured torque on the tip: its column, what it drives, what is refused."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from needle_rig.dataset import read_dataset, write_dataset
from needle_rig.errors import BadInput
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.observations.blocks import in_blocks
from needle_rig.workbench.observations.earlier_path import with_path_before

PRACTICE = Path(__file__).parents[1] / "data" / "practice" / "none"


def loaded(folder: Path, values: str = "0.05") -> Path:
    """The practice dataset of one trial with a column tip_torque_nmm, `values` at every tenth row."""
    shutil.copytree(PRACTICE, folder)
    described = (folder / "dataset.yaml").read_text().split("trials:\n", 1)
    first = "- file:" + described[1].split("- file:")[1]
    (folder / "dataset.yaml").write_text(described[0] + "trials:\n" + first)
    file = folder / "trials/01.csv"
    header, *rows = file.read_text().splitlines()
    told = [f"{row},{values if k % 10 == 0 else '0.02'}" for k, row in enumerate(rows)]
    file.write_text("\n".join([f"{header},tip_torque_nmm", *told]) + "\n")
    return folder


def test_the_column_drives_the_model_and_survives_writing(tmp_path: Path) -> None:
    dataset = read_dataset(loaded(tmp_path / "set"))
    tip_nm = dataset.trials[0].trial.tip_torque_nm
    assert tip_nm is not None
    assert tip_nm[:11] * 1e3 == pytest.approx([0.05, *[0.02] * 9, 0.05])
    assert not any("tip_torque" in note for note in dataset.notes)
    again = read_dataset(write_dataset(dataset, tmp_path / "again"))
    assert again.trials[0].trial.tip_torque_nm == pytest.approx(tip_nm)
    assert read_dataset(PRACTICE).trials[0].trial.tip_torque_nm is None


def test_missing_samples_are_filled_and_said_and_none_at_all_is_no_trial(tmp_path: Path) -> None:
    dataset = read_dataset(loaded(tmp_path / "gaps", ""))
    tip_nm = dataset.trials[0].trial.tip_torque_nm
    assert tip_nm is not None
    assert tip_nm * 1e3 == pytest.approx(0.02)
    assert any("tip_torque is missing" in note for note in dataset.notes)
    file = loaded(tmp_path / "empty", "") / "trials/01.csv"
    file.write_text(file.read_text().replace(",0.02\n", ",\n"))
    with pytest.raises(BadInput, match="the torque on the tip, which drives the model, is never known"):
        read_dataset(tmp_path / "empty")


def test_a_clamped_tip_takes_none(tmp_path: Path) -> None:
    folder = loaded(tmp_path / "set")
    text = (folder / "dataset.yaml").read_text()
    (folder / "dataset.yaml").write_text(text.replace("rig:\n", "rig:\n  tip: clamped\n", 1))
    with pytest.raises(BadInput, match="tip_torque acts on a tip"):
        read_dataset(folder)


def test_bins_blocks_and_paths_before_keep_it_beside_the_base(tmp_path: Path) -> None:
    dataset = read_dataset(loaded(tmp_path / "set"))
    trial = dataset.trials[0]
    driven = [t.trial for t in (with_path_before(trial, [0.3, 0.0]), *in_blocks(dataset).trials)]
    for drive in (bin_trial(trial).trial, *driven):
        assert drive.tip_torque_nm is not None
        assert drive.tip_torque_nm.shape == drive.time_s.shape
        assert np.ptp(drive.tip_torque_nm) > 0.0
    before = with_path_before(trial, [0.3, 0.0]).trial
    assert before.tip_torque_nm is not None
    assert before.tip_torque_nm[0] * 1e3 == pytest.approx(0.05)
