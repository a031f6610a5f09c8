"""The rig around its devices: who is missing, who has a defect, who is set up anew."""

from __future__ import annotations

import asyncio
import math
import socket
import threading
from pathlib import Path

import pytest
from click.testing import CliRunner

from needle_rig.cli.check import _network_sensor
from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import NetFtTorque, RigConfig
from needle_rig.devices.hardware_rig import HardwareRig, RealHost
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import DriveState
from needle_rig.simulation.nodes.netft_sensor import NetFtPorts, NetFtSensor
from needle_rig.simulation.nodes.slcan_hub import Pty
from tests.closed_loop.other_devices import DRIVE, HALL, TORQUE, VirtualRig, config_of


def test_a_device_that_raises_is_a_complaint_of_its_link_and_not_the_end_of_the_tick() -> None:
    host = RealHost(config_of(), None, lambda: 1.0)
    heard: list[bytes] = []

    def bad(frame_id: int, data: bytes, now_s: float) -> None:
        raise IndexError("no such byte")

    host.kind = "torque"
    host.can(bad)
    host.kind = "drive"
    host.can(lambda frame_id, data, now_s: heard.append(data))
    host._on_frames([(1, b"x"), (2, b"y")], 1.0)
    assert host.defects == {"torque": "its device has a defect: IndexError: no such byte"}
    assert heard == [b"x", b"y"]


def test_a_defect_stands_in_the_measurement() -> None:
    rig = VirtualRig(config_of())
    rig.host.defects["hall"] = "its device has a defect: IndexError: no such byte"
    assert rig.read().hall_complaint == "its device has a defect: IndexError: no such byte"
    assert rig.read().torque_complaint == ""


@pytest.mark.parametrize("link", ["torque", "drive", "hall"])
def test_each_devices_complaint_is_that_of_its_own_link(link: str) -> None:
    rig = VirtualRig(config_of())
    rig.rig._trouble[{"torque": rig.rig._torque, "drive": rig.rig._drive, "hall": rig.rig._hall}[link]] = "x"
    now = rig.read()
    told = {"torque": now.torque_complaint, "drive": now.drive_complaint, "hall": now.hall_complaint}
    assert told == {each: "x" if each == link else "" for each in told}


def test_nothing_is_known_of_devices_that_were_not_heard() -> None:
    now = HardwareRig(config_of()).read()
    assert (now.torque_age_s, now.hall_age_s, now.drive_age_s) == (math.inf,) * 3
    assert math.isnan(now.base_angle_rad)
    assert now.drive_state is DriveState.SILENT
    assert len(now.hall_rad) == 4
    assert not now.referenced


def with_ports(hall_port: str, ports: NetFtPorts, can_port: str) -> RigConfig:
    _, rdt_port, http_port = ports.place.split(":")
    torque = TORQUE.model_copy(
        update={"address": "127.0.0.1", "rdt_port": int(rdt_port), "http_port": int(http_port)}
    )
    config = config_of(DRIVE, torque, HALL.model_copy(update={"port": hall_port}))
    can = config.links.can.model_copy(update={"interface": "slcan", "channel": can_port})
    return config.model_copy(update={"links": config.links.model_copy(update={"can": can})})


def served(ports: NetFtPorts) -> threading.Thread:
    """Answers one page."""

    def serve() -> None:
        page = ports.waited_on[1]
        page.setblocking(True)
        page.settimeout(10)
        ports.serve(page)

    thread = threading.Thread(target=serve)
    thread.start()
    return thread


def test_a_drive_that_does_not_answer_ends_the_opening_with_one_sentence_and_free_ports() -> None:
    ports, hall, can = NetFtPorts(NetFtSensor(TORQUE)), Pty(), Pty()
    try:
        for _ in range(2):  # the second finds the ports free
            rig, thread = HardwareRig(with_ports(hall.name, ports, can.name)), served(ports)
            with pytest.raises(RigFault, match=r"CANopen node 5 \(slcan /dev/pts/\d+\) does not answer"):
                asyncio.run(rig.open())
            thread.join()
    finally:
        ports.close()
        hall.close()
        can.close()


def test_check_tells_what_the_page_of_a_sensor_says() -> None:
    ports = NetFtPorts(NetFtSensor(TORQUE))
    http_port = ports.place.rpartition(":")[2]
    thread = served(ports)
    sensor = NetFtTorque(device="netft", address="127.0.0.1", http_port=int(http_port))
    found = _network_sensor(sensor)
    thread.join()
    ports.close()
    assert found.verdict == "ok"
    assert found.text == "127.0.0.1: 6.4e+07 counts per N·m, 7000 samples/s"
    with socket.create_server(("127.0.0.1", 0)) as nobody:
        free = nobody.getsockname()[1]
    found = _network_sensor(sensor.model_copy(update={"http_port": free}))
    assert found.verdict == "fail"
    assert "connection refused" in found.text


@pytest.mark.parametrize(
    ("section", "told"),
    [
        ("torque: {device: netft, address: 10.0.0.1}", "netft cannot go with the drive node, which stops"),
        (
            "hall: {device: text, port: x, angle: counts}",
            "goes with angle: counts alone (it is counts); give it",
        ),
        ("hall: {device: text, port: x, counts_per_turn: 4096}", "(it is deg); take it away, or say angle"),
        (
            "drive: {device: cia402, node_id: 5}",
            "position_units_per_turn, velocity_units_per_rpm are missing",
        ),
        ("drive: {device: cia402, nodeid: 5}", "links.drive.nodeid: unknown key; did you mean node_id?"),
        ("torque: {device: netft}", "links.torque: address is missing; add it"),
    ],
)
def test_contradictions_of_a_rig_file_are_told_with_their_place(
    tmp_path: Path, section: str, told: str
) -> None:
    text = (Path(__file__).parents[3] / "config" / "rig.hardware.yaml").read_text(encoding="utf-8")
    key = section.partition(":")[0]
    lines = [line for line in text.splitlines() if not line.startswith(f"  {key}: ")]
    place = lines.index("links:") + 1
    path = tmp_path / "rig.yaml"
    path.write_text("\n".join([*lines[:place], f"  {section}", *lines[place:]]) + "\n", encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        load_rig_config(path)
    assert told in str(refused.value)
    assert f"{path.name}:{place + 1}:" in str(refused.value)


OTHERS = """\
  drive: {device: cia402, node_id: 5, position_units_per_turn: 409600, velocity_units_per_rpm: 100}
"""


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--errors", "3"), "--errors, --pages: are for our nodes' firmware"),
        (("--pages", "x"), "--errors, --pages: are for our nodes' firmware"),
        (
            ("--image",),
            "simulation.nodes: image runs this project's firmware, and links.drive.device: cia402",
        ),
    ],
)
def test_a_bench_of_other_devices_refuses_what_only_our_nodes_have(
    tmp_path: Path, options: tuple[str, ...], told: str
) -> None:
    from needle_rig.cli.bench import command

    text = (Path(__file__).parents[3] / "config" / "rig.yaml").read_text(encoding="utf-8")
    path = tmp_path / "rig.yaml"
    head, _, tail = text.partition("  hall: {port")
    path.write_text(f"{head}{OTHERS}  hall: {{port{tail}", encoding="utf-8")
    arguments = ["--config", str(path), "--ports", str(tmp_path), *options]
    done = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert isinstance(done.exception, BadInput)
    assert told in str(done.exception)
