"""The page on devices of one's own: its example keeps the contract, its rig file can be read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from needle_rig.cli.check_device import command
from needle_rig.config.loader import parse_rig_config
from needle_rig.config.schema import Cia402Drive, NetFtTorque, TextHall
from needle_rig.devices.contract import check_device
from needle_rig.simulation.nodes.twins import DriveTwin
from needle_rig.wire.text_lines import decode_line

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "own-device.md").read_text(encoding="utf-8")


def block(language: str) -> str:
    found = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert len(found) == 1
    return str(found[0])


def test_the_example_prints_what_the_page_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "config" / "devices"
    folder.mkdir(parents=True)
    (folder / "amplifier.py").write_text(block("python"))
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(command, ["amplifier", "port=/dev/ttyUSB0"], standalone_mode=False)
    assert done.return_value == 0, done.output
    assert done.output.splitlines() == block("console").splitlines()[1:]


def test_its_rig_file_names_the_three_devices() -> None:
    shipped = (ROOT / "config" / "rig.hardware.yaml").read_text(encoding="utf-8")
    head, links, tail = re.split(r"(?m)^(links:\n(?:  .*\n)+)", shipped)
    assert "socketcan" in links
    config = parse_rig_config(head + block("yaml") + tail)
    found = (config.links.drive, config.links.torque, config.links.hall)
    assert [type(each) for each in found] == [Cia402Drive, NetFtTorque, TextHall]


def test_the_commented_devices_of_the_shipped_rig_file_are_those_of_the_page() -> None:
    shipped = (ROOT / "config" / "rig.hardware.yaml").read_text(encoding="utf-8")
    for line in block("yaml").splitlines()[2:]:
        assert f"  # {line}" in shipped


def test_the_sketchs_line_can_be_read() -> None:
    text = b"81234,0,4095,17,2048"
    check = 0
    for byte in text:
        check ^= byte
    read = decode_line(text + b"*%02X" % check, checksum=True)
    assert read is not None
    assert read.values == (0.0, 4095.0, 17.0, 2048.0)


def test_the_clauses_of_a_drive_are_as_many_as_the_page_says() -> None:
    options = Cia402Drive(device="cia402", node_id=5, position_units_per_turn=4e5, velocity_units_per_rpm=100)
    from needle_rig.devices.drive_cia402 import DriveCia402

    assert len(list(check_device(DriveCia402, options, lambda: DriveTwin(options)))) == 6 + 9
    assert "nine beside the first six" in PAGE
