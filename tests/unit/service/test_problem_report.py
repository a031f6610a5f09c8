"""The file for an issue: what it holds, and what it must not hold."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import h5py
import pytest

from needle_rig.config.files import shipped_file
from needle_rig.service.installed.installation import Installation
from needle_rig.service.setup import problem_report
from needle_rig.service.setup.problem_report import LEFT_OUT, without_secrets, write_report
from needle_rig.version import VERSION


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("password: hunter2 and more\nname: rig", f"password: {LEFT_OUT}\nname: rig"),
        ("Environment=MQTT_PASSWORD=hunter2", f"Environment=MQTT_PASSWORD={LEFT_OUT}"),
        ('{"api_key": "hunter2", "b": 1}', f'{{"api_key": {LEFT_OUT}, "b": 1}}'),
        ("sensor: {device: mine, token: hunter2}", f"sensor: {{device: mine, token: {LEFT_OUT}}}"),
        ("http://me:hunter2@192.168.1.1/x", f"http://{LEFT_OUT}@192.168.1.1/x"),
        ("http://localhost:8000/#token=hunter2", f"http://localhost:8000/#token={LEFT_OUT}"),
        ("tick_hz: 200\ncan: {interface: socketcan}", "tick_hz: 200\ncan: {interface: socketcan}"),
    ],
)
def test_values_that_look_like_secrets_are_left_out(text: str, shown: str) -> None:
    assert without_secrets(text) == shown


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Installation:
    """A rig whose `check` is not run."""
    found = Installation(tmp_path / "root")
    found.calibration.mkdir(parents=True)
    found.rig_file.write_text(shipped_file("rig.hardware.yaml").read_text())
    (found.calibration / "hall.yaml").write_text("sensors: []\nsecret: hunter2\n")
    monkeypatch.setattr(problem_report, "find_daemon", lambda: None)
    monkeypatch.setattr(problem_report, "_said", lambda command, *_: f"{' '.join(command[-3:])}\n")
    return found


def members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def test_it_holds_versions_state_check_log_configuration_and_the_last_run(
    place: Installation, tmp_path: Path, run_path: Path
) -> None:
    told = write_report(place, tmp_path / "r.zip", run_path.parent)
    found = members(tmp_path / "r.zip")
    run = f"run/{run_path.name}"
    wanted = ["versions.txt", "status.json", "check.json", "journal.txt", "unit.txt", "interfaces.txt"]
    assert list(found) == [*wanted, "rig/calibration/hall.yaml", "rig/rig.yaml", run, "contents.json"]
    assert f"needle-rig {VERSION} in ".encode() in found["versions.txt"]
    assert b"numpy " in found["versions.txt"]
    assert found["status.json"] == b"no daemon answers\n"
    assert found[run] == run_path.read_bytes()
    assert not [name for name, content in found.items() if b"hunter2" in content]
    assert "rig/calibration/hall.yaml: 2 lines, values that look like secrets left out" in told
    assert json.loads(found["contents.json"])["version"] == VERSION


def test_a_run_whose_rig_file_holds_a_secret_is_left_out(
    place: Installation, tmp_path: Path, run_path: Path
) -> None:
    copy = tmp_path / "runs" / run_path.name
    copy.parent.mkdir()
    copy.write_bytes(run_path.read_bytes())
    with h5py.File(copy, "r+", libver=("v110", "v110")) as file:
        file.attrs["config"] = file.attrs["config"] + "\n# token: hunter2\n"
    told = write_report(place, tmp_path / "r.zip", copy.parent)
    assert "looks like a secret" in told[-1]
    assert f"run/{run_path.name}" not in members(tmp_path / "r.zip")


def test_without_a_rig_and_without_runs_it_is_written_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))  # no journalctl, no systemctl, no ip
    monkeypatch.setattr(problem_report, "find_daemon", lambda: None)
    told = write_report(Installation(tmp_path / "root"), tmp_path / "r.zip", tmp_path)
    found = members(tmp_path / "r.zip")
    assert "check.json" not in found
    assert b"No such file or directory: 'journalctl'" in found["journal.txt"]
    assert told[-1].startswith("no run that ended lies in ")
