"""The main job as a person runs it: `needle-rig compensate` in a folder of its own."""

import json
import math
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from needle_rig.cli.main import run
from needle_rig.recording import RunFile
from tests.closed_loop.shell import ROOT, Shell, all_gone, wait_for_line


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    shell = Shell(tmp_path)
    yield shell
    # no orphans, whatever happened in the test
    all_gone(shell.processes())


def tip_lag(motion: dict[str, Any]) -> float:
    return float(motion["base_deg"] - motion["hall_deg"][-1])


def check_schema(result: dict[str, Any]) -> None:
    assert list(result) == [
        *(
            "status",
            "target_deg",
            "strategy",
            "simulated",
            "parameters",
            "lag_deg",
            "motions",
            "final",
            "run",
        ),
        "fault_name",
    ]
    assert all(list(m) == ["phase", "base_deg", "torque_nmm", "hall_deg"] for m in result["motions"])
    final = result["final"]
    assert list(final) == ["base_deg", "torque_nmm", "hall_deg", "tip_lag_deg", "mean_deg", "range_deg"]
    assert final["hall_deg"] == result["motions"][-1]["hall_deg"]
    assert final["tip_lag_deg"] == pytest.approx(tip_lag(final), abs=1e-3)
    assert final["mean_deg"] == pytest.approx(math.fsum(final["hall_deg"]) / 4, abs=1e-3)
    assert final["range_deg"] == pytest.approx(max(final["hall_deg"]) - min(final["hall_deg"]), abs=1e-3)


@pytest.mark.whole
def test_rigid_tissue_is_aligned_as_the_model_says(shell: Shell) -> None:
    result = shell.compensate("--fast", "--parameters", "rig_rigid", "--out", "here")
    check_schema(result)
    assert (result["status"], result["strategy"], result["parameters"]) == (
        "aligned",
        "reed2008",
        "rig_rigid",
    )
    assert [m["phase"] for m in result["motions"]] == ["rotate", "overshoot", "back", "forward", "final"]
    assert tip_lag(result["motions"][0]) == pytest.approx(26.0, abs=0.5)
    assert result["lag_deg"] == pytest.approx(26.0, abs=0.5)
    assert abs(result["final"]["tip_lag_deg"]) <= 0.5
    assert Path(result["run"]).parent.name == "here"
    run = RunFile(shell.folder / result["run"])
    assert run.complete
    assert run.result == result
    assert run.attributes["parameters"] == "rig_rigid"
    assert len(run.table("ticks")) == pytest.approx(len(run.table("torque")), abs=2)


@pytest.mark.whole
def test_elastic_tissue_keeps_what_the_paper_measured(shell: Shell) -> None:
    result = shell.compensate("--fast")
    assert result["status"] == "not_aligned"
    assert tip_lag(result["motions"][0]) == pytest.approx(26.0, abs=1.0)
    assert result["final"]["tip_lag_deg"] == pytest.approx(12.0, abs=1.0)
    again = shell.compensate("--fast")
    assert {**again, "run": ""} == {**result, "run": ""}, "the same seed gives the same run"


@pytest.mark.whole
def test_the_extra_turn_leaves_less(shell: Shell) -> None:
    result = shell.compensate("--fast", "--strategy", "reed2008_elastic", "--extra", "12", "--seed", "7")
    assert 3.0 <= result["final"]["tip_lag_deg"] <= 6.0


@pytest.mark.whole
def test_a_miss_is_explained_and_can_be_required_not_to_be(shell: Shell) -> None:
    done = shell.run("compensate", "--target", "-45", "--fast", "--require-aligned", "--settle", "1")
    assert done.returncode == 1
    assert "needle-rig diagnose runs/" in done.stdout
    assert "✗ 8a" in done.stdout
    (picture,) = (shell.folder / "runs").glob("*.png")
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert f"picture: runs/{picture.name}" in done.stdout
    # not a terminal: one line a phase
    lines = done.stderr.splitlines()
    assert sum("moving" in line for line in lines) == 5
    assert sum("settling" in line for line in lines) == 5


@pytest.mark.real_time
def test_real_time_through_the_drivers_gives_the_same_angles(shell: Shell) -> None:
    fast = shell.compensate("--fast", "--settle", "0.5")
    real = shell.compensate("--settle", "0.5")
    for virtual, driven in zip(fast["motions"], real["motions"], strict=True):
        assert driven["base_deg"] == pytest.approx(virtual["base_deg"], abs=0.5)
        assert driven["hall_deg"] == pytest.approx(virtual["hall_deg"], abs=0.5)
        assert driven["torque_nmm"] == pytest.approx(virtual["torque_nmm"], abs=0.003)
    run = RunFile(shell.folder / real["run"])
    ticks = run.table("ticks")
    # every raw reading at its own rate, not only what the ticks saw
    assert len(run.table("hall")) > 3 * len(ticks)
    assert len(run.table("torque")) > 3 * len(ticks)


@pytest.mark.whole
@pytest.mark.parametrize("image", [[], pytest.param(["--image"], marks=pytest.mark.slow)])
def test_the_firmware_in_virtual_time_gives_the_same_angles(shell: Shell, image: list[str]) -> None:
    plant = shell.compensate("--fast", "--settle", "0.5")
    nodes = shell.compensate("--fast", "--settle", "0.5", "--rig", "bench", *image)
    for alone, behind in zip(plant["motions"], nodes["motions"], strict=True):
        assert behind["base_deg"] == pytest.approx(alone["base_deg"], abs=0.5)
        assert behind["hall_deg"] == pytest.approx(alone["hall_deg"], abs=0.5)
    run = RunFile(shell.folder / nodes["run"])
    # every reading that a node sent, five a tick
    assert len(run.table("torque")) == pytest.approx(5 * len(run.table("ticks")), rel=0.01)


@pytest.mark.whole
def test_a_protocol_runs_each_trial_from_a_relaxed_needle(shell: Shell) -> None:
    (shell.folder / "two.yaml").write_text(
        """
format: needle-rig-protocol/1
name: two
trials:
  - {kind: compensate, target_deg: 30, speed_deg_s: 45, settle_s: 0.5}
  - {kind: staircase, steps_deg: [40, 10], speed_deg_s: 30, settle_s: 0.5}
"""
    )
    done = shell.run("compensate", "--protocol", "two.yaml", "--fast", "--json")
    assert done.returncode == 0, done.stderr
    first, second = map(json.loads, done.stdout.splitlines())
    assert first["target_deg"] == 30
    assert [round(m["base_deg"]) for m in second["motions"]] == [40, 10]
    assert RunFile(shell.folder / second["run"]).table("ticks")["hall_rad"][0] == pytest.approx(
        [0] * 4, abs=0.03
    )


@pytest.mark.whole
def test_ctrl_c_stops_the_drive_and_closes_the_run(shell: Shell) -> None:
    with shell.start("compensate", "--target", "45", "--fast", "--settle", "600", "--no-picture") as process:
        wait_for_line(process, lambda line: "rotate     settling" in line)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 4, err
    assert "the drive is stopped and the run is closed" in err
    assert "Traceback" not in err
    (path,) = (shell.folder / "runs").glob("*.h5")
    run = RunFile(path)
    assert run.complete
    assert run.result is not None
    assert run.result["status"] == "aborted"
    last = run.table("ticks")[-1]
    assert last["phase"] == b"aborted"
    assert not last["enable"]
    assert last["velocity_rad_s"] == 0.0


@pytest.mark.whole
@pytest.mark.parametrize("place", ["virtual", pytest.param("real", marks=pytest.mark.real_time)])
def test_a_killed_client_leaves_nothing_behind(shell: Shell, place: str) -> None:
    fast = ["--fast"] if place == "virtual" else []
    arguments = ["compensate", "--target", "45", *fast, "--settle", "600", "--no-picture"]
    with shell.start(*arguments) as process:
        wait_for_line(process, lambda line: "rotate" in line)
        alive = shell.processes()
        assert len(alive) == (4 if fast else 5), alive
        process.kill()
        all_gone(alive)
    (path,) = (shell.folder / "runs").glob("*.h5")
    run = RunFile(path)
    assert run.complete
    assert not run.table("ticks")[-1]["enable"]


@pytest.mark.whole
def test_a_killed_daemon_is_told_and_leaves_nothing_behind(shell: Shell) -> None:
    with shell.start("compensate", "--target", "45", "--fast", "--settle", "600", "--no-picture") as process:
        wait_for_line(process, lambda line: "rotate" in line)
        alive = shell.processes()
        (daemon,) = (pid for pid, line in alive.items() if "daemon --private" in line)
        os.kill(daemon, signal.SIGKILL)
        _, err = process.communicate(timeout=60)
        all_gone(alive)
    assert process.returncode == 3
    assert "the daemon ended during the motion" in err.splitlines()[-1]
    (path,) = (shell.folder / "runs").glob("*.journal")
    assert len(RunFile(path).table("ticks")) > 0
    assert "cut off" in shell.run("runs").stdout


DUPLICATE = "format: needle-rig/1\nname: a\nname: b\n"


@pytest.mark.parametrize(
    ("arguments", "code", "wanted"),
    [
        (["--target", "nan"], 2, "nan"),
        (["--target", "1e3", "--fast"], 2, "outside ±720°"),
        pytest.param(["--target", "1e9", "--fast"], 2, "is above 3600", marks=pytest.mark.whole),
        (["--target", "abc"], 2, "abc"),
        ([], 2, "--target"),
        (["--target", "45", "--config", "missing.yaml"], 2, "missing.yaml"),
        (["--target", "45", "--config", "duplicate.yaml"], 2, "duplicate.yaml:3"),
        pytest.param(["--target", "45", "--config", "port.yaml"], 3, "/dev/ttyNONE", marks=pytest.mark.whole),
        (["--target", "45", "--fast", "--parameters", "nonsense"], 2, "nonsense"),
        pytest.param(
            ["--target", "45", "--fast", "--strategy", "nonsense"], 2, "reed2008", marks=pytest.mark.whole
        ),
        (["--target", "45", "--fast", "--option", "nonsense"], 2, "NAME=VALUE"),
        (["--target", "45", "--fast", "--settle", "inf"], 2, "inf"),
        pytest.param(
            ["--target", "45", "--fast", "--out", "/proc/nowhere"],
            2,
            "/proc/nowhere",
            marks=pytest.mark.whole,
        ),
        (["--target", "45", "--socket", "nobody.sock"], 3, "no daemon answers at nobody.sock"),
        (["--target", "45", "--socket", "nobody.sock", "--fast"], 2, "--fast"),
    ],
)
def test_bad_use_is_one_sentence(
    shell: Shell,
    arguments: list[str],
    code: int,
    wanted: str,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (shell.folder / "duplicate.yaml").write_text(DUPLICATE)
    rig = (ROOT / "config" / "rig.yaml").read_text().replace("port: auto", "port: /dev/ttyNONE")
    (shell.folder / "port.yaml").write_text(rig)
    monkeypatch.chdir(shell.folder)
    for name, value in shell.environment.items():
        monkeypatch.setenv(name, value)
    ended = run(["compensate", "--json", *arguments])
    said = capfd.readouterr()
    assert ended == code, said.err
    assert said.out == ""
    assert wanted in said.err
    assert len(said.err.splitlines()) == 1, said.err
    assert not list(shell.folder.glob("runs/*"))


def test_exit_codes_are_documented(shell: Shell) -> None:
    text = shell.run("compensate", "--help").stdout
    for code in ("0  the sequence ran", "1  it is not aligned", "2  bad use", "3  a fault", "4  stopped"):
        assert code in text
