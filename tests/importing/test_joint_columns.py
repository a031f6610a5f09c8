"""Columns of drives and joints: copies, forces by name, currents, speeds in hertz, streams without names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needle_rig.importing import Mapping, guess, read_recording
from needle_rig.importing.mapping import ChannelPart
from needle_rig.importing.unit_text import split_name
from needle_rig.numerics import Array
from needle_rig.physics.machine import MachineName
from tests.importing.machines import Joint, after_play, csv, swings


def guessed(folder: Path, columns: dict[str, Array], machine: MachineName) -> Mapping:
    lever_mm = 10.0 if machine == "linear" else None
    return guess([read_recording(csv(folder / "log.csv", columns))], "log", None, folder, machine, lever_mm)


def channel(mapping: Mapping, role: str) -> ChannelPart:
    return next(c for c in mapping.channels if c.role == role)


def moved() -> tuple[Array, Array, Array, Array]:
    time_s, angle, rate = swings(15.0, 100.0)
    return time_s, angle, rate, Joint().torque_nm(angle, rate, np.random.default_rng(1))


def test_an_encoder_at_the_motor_and_over_a_gear_is_one_angle(tmp_path: Path) -> None:
    time_s, angle, _, torque = moved()
    far = after_play(angle, 0.05)
    columns = {"t [s]": time_s, "a1 position [rad]": angle, "c1 position [rev]": angle / (2 * np.pi)}
    columns |= {"c2 position [rev]": 6 * far / (2 * np.pi), "a2 position [rad]": far, "cell [Nm]": torque}
    mapping = guessed(tmp_path, columns, "shaft")
    assert [c.source for c in mapping.channels if c.role.startswith("angle")] == ["a2 position [rad]"]
    why = {part.source: part.why for part in mapping.not_used}
    assert why["c2 position [rev]"] == "a2 position [rad] once more"


@pytest.mark.parametrize(
    ("name", "stem", "unit"),
    [("Force_N", "Force", "N"), ("force_kN", "force", "kN"), ("hall_N", "hall_N", ""), ("Fz N", "Fz", "N")],
)
def test_newtons_are_a_unit_of_forces_alone(name: str, stem: str, unit: str) -> None:
    assert split_name(name) == (stem, unit)


def test_a_force_in_volts_is_asked_of_a_slide(tmp_path: Path) -> None:
    time_s, angle, _, torque = moved()
    columns = {"t [s]": time_s, "Input 1 [V]": angle, "Force [V]": 10 * torque}
    force = channel(guessed(tmp_path, columns, "linear"), "base_torque")
    assert force.source == "Force [V]"
    assert force.doubt


def test_a_current_stands_for_the_torque_of_a_joint_alone(tmp_path: Path) -> None:
    time_s, angle, _, torque = moved()
    columns = {"t [s]": time_s, "position [rad]": angle, "Iq [A]": 30 * torque}
    asked = channel(guessed(tmp_path, columns, "joint"), "base_torque")
    assert asked.source == "Iq [A]"
    assert "the motor's constant in N·m/A" in asked.doubt
    columns["torque [Nm]"] = torque
    assert channel(guessed(tmp_path, columns, "joint"), "base_torque").source == "torque [Nm]"


def test_a_speed_in_hertz_is_asked(tmp_path: Path) -> None:
    time_s, _, rate, torque = moved()
    columns = {"t [s]": time_s, "c1 vel [Hz]": rate / (2 * np.pi), "torque [Nm]": torque}
    mapping = guessed(tmp_path, columns, "joint")
    base = channel(mapping, "base_angle")
    assert base.unit == "turn/s"
    assert "turns a second" in base.doubt
    assert mapping.trials.start == "wound"


def test_a_torque_in_its_unit_comes_before_a_raw_load_cell(tmp_path: Path) -> None:
    time_s, angle, _, torque = moved()
    columns = {"t [s]": time_s, "q [rad]": angle, "Left Load Cell [mV]": torque, "Torque [Nm]": torque}
    assert channel(guessed(tmp_path, columns, "joint"), "base_torque").source == "Torque [Nm]"
