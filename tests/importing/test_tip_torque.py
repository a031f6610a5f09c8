"""A torque at the tip in a mapping: role, sign, commands that differ by the load, a sine cut into periods."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from needle_rig.config.places import write_yaml
from needle_rig.dataset import Dataset, read_dataset, write_dataset
from needle_rig.errors import BadInput
from needle_rig.importing import dataset_of, read_mapping
from needle_rig.importing import guess as proposed
from needle_rig.importing.commands import commanded
from needle_rig.importing.reader import read_recording
from needle_rig.physics.rod import Layout, build_rod
from needle_rig.physics.solver import solve

RECORDED = Path(__file__).parents[2] / "config/recordings/davinci.yaml"
RIG = {
    "needle": {"torsional_rigidity_nmm2": 62.5},
    "needle_length_mm": 400.0,
    "tissue_sections_mm": [[0.0, 400.0]],
    "hall_sensors": [{"name": "tip", "position_mm": 400.0}],
}


def recording(folder: Path, sign: float = 1.0) -> Path:
    """Two files of two periods of a sine each, with a small and a large load; and their mapping."""
    rod = build_rod(Layout(0.4, ((0.0, 0.4),), (0.4,)), 62.5e-6, 2e-4, 4e-3)
    time_s = np.arange(0.0, 8.0, 0.01)
    base_rad = 0.6 * np.sin(0.5 * np.pi * time_s)
    for name, load_nm in (("small", 2e-5), ("large", 1e-4)):
        tip_nm = load_nm * (1.0 + 0.2 * np.cos(0.5 * np.pi * time_s))
        found = solve(rod, time_s, base_rad, tip_nm)
        table = [time_s, np.degrees(base_rad), found.torque_nm * 1e3, np.degrees(found.tip_rad), tip_nm * 1e3]
        np.savetxt(
            folder / f"{name}.csv",
            np.column_stack([*table, time_s // 4.0]),
            delimiter=",",
            header="time_s,base_deg,base_torque_nmm,tip_deg,tip_torque_nmm,period",
            comments="",
        )
    channels = [
        {"role": "base_angle", "clock": "log", "source": "base_deg", "unit": "deg"},
        {"role": "base_torque", "clock": "log", "source": "base_torque_nmm", "unit": "N·mm"},
        {"role": "tip", "clock": "log", "source": "tip_deg", "unit": "deg"},
        {"role": "tip_torque", "clock": "log", "source": "tip_torque_nmm", "unit": "N·mm", "sign": int(sign)},
    ]
    mapping = {
        "format": "needle-rig-import/1",
        "name": "loaded",
        "clocks": {
            "log": {"files": [{"path": "small.csv"}, {"path": "large.csv"}], "source": "time_s", "unit": "s"}
        },
        "channels": channels,
        "trials": {"at": "column", "clock": "log", "source": "period", "start": "wound"},
        "rig": RIG,
    }
    (folder / "mapping.yaml").write_text(write_yaml(mapping))
    return folder / "mapping.yaml"


def imported(path: Path) -> Dataset:
    mapping, places = read_mapping(path)
    return dataset_of(mapping, path.parent, places)


def test_it_is_an_input_and_loads_are_commands_of_their_own(tmp_path: Path) -> None:
    dataset = imported(recording(tmp_path))
    assert [len(places) for places in dataset.replicates.values()] == [2, 2]
    tip_nm = dataset.trials[2].trial.tip_torque_nm
    assert tip_nm is not None
    assert np.median(tip_nm) == pytest.approx(1e-4, rel=0.05)
    again = read_dataset(write_dataset(dataset, tmp_path / "again"))
    assert again.replicates.keys() == dataset.replicates.keys()


def test_the_wrong_sign_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="turn the sign of tip_torque"):
        imported(recording(tmp_path, -1.0))


def test_a_clamped_tip_and_a_recording_of_inputs_alone_are_refused(tmp_path: Path) -> None:
    path = recording(tmp_path)
    text = path.read_text()
    path.write_text(text.replace("rig:\n", "rig:\n  tip: clamped\n"))
    with pytest.raises(BadInput, match="tip_torque acts on a tip"):
        read_mapping(path)
    path.write_text(text)
    mapping, _ = read_mapping(path)
    inputs = tuple(c for c in mapping.channels if c.role in ("base_angle", "tip_torque"))
    assert any("nothing to compare" in s for s in mapping.model_copy(update={"channels": inputs}).lacks())


def test_a_second_torque_called_as_at_the_tip_is_proposed_with_a_doubt(tmp_path: Path) -> None:
    recording(tmp_path)
    mapping = proposed([read_recording(tmp_path / "large.csv")], "loaded", None, Path())
    part = next(c for c in mapping.channels if c.role == "tip_torque")
    assert (part.source, part.unit) == ("tip_torque_nmm", "N·mm")
    assert "remove the line where the tip is free" in part.doubt


@pytest.mark.parametrize(
    ("corners_s", "angles_deg", "kind", "steps_deg"),
    [
        ((0.0, 1.0, 1.5, 3.0, 3.5, 4.5), (30.0, 58.0, 58.0, 3.0, 3.0, 30.0), "staircase", (58.0, 3.0)),
        ((0.0, 0.5, 1.5, 3.0), (0.0, 0.0, 58.0, 58.0), "staircase", (58.0,)),
        # turned back at 58° without a rest
        ((0.0, 1.0, 3.0, 3.5, 4.5), (30.0, 58.0, 3.0, 3.0, 30.0), "unknown", ()),
    ],
)
def test_the_command_of_a_trial_that_begins_in_motion(
    corners_s: tuple[float, ...],
    angles_deg: tuple[float, ...],
    kind: str,
    steps_deg: tuple[float, ...],
    tmp_path: Path,
) -> None:
    given = imported(recording(tmp_path)).trials[0]
    time_s = given.trial.time_s
    base_rad = np.radians(np.interp(time_s, corners_s, angles_deg))
    trial = dataclasses.replace(given, trial=dataclasses.replace(given.trial, base_angle_rad=base_rad))
    (found,) = commanded([trial])
    assert (found.command.kind, found.command.steps_deg) == (kind, steps_deg)


def test_the_machine_in_the_repository_is_imported_by_its_mapping() -> None:
    dataset = imported(RECORDED)
    assert (len(dataset.trials), len(dataset.replicates)) == (28, 12)
    assert dataset.torque_scale == 1000.0
    assert all(t.trial.tip_torque_nm is not None and t.start == "wound" for t in dataset.trials)
    licences = (RECORDED.parent / "davinci/README.md").read_text()
    assert "odbl/1-0" in licences
    assert "dbcl/1-0" in licences
    assert sum(f.stat().st_size for f in (RECORDED.parent / "davinci").iterdir()) < 300_000
