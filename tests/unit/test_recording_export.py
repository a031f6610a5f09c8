"""Runs in other formats, and as trials to hold a model against."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from mcap.reader import make_reader

from needle_rig.cli.main import run as needle_rig
from needle_rig.config.loader import parse_rig_config, read_yaml, write_yaml
from needle_rig.dataset import read_dataset
from needle_rig.errors import BadInput
from needle_rig.recording import RunFile, RunWriter, run_tables
from needle_rig.recording.export_csv import export_csv
from needle_rig.recording.export_mcap import export_mcap
from needle_rig.workbench.observations.runs import runs_as_dataset


@pytest.fixture
def runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run_path: Path) -> Path:
    """A working folder whose runs/ holds one whole run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copy(run_path, tmp_path / "runs")
    return tmp_path / "runs"


def test_runs_are_listed(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert needle_rig(["runs"]) == 0
    header, line = capsys.readouterr().out.splitlines()
    assert header.split() == [
        "run",
        "rig",
        "time",
        "(UTC)",
        "target",
        "strategy",
        "parameters",
        "status",
        "duration",
    ]
    assert line.startswith("2026-01-01_12-00-00Z_reed2008  ")
    assert "  45°  reed2008  rig_rigid" in line


def test_runs_as_json_name_the_broken_ones_too(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (runs / "broken.h5").write_bytes(b"nothing")
    with h5py.File(runs / "foreign.h5", "w"):
        pass
    (runs / "notes.txt").write_text("not a run")
    assert needle_rig(["runs", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert [(run["name"], run["status"]) for run in listed[:2]] == [
        ("broken", "unreadable"),
        ("foreign", "unreadable"),
    ]
    assert listed[2]["complete"] is True
    assert listed[2]["target_deg"] == 45.0
    assert listed[2]["duration_s"] > 5.0


def test_no_runs_say_how_to_make_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert needle_rig(["runs"]) == 0
    assert "needle-rig compensate --target 45" in capsys.readouterr().out
    assert needle_rig(["export", "last", "--csv"]) == 2
    assert capsys.readouterr().err.startswith("last: no run in runs; make one with: needle-rig")


def test_csv_has_one_file_a_source_in_degrees(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert needle_rig(["export", "last", "--csv", "--out", "out"]) == 0
    assert capsys.readouterr().out == "out\n"
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    sources = ("drive", "events", "hall", "shaft", "ticks", "torque")
    assert names == sorted([*(f"{source}.csv" for source in sources), "run.yaml"])
    run = RunFile(next(runs.glob("*.h5")))
    ticks = run.table("ticks")
    with (tmp_path / "out" / "ticks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(ticks)
    last = rows[-1]
    assert float(last["base_angle_deg"]) == pytest.approx(np.degrees(ticks["base_angle_rad"][-1]), abs=1e-4)
    assert float(last["hall_4_deg"]) == pytest.approx(np.degrees(ticks["hall_rad"][-1, 3]), abs=1e-4)
    assert float(last["torque_nmm"]) == pytest.approx(ticks["torque_nm"][-1] * 1e3, abs=1e-6)
    assert float(last["time_s"]) == pytest.approx(ticks["time_s"][-1] - run.span_s[0], abs=1e-6)
    assert (last["phase"], last["motion"]) == ("done", "final")
    about: Any = read_yaml(tmp_path / "out" / "run.yaml")[0]
    assert about["result"]["target_deg"] == 45.0
    assert parse_rig_config(write_yaml(about["config"])) == run.config
    assert needle_rig(["export", "last", "--csv", "--out", "out"]) == 2
    assert capsys.readouterr().err == "out: exists already; name another place\n"


@pytest.mark.whole
def test_mcap_has_every_row_with_its_schema(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert needle_rig(["export", "last", "--mcap"]) == 0
    path = tmp_path / "2026-01-01_12-00-00Z_reed2008.mcap"
    assert capsys.readouterr().out == f"{path.name}\n"
    run = RunFile(next(runs.glob("*.h5")))
    counted: dict[str, int] = {}
    latest = 0
    with path.open("rb") as file:
        reader = make_reader(file)
        for schema, channel, message in reader.iter_messages():
            assert message.log_time >= latest
            latest = message.log_time
            number = counted.get(channel.topic, 0)
            counted[channel.topic] = number + 1
            if number == 0:
                assert schema is not None
                properties = json.loads(schema.data)["properties"]
                assert set(json.loads(message.data)) == set(properties)
            if channel.topic == "/ticks" and number == 0:
                assert json.loads(message.data)["waypoint_deg"] is None
        metadata = {entry.name: entry.metadata for entry in reader.iter_metadata()}
    assert counted.pop("/events") == len(run.events)
    assert counted == {f"/{name}": len(run.table(name)) for name in run.tables}
    assert metadata["run"]["strategy"] == "reed2008"
    with pytest.raises(BadInput, match="exists already"):
        export_mcap(run, path)


def test_a_run_becomes_a_dataset_that_is_read_back(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert needle_rig(["export", "last", "--dataset", "--out", "trial"]) == 0
    dataset = read_dataset("trial")
    run = RunFile(next(runs.glob("*.h5")))
    direct = runs_as_dataset([run])
    [trial] = dataset.trials
    np.testing.assert_allclose(dataset.layout.tissue_sections_m, direct.layout.tissue_sections_m)
    np.testing.assert_allclose(dataset.layout.sensor_positions_m, direct.layout.sensor_positions_m)
    assert dataset.layout.needle_length_m == pytest.approx(direct.layout.needle_length_m)
    assert dataset.sensor_names == ("hall_1", "hall_2", "hall_3", "hall_4")
    assert dataset.needle.torsional_rigidity_nm2 == pytest.approx(direct.needle.torsional_rigidity_nm2)
    assert trial.command == direct.trials[0].command
    assert (trial.command.kind, trial.command.target_deg, trial.command.settle_s) == ("compensate", 45.0, 1.0)
    motions = list(dict.fromkeys(trial.phase.tolist()))
    assert motions == ["rest", "rotate", "overshoot", "back", "forward", "final"]
    np.testing.assert_allclose(trial.hall_rad, direct.trials[0].hall_rad, atol=1e-5)
    np.testing.assert_allclose(trial.torque_nm, direct.trials[0].torque_nm, atol=1e-9)


def test_runs_that_cannot_be_a_trial_are_refused(tmp_path: Path, run_path: Path) -> None:
    whole = RunFile(run_path)
    tables = run_tables(sensors=4)
    attributes = {
        name: whole.attributes[name] for name in ("config", "strategy", "target_deg", "started_utc")
    }
    with RunWriter(tmp_path / "idle.h5", attributes, tables) as writer:
        writer.append("ticks", np.zeros(3, tables["ticks"]))
    with pytest.raises(BadInput, match="holds no sequence"):
        runs_as_dataset([RunFile(tmp_path / "idle.h5")])
    wound = whole.table("ticks")
    wound["base_angle_rad"] += 0.1
    with RunWriter(tmp_path / "wound.h5", attributes, tables) as writer:
        writer.append("ticks", wound)
    assert runs_as_dataset([RunFile(tmp_path / "wound.h5")]).trials[0].start == "wound"
    with pytest.raises(BadInput, match="no run was named"):
        runs_as_dataset([])
    longer = {**attributes, "config": str(attributes["config"]).replace("length_mm: 397", "length_mm: 399")}
    with RunWriter(tmp_path / "other.h5", longer, tables) as writer:
        writer.append("ticks", whole.table("ticks"))
    with pytest.raises(BadInput, match="its layout or needle differs"):
        runs_as_dataset([whole, RunFile(tmp_path / "other.h5")])


def test_an_empty_run_still_exports(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "empty.h5", {"strategy": "reed2008"}, run_tables(sensors=2)):
        pass
    run = RunFile(tmp_path / "empty.h5")
    export_csv(run, tmp_path / "csv")
    assert (
        tmp_path / "csv" / "hall.csv"
    ).read_text() == "time_s,node_time_s,counter,angle_1_deg,angle_2_deg\n"
    assert export_mcap(run, tmp_path / "empty.mcap").stat().st_size > 0


def test_a_run_without_end_is_exported_with_a_word(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    writer = RunWriter(runs / "live.h5", {"strategy": "reed2008"}, run_tables(sensors=4))
    writer.append("torque", [(1.0, 1.0, 0, 1e-4)])
    assert needle_rig(["export", "live", "--csv", "--out", "live"]) == 0
    assert "is still running; exporting what is there" in capsys.readouterr().err
    writer.close()


def test_a_format_must_be_named(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert needle_rig(["export", "last"]) == 2
    assert "Say which format: --csv, --mcap, --picture or --dataset" in capsys.readouterr().err
