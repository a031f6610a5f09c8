"""Recordings of machines that are no needle: from the file to what its owner asks, by the command line."""

from __future__ import annotations

import contextlib
import io
import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset
from needle_rig.errors import BadInput
from needle_rig.importing.axes import drift, summed
from needle_rig.importing.shaft import read_rig
from needle_rig.notebook import import_recording
from needle_rig.numerics import Array
from needle_rig.physics.machine import MACHINES, NEEDLE
from tests.importing import machines
from tests.importing.machines import Joint, swings


@dataclass(frozen=True)
class Answer:
    exit_code: int
    stdout: str
    output: str


def run(*words: str | Path) -> Answer:
    """A command line in this process."""
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        code = command(list(map(str, words)))
    return Answer(code, out.getvalue(), out.getvalue() + error.getvalue())


def imported(file: Path, out: Path, *words: str) -> str:
    done = run("import", file, "--guess", "--out", out, *words)
    assert done.exit_code == 0, done.output
    return done.output


def told(folder: Path) -> dict[str, Any]:
    """The estimates of `identify` by name."""
    done = run("identify", folder, "--json")
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout.splitlines()[-1])
    return {e["name"]: e for e in found["estimates"]}


def plain_fit(rate: Array, torque: Array) -> tuple[Array, Array]:
    """Coulomb, viscous, offset by scipy, with standard deviations; both of a plain script."""
    from scipy.optimize import curve_fit

    far = np.abs(rate) > 0.2  # beyond the presliding after a reversal

    def law(w: Array, coulomb: float, viscous: float, offset: float) -> Array:
        return offset + coulomb * np.sign(w) + viscous * w

    at, covariance = curve_fit(law, rate[far], torque[far])
    return np.asarray(at), np.sqrt(np.diag(covariance))


def columns(file: Path) -> Array:
    return np.genfromtxt(file, delimiter=",", skip_header=1)


@pytest.mark.whole
def test_a_joint_that_moves_when_its_log_begins(tmp_path: Path) -> None:
    file = machines.plain_joint(tmp_path)
    said = imported(file, tmp_path / "o", "--machine", "joint")
    assert "not used" not in said
    layout = yaml.safe_load((tmp_path / "o/dataset.yaml").read_text())["rig"]
    assert layout["machine"] == "joint"
    assert layout["hall_sensors"] == []
    found = told(tmp_path / "o")
    assert list(found) == ["coulomb", "viscous", "offset", "stribeck"]
    time_s, angle, torque = columns(file).T
    (at, _), truth = plain_fit(np.gradient(angle, time_s), 1e3 * torque), Joint()
    for name, scipys, true in (
        ("coulomb", at[0], truth.coulomb_nm),
        ("viscous", at[1], truth.viscous_nms_per_rad),
        ("offset", at[2], truth.offset_nm),
    ):
        low, high = found[name]["interval"]
        assert low <= scipys <= high
        assert low <= 1e3 * true <= high
    assert found["stribeck"]["value"] is None


@pytest.mark.whole
@pytest.mark.parametrize(
    ("made", "words", "truth"),
    [
        (machines.speed_and_torque, ("--machine", "joint"), (168.0, 50.0, -50.0)),
        (machines.back_to_back, ("--machine", "shaft"), (800.0, 100.0, 20.0)),
        (machines.slide, ("--machine", "linear", "--lever", "10"), (16.8, 0.05, 0.0)),
        (machines.slide, ("--machine", "linear", "--lever", "37"), (16.8, 0.05, 0.0)),
    ],
)
def test_each_machine_tells_its_own_friction(
    tmp_path: Path, made: Callable[[Path], Path], words: tuple[str, ...], truth: tuple[float, ...]
) -> None:
    imported(made(tmp_path), tmp_path / "o", *words)
    found = told(tmp_path / "o")
    for name, true in zip(("coulomb", "viscous", "offset"), truth, strict=True):
        low, high = found[name]["interval"]
        reach = high - low
        assert low - 0.5 * reach <= true <= high + 0.5 * reach, name
        assert reach < 0.1 * max(abs(true), abs(truth[0]))
    compared = run("compare", tmp_path / "o")
    assert compared.exit_code == 0, compared.output
    assert "torque" in compared.stdout


@pytest.mark.whole
def test_a_cable_is_told_by_its_angles(tmp_path: Path) -> None:
    imported(machines.cable_probe(tmp_path), tmp_path / "o", "--machine", "cable")
    answer = run("diagnose", "--quick", tmp_path / "o")
    assert answer.exit_code == 0, answer.output
    gain = re.search(r"hall_gain.gain_error\[0\] = (-?[\d.]+)", answer.stdout)
    assert gain is not None
    assert float(gain[1]) == pytest.approx(-0.3, abs=0.01)
    assert not re.search(r"chuck_|tissue_|guide_|insertion_", answer.stdout)
    ratio = told(tmp_path / "o")["friction_over_rigidity"]
    assert ratio["value"] > 0


def test_the_second_angle_of_servos_is_found_without_a_layout(tmp_path: Path) -> None:
    file = machines.servo_ticks(tmp_path)
    asked = run("import", file, "--guess", "--out", tmp_path / "o")
    assert asked.exit_code == 2
    assert "no layout is given; by the channels it is a cable that turns or bends a far end" in asked.output
    taken = run("import", file, "--guess", "--yes", "--out", tmp_path / "p")
    assert taken.exit_code == 0, taken.output
    assert read_dataset(tmp_path / "p").machine == "cable"
    assert run("compare", tmp_path / "p").exit_code == 0


@pytest.mark.whole
def test_of_seven_joints_the_moving_one_is_taken(tmp_path: Path) -> None:
    asked = run(
        "import", machines.robot_joint(tmp_path), "--guess", "--machine", "joint", "--out", tmp_path / "o"
    )
    assert asked.exit_code == 2  # a bare array has no unit of torque
    mapping = yaml.safe_load((tmp_path / "o.yaml").read_text())
    assert [c["source"] for c in mapping["channels"]] == ["q.6", "tau_measured.6"]
    mapping["channels"][1] |= {"unit": "N·m", "doubt": ""}
    (tmp_path / "o.yaml").write_text(yaml.safe_dump(mapping), encoding="utf-8")
    done = run("import", tmp_path / "o.yaml", "--out", tmp_path / "o")
    assert done.exit_code == 0, done.output
    low, high = told(tmp_path / "o")["coulomb"]["interval"]
    assert low < 168.0 < high


@pytest.mark.parametrize("unit", ["rad/s", "rpm"])
def test_a_speed_is_integrated_and_its_drift_told(tmp_path: Path, unit: str) -> None:
    said = imported(machines.speed_and_torque(tmp_path, unit=unit), tmp_path / "o", "--machine", "joint")
    assert "base_angle is integrated from velocity" in said
    assert re.search(r"its noise makes it drift by [\d.]+°", said)
    trial = read_dataset(tmp_path / "o").trials[0]
    _, angle, _ = swings()
    away = trial.base_measured_rad - (angle - angle[0])
    assert np.abs(away).max() < np.radians(0.3)


def test_the_drift_that_is_told_covers_what_noise_does() -> None:
    rng = np.random.default_rng(1)
    time_s, angle, rate = swings()
    ends = []
    for _ in range(200):
        noisy = rate + 0.02 * rng.standard_normal(len(rate))
        ends.append(summed(time_s, noisy)[-1] - angle[-1])
    walk, _, stands = drift(time_s, noisy)
    assert np.std(ends) == pytest.approx(walk, rel=0.25)
    assert not stands
    still = np.concatenate((np.zeros(400), rate)) + 0.01
    walk, zero, stands = drift(np.arange(len(still)) / machines.RATE_HZ, still)
    assert stands
    assert zero == pytest.approx(0.01 * (len(still) - 1) / machines.RATE_HZ, rel=0.05)


def test_what_slides_asks_for_its_lever(tmp_path: Path) -> None:
    file = machines.slide(tmp_path)
    asked = run("import", file, "--guess", "--out", tmp_path / "o", "--machine", "linear")
    assert asked.exit_code == 2
    assert "rig.lever_mm: base_angle in mm, base_torque in N" in asked.output
    again = run("import", tmp_path / "o.yaml", "--lever", "10", "--out", tmp_path / "o")
    assert again.exit_code == 0, again.output
    dataset = read_dataset(tmp_path / "o")
    assert dataset.lever_m == pytest.approx(0.01)
    assert np.ptp(dataset.trials[0].base_measured_rad) == pytest.approx(np.ptp(swings()[1]), rel=1e-3)
    assert read_rig(tmp_path / "o").lever_mm == 10.0
    assert run("import", file, "--guess", "--lever", "0", "--out", tmp_path / "p").exit_code == 2


def test_python_has_the_same_words(tmp_path: Path) -> None:
    import_recording(machines.slide(tmp_path), out=tmp_path / "o", machine="linear", lever_mm=10.0)
    assert read_dataset(tmp_path / "o").machine == "linear"
    with pytest.raises(BadInput, match="crane: is no machine known here; name one of needle, joint"):
        import_recording(machines.plain_joint(tmp_path), out=tmp_path / "p", machine="crane")


def test_a_layout_may_leave_its_sensors_out(tmp_path: Path) -> None:
    layout = {"needle": {"torsional_rigidity_nmm2": "unknown"}, "needle_length_mm": 100}
    layout |= {"tissue_sections_mm": [[0, 100]], "machine": "joint"}
    (tmp_path / "act.yaml").write_text(yaml.safe_dump(layout), encoding="utf-8")
    imported(machines.plain_joint(tmp_path), tmp_path / "o", "--layout", str(tmp_path / "act.yaml"))
    assert read_dataset(tmp_path / "o").sensor_names == ()


@pytest.mark.parametrize("machine", sorted(set(MACHINES) - {NEEDLE}))
def test_every_machine_has_a_layout(tmp_path: Path, machine: str) -> None:
    lever = ("--lever", "10") if machine == "linear" else ()
    imported(machines.plain_joint(tmp_path), tmp_path / "o", "--machine", machine, *lever)
    assert read_dataset(tmp_path / "o").machine == machine


FLAT: dict[str, Callable[[int], dict[str, Any]]] = {
    "no motion": lambda n: {"q [rad]": np.zeros(n), "tau [Nm]": 0.1 * np.sin(np.arange(n))},
    "all equal": lambda n: {"q [rad]": np.full(n, 0.3), "tau [Nm]": np.full(n, 0.1)},
    "no torque": lambda n: {"q [rad]": np.sin(0.02 * np.arange(n))},
    "a torque that stands": lambda n: {"q [rad]": np.sin(0.02 * np.arange(n)), "tau [Nm]": np.full(n, 0.1)},
    "a tip that stands": lambda n: {"q [rad]": np.sin(0.02 * np.arange(n)), "tip [rad]": np.zeros(n)},
    "a tip and a torque that stand": lambda n: {
        "q [rad]": np.sin(0.02 * np.arange(n)),
        "tip [rad]": 1e-5 * np.sin(np.arange(n)),
        "tau [Nm]": np.zeros(n),
    },
    "one way": lambda n: {"q [rad]": 0.002 * np.arange(n), "tau [Nm]": 0.1 + 0.001 * np.sin(np.arange(n))},
    "one speed both ways": lambda n: {
        "q [rad]": np.abs((0.002 * np.arange(n)) % 2.0 - 1.0),
        "tau [Nm]": -0.1 * np.sign((0.002 * np.arange(n)) % 2.0 - 1.0) * -1.0 + 0.001 * np.sin(np.arange(n)),
    },
    "a speed of nothing": lambda n: {"velocity [rad/s]": np.zeros(n), "tau [Nm]": 0.1 * np.sin(np.arange(n))},
    "a torque of nothing but noise": lambda n: {
        "q [rad]": np.sin(0.02 * np.arange(n)),
        "tau [Nm]": np.random.default_rng(0).standard_normal(n),
    },
}


@pytest.mark.whole
@pytest.mark.parametrize("rows", [2, 30, 1500])
@pytest.mark.parametrize("shape", FLAT)
def test_a_degenerate_recording_ends_in_a_sentence(tmp_path: Path, shape: str, rows: int) -> None:
    file = machines.csv(
        tmp_path / "flat.csv", {"t [s]": np.arange(rows) * np.float64(0.01), **FLAT[shape](rows)}
    )
    done = run("import", file, "--guess", "--yes", "--machine", "joint", "--out", tmp_path / "o")
    words = [done]
    if done.exit_code == 0:
        words += [run(question, tmp_path / "o") for question in ("compare", "identify")]
    for answer in words:
        assert answer.exit_code in (0, 2), answer.output
        assert "nan" not in answer.output.lower().split()
        assert len(answer.output.strip()) > 20
