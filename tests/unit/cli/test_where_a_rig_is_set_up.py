"""On a computer where a rig is set up nobody gets a simulated one without asking for it."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from pathlib import Path

import pytest

from needle_rig.cli.main import run
from needle_rig.config.files import shipped_file
from needle_rig.service import client
from needle_rig.service.installed import installation
from needle_rig.service.installed.installation import Installation
from needle_rig.service.installed.systemd import UnitStanding
from needle_rig.version import VERSION

FAILED = UnitStanding("failed", "failed", "exit-code", "")


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Installation:
    """A computer on which nothing is set up, with a working folder of its own."""
    place = Installation(tmp_path / "root")
    monkeypatch.setattr(installation, "HERE", place)
    monkeypatch.setattr(installation, "unit_standing", lambda: None)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "user"))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    return place


def put(path: Path, text: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


SIGNS: dict[str, Callable[[Installation], Path]] = {
    "a unit": lambda here: here.unit,
    "a rig file": lambda here: here.rig_file,
    "a socket that nobody listens at": lambda here: here.root / "run/needle-rig/daemon.sock",
}


@pytest.mark.parametrize("sign", SIGNS)
@pytest.mark.parametrize("options", [(), ("--out", "here"), ("--model", "fitted.yaml")], ids=str)
def test_a_command_that_moves_refuses_where_the_daemon_is_down(
    here: Installation, sign: str, options: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    shown = put(SIGNS[sign](here))
    assert run(["compensate", "--target", "45", "--no-picture", *options]) == 3
    said = capsys.readouterr()
    assert said.out == ""
    assert str(shown) in said.err
    assert "--simulated" in said.err
    assert not Path("runs").exists()


def test_an_option_that_needs_a_daemon_of_its_own_is_refused_while_the_rigs_runs(
    here: Installation, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "user/needle-rig/daemon.sock"
    path.parent.mkdir(parents=True)
    put(here.unit)
    with socket.socket(socket.AF_UNIX) as daemon:
        daemon.bind(str(path))
        daemon.listen()
        assert run(["compensate", "--target", "45", "--out", "mine"]) == 2
    said = capsys.readouterr().err
    assert "leave --out out, or give --simulated" in said


@pytest.mark.parametrize("command", ["status", "stop", "clear", "hold", "release", "jog --by 5", "home"])
def test_a_command_that_asks_says_that_a_rig_is_set_up(
    here: Installation, command: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(here.unit)
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    monkeypatch.setattr(installation, "unit_standing", lambda: FAILED)
    assert run(command.split()) == 3
    said = capsys.readouterr().err
    assert "a rig is set up here" in said
    assert "its service failed (exit-code)" in said
    assert "journalctl -u needle-rig" in said


def test_a_service_whose_rig_file_is_wrong_is_told_with_its_line(
    here: Installation, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(here.unit)
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text() + "new_key: 1\nother_key: 1\n")
    monkeypatch.setattr(installation, "unit_standing", lambda: FAILED)
    for command in ("status", "compensate --target 45"):
        assert run(command.split()) == 3
        said = capsys.readouterr().err
        assert f"{here.rig_file}:" in said
        assert ":1: new_key: unknown key" in said
        assert "(and 1 more); mend it, then: sudo systemctl restart needle-rig" in said
    assert run(["check"]) == 1
    assert "new_key: unknown key" in (said := capsys.readouterr().out)
    assert "mend it, then: sudo systemctl restart needle-rig" in said


def test_a_rig_file_of_a_newer_version_says_so(
    here: Installation, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    put(here.unit)
    text = shipped_file("rig.hardware.yaml").read_text()
    put(here.rig_file, text.replace("format: needle-rig/1", "format: needle-rig/2"))
    monkeypatch.setattr(installation, "unit_standing", lambda: FAILED)
    assert run(["status"]) == 3
    assert (
        f"written by a newer needle-rig, format 2; needle-rig {VERSION} reads up to 1: upgrade"
        in capsys.readouterr().err
    )


@pytest.mark.parametrize("standing", [FAILED, UnitStanding("activating", "auto-restart", "exit-code", "")])
def test_a_service_that_failed_is_told_with_what_its_daemon_said(
    here: Installation,
    standing: UnitStanding,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    put(here.unit)
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    put(here.runs / ".daemon.json", '{"since_utc": "", "how": "a defect: ValueError()"}')
    monkeypatch.setattr(installation, "unit_standing", lambda: standing)
    assert run(["status"]) == 3
    assert "the daemon said: a defect: ValueError()" in capsys.readouterr().err


def test_check_beside_a_service_that_is_down_starts_nothing_and_says_why(
    here: Installation, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def started(*_: object, **__: object) -> None:
        raise AssertionError("a daemon was started")

    put(here.unit)
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    monkeypatch.setattr(installation, "unit_standing", lambda: FAILED)
    monkeypatch.setattr(client, "private_daemon", started)
    assert run(["check"]) == 1
    said = capsys.readouterr().out
    assert "fail  daemon: a rig is set up here" in said
    assert "its service failed (exit-code)" in said
    assert "real time" not in said


@pytest.mark.parametrize(
    ("standing", "words"),
    [
        (UnitStanding("activating", "start", "success", "compiles"), "is starting (compiles)"),
        (UnitStanding("activating", "auto-restart", "watchdog", ""), "ended (watchdog) and is started again"),
        (UnitStanding("inactive", "dead", "success", ""), "sudo systemctl start needle-rig"),
        (UnitStanding("deactivating", "stop-sigterm", "success", ""), "is ending"),
    ],
    ids=lambda value: value.state if isinstance(value, UnitStanding) else "",
)
def test_the_service_is_told_as_systemd_knows_it(standing: UnitStanding, words: str) -> None:
    assert words in standing.sentence


@pytest.mark.whole
@pytest.mark.parametrize("asked", [("--simulated", "--fast"), ("--seed", "0", "--fast")], ids=str)
def test_who_asks_for_the_simulated_rig_gets_it_and_all_says_so(
    here: Installation, asked: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    # a settling of half a second: what is looked at here is what is said
    motion = ("--settle", "0.6", "--speed", "60", "--target", "5", "--no-picture", "--strategy", "decay")
    assert run(["compensate", *motion, *asked, "--out", "mine"]) == 0
    said = capsys.readouterr()
    assert "Simulated: " in said.out
    phases = [line for line in said.err.splitlines() if "%" in line]
    assert phases
    assert all(line.endswith("simulated") for line in phases)
    assert run(["runs", "--dir", "mine", "--json"]) == 0
    (listed,) = json.loads(capsys.readouterr().out)
    assert listed["simulated"] is True
    assert run(["runs", "--dir", "mine"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[1] == "simulated"
    assert run(["export", "last", "--csv", "--dir", "mine"]) == 0
    assert "simulated" in capsys.readouterr().err


def test_a_daemon_without_a_word_is_refused_where_a_rig_is_set_up(
    here: Installation, capsys: pytest.CaptureFixture[str]
) -> None:
    put(here.rig_file)
    assert run(["daemon", "--socket", "s/daemon.sock"]) == 2
    said = capsys.readouterr().err
    assert f"--config {here.rig_file}" in said
    assert "--simulated" in said
    assert not Path("s").exists()


def test_the_picture_of_a_simulated_run_says_so(run_path: Path) -> None:
    from needle_rig.figures.run import run_figure
    from needle_rig.recording import RunFile

    assert RunFile(run_path).simulated
    figure = run_figure(RunFile(run_path))
    assert "simulated" in figure.get_suptitle()


def test_runs_and_export_know_the_folder_of_the_service(
    here: Installation, run_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    here.runs.mkdir(parents=True)
    (here.runs / run_path.name).write_bytes(run_path.read_bytes())
    for named in ((), ("--config", str(here.rig_file))):
        assert run(["runs", "--json", *named]) == 0
        # a folder that is not absolute in the rig file lies in the service's
        assert json.loads(capsys.readouterr().out) == []
    put(here.rig_file, here.rig_file.read_text().replace("directory: runs", "directory: /var/lib/needle-rig"))
    for named in ((), ("--config", str(here.rig_file))):
        assert run(["runs", "--json", *named]) == 0
        assert [found["name"] for found in json.loads(capsys.readouterr().out)] == [run_path.stem]
    assert run(["export", "last", "--csv", "--out", "out"]) == 0


def test_diagnose_last_takes_the_newest_run_of_the_service(
    here: Installation, run_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from needle_rig.cli import _workbench

    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    put(here.rig_file, here.rig_file.read_text().replace("directory: runs", "directory: /var/lib/needle-rig"))
    assert run(["diagnose", "last"]) == 2
    assert str(here.runs) in capsys.readouterr().err
    here.runs.mkdir(parents=True)
    (here.runs / run_path.name).write_bytes(run_path.read_bytes())
    assert _workbench.newest((Path("last"),)) == (here.runs / run_path.name,)
    put(Path("last"))  # a file of that name is meant first
    assert _workbench.newest((Path("last"),)) == (Path("last"),)


def test_a_dataset_of_a_simulated_run_says_so(
    here: Installation, run_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from needle_rig.dataset import read_dataset

    assert run(["export", str(run_path), "--dataset", "--out", "exported"]) == 0
    assert "the rig was simulated" in capsys.readouterr().err
    assert "simulated: true" in Path("exported/dataset.yaml").read_text()
    exported = read_dataset("exported")
    assert exported.simulated
    assert not any("simulated" in note for note in exported.notes)
    described = Path("exported/dataset.yaml").read_text().replace("simulated: true\n", "")
    put(Path("exported/dataset.yaml"), described)
    assert not read_dataset("exported").simulated


def test_simulated_and_real_runs_are_kept_apart(run_path: Path) -> None:
    from needle_rig.errors import BadInput
    from needle_rig.recording import RunFile
    from needle_rig.workbench.observations.runs import runs_as_dataset

    class Real(RunFile):
        @property
        def simulated(self) -> bool:
            return False

    with pytest.raises(BadInput, match="was made on a simulated rig, others were not"):
        runs_as_dataset([Real(run_path), RunFile(run_path)])
    assert not runs_as_dataset([Real(run_path)]).simulated


def test_a_rig_file_of_the_working_folder_comes_before_the_service(
    here: Installation, capsys: pytest.CaptureFixture[str]
) -> None:
    put(here.rig_file, shipped_file("rig.hardware.yaml").read_text())
    put(
        Path("config/rig.yaml"),
        shipped_file("rig.yaml").read_text().replace("directory: runs", "directory: my"),
    )
    assert run(["runs"]) == 0
    assert "No runs in my" in capsys.readouterr().out
