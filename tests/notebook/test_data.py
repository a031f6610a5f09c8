"""Measurements as Python takes them: sizes, iteration, tables in degrees and N·mm."""

from __future__ import annotations

import sys
from pathlib import Path
from shutil import copy

import numpy as np
import pytest

import needle_rig as nr
from needle_rig.dataset import Dataset
from needle_rig.notebook.data import Data
from needle_rig.notebook.tables import table_of
from needle_rig.recording.retention import was_read
from tests.workbench.hidden import PROTOCOL

pd = pytest.importorskip("pandas")

SETTLED = "reed2008"


@pytest.fixture(scope="module")
def data() -> Data:
    return nr.simulate({"tissue_elasticity": 0.35}, protocol=PROTOCOL, name="mine", rate_hz=20.0)


def test_a_dataset_is_a_short_sequence_of_trials(data: Data) -> None:
    assert repr(data).startswith("mine: 5 trials, ")
    assert (len(data), len(data.trials), len(list(data))) == (5, 5, 5)
    assert repr(data[0]).startswith("01: kind compensate, target_deg 45.0")
    assert data.notes == ()
    assert len(repr(data)) + len(repr(data[0])) < 200


def test_its_table_has_every_sample_in_degrees_and_nmm(data: Data) -> None:
    given = data.given
    assert isinstance(given, Dataset)
    every = data.to_pandas()
    assert len(every) == sum(len(trial) for trial in data)
    first = every[every["trial"] == "01"]
    assert np.allclose(first["torque_nmm"], 1e3 * given.trials[0].torque_nm)
    assert np.allclose(first["hall_4_deg"], np.degrees(given.trials[0].hall_rad[:, 3]))
    assert first["base_deg"].max() > 45.0
    assert list(data[0].to_pandas()) == list(every)


def test_a_notebook_shows_a_row_a_trial_and_a_picture(data: Data) -> None:
    for shown, rows in ((data._repr_html_(), 5), (data[0]._repr_html_(), 20)):
        assert shown.count("<tr>") == 1 + rows
        assert shown.count('src="data:image/png;base64,') == 1
    assert "rows more in table()" in data[0]._repr_html_()
    assert len(data.plot().axes) == len(data[0].plot().axes) == 2


def test_settled_values_have_a_table_and_say_that_they_have_no_trials() -> None:
    settled = nr.read_dataset(SETTLED)
    assert len(settled) == len(settled.to_pandas())
    assert repr(settled).startswith(f"{settled.name}: {len(settled)} settled values")
    assert "<table>" in settled._repr_html_()
    with pytest.raises(nr.BadInput, match="has settled values only, no trials"):
        _ = settled.trials
    with pytest.raises(nr.BadInput, match="too few to fit values one by one"):
        nr.fit(settled)


def test_tables_of_a_run_are_frames_in_degrees_and_nmm(run_path: Path) -> None:
    run = nr.read_run(run_path)
    for name in run.tables:
        assert len(pd.DataFrame(run.table(name))) == len(run.table(name)) > 0
    ticks = run.to_pandas()
    assert len(run) == len(ticks)
    assert {"hall_1_deg", "torque_nmm", "base_angle_deg"} <= set(ticks)
    assert ticks["time_s"].iloc[0] == pytest.approx(0.0, abs=1.0)
    assert np.allclose(
        ticks["hall_1_deg"], np.degrees(run.file.table("ticks")["hall_rad"][:, 0]), equal_nan=True
    )
    assert isinstance(ticks["phase"].iloc[0], str)
    assert list(pd.DataFrame(run.table("events"))) == ["time_s", "kind", "text"]
    with pytest.raises(nr.BadInput, match=r"has no table shafts; it has drive, .*, events$"):
        run.table("shafts")


def test_a_run_is_exported_once_and_counts_as_read(run_path: Path, tmp_path: Path) -> None:
    (tmp_path / ".read").mkdir()
    run_path = Path(copy(run_path, tmp_path))
    run = nr.read_run(run_path)
    assert (nr.export(run, tmp_path / "csv") / "events.csv").is_file()
    assert nr.export(run_path, tmp_path / "run.mcap", "mcap").read_bytes()
    assert len(nr.read_dataset(nr.export(run, tmp_path / "data", "dataset"))) == 1
    assert was_read(run_path)
    (tmp_path / "png").touch()
    for form in ("csv", "png"):
        with pytest.raises(nr.BadInput, match=r"exists already; name another place$"):
            nr.export(run, tmp_path / form, form)
    with pytest.raises(nr.BadInput, match=r"^form is 'csw', not csv or dataset or mcap or png$"):
        nr.export(run, tmp_path / "csw", "csw")  # type: ignore[arg-type]


def test_a_table_without_rows_has_its_columns() -> None:
    assert list(pd.DataFrame(table_of([], ("effect", "value")))) == ["effect", "value"]


def test_without_pandas_a_sentence_says_what_to_install(data: Data, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(nr.BadInput, match=r"pip install pandas$"):
        data.to_pandas()
