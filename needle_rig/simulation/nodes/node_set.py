"""The devices of a bench: nodes in Python, the firmware itself behind an analogue front end, or others'."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from needle_rig.config.schema import (
    Cia402Drive,
    DeviceFile,
    LinksSection,
    NetFtTorque,
    RigConfig,
    SimulationSection,
    TextHall,
)
from needle_rig.errors import BadInput
from needle_rig.records import DriveFault, DriveState, Measurement
from needle_rig.simulation.nodes.analogue import ADC_MID, AnalogueFrontEnd, SensorErrors
from needle_rig.simulation.nodes.cia402_node import Cia402Node
from needle_rig.simulation.nodes.front_end import Inputs, inputs
from needle_rig.simulation.nodes.netft_sensor import NetFtSensor
from needle_rig.simulation.nodes.python_nodes import DriveNode, HallNode, TorqueNode
from needle_rig.simulation.nodes.slcan_hub import Frame
from needle_rig.simulation.nodes.text_sensors import TextSensors
from needle_rig.wire.can_frames import CanCodec

FIRMWARE_SENSORS, FIRMWARE_RATE_HZ = 4, 1000


class Torque(Protocol):
    """The torque node."""

    def step(self, now_us: int, torque_counts: int) -> tuple[Frame, ...]:
        """The frames of one sample."""


class Hall(Protocol):
    """The Hall node."""

    def step(self, now_us: int, pairs: Sequence[tuple[int, int]]) -> bytes:
        """The bytes of one sample."""


class Drive(Protocol):
    """The drive node."""

    @property
    def state(self) -> DriveState:
        """State of its guard."""

    @property
    def faults(self) -> DriveFault:
        """Why it stands in FAULT."""

    @property
    def powered(self) -> bool:
        """Whether the motor is on."""

    @property
    def supply_on(self) -> bool:
        """Whether the motor may have its supply."""

    def reset(self, now_us: int) -> None:
        """The node restarts."""

    def receive(self, now_us: int, frame_id: int, data: bytes) -> None:
        """A frame seen on the bus."""

    def step(
        self, now_us: int, encoder_counts: int, *, index: bool = False, emergency_stop: bool = False
    ) -> tuple[tuple[Frame, ...], float]:
        """The frames of one sample, and the velocity in rad/s asked of the motor."""


@dataclass(frozen=True)
class NodeSet:
    """Drive and sensors, and what makes counts for their inputs of what the plant's sensors feel."""

    torque: Torque
    hall: Hall
    drive: Drive
    inputs: Callable[[Measurement], Inputs]
    front_end: AnalogueFrontEnd | None = None
    netft: NetFtSensor | None = None
    """Stands in the torque node's place when it is there."""
    no_field: tuple[int, int] = (0, 0)
    """Counts of a Hall sensor whose magnet is out of reach."""


def build_nodes(config: RigConfig, codec: CanCodec) -> NodeSet:
    """The nodes that `config`'s simulation section names. Raises BadInput when they cannot be made."""
    simulation, links = config.simulation, config.links
    others = _others(links)
    if simulation is None or simulation.nodes == "python":
        return NodeSet(
            TorqueNode(codec),
            TextSensors(links.hall) if isinstance(links.hall, TextHall) else HallNode(),
            Cia402Node(links.drive)
            if isinstance(links.drive, Cia402Drive)
            else DriveNode(codec, config.drive),
            inputs,
            netft=NetFtSensor(links.torque) if isinstance(links.torque, NetFtTorque) else None,
        )
    if others:
        raise BadInput(
            f"simulation.nodes: {simulation.nodes} runs this project's firmware, and {', '.join(others)} is"
            " another device; leave it at python"
        )
    sensors = len(config.layout.hall_sensors)
    if sensors != FIRMWARE_SENSORS:
        raise BadInput(
            f"layout.hall_sensors: the Hall node's firmware has {FIRMWARE_SENSORS} sensors, not {sensors}; "
            "leave simulation.nodes at python for another number"
        )
    if simulation.sensor_rate_hz > FIRMWARE_RATE_HZ:
        raise BadInput(
            f"simulation.sensor_rate_hz: {simulation.sensor_rate_hz:g} Hz; the firmware samples at "
            f"{FIRMWARE_RATE_HZ} Hz at most"
        )
    front_end = AnalogueFrontEnd(
        SensorErrors.planted(simulation.sensor_errors_seed, sensors), simulation.seed
    )
    return NodeSet(*_firmware(simulation), front_end.inputs, front_end, no_field=(ADC_MID, ADC_MID))


def _others(links: LinksSection) -> list[str]:
    """The devices that are no node of this project. Raises BadInput for one that nobody simulates."""
    devices = {"drive": links.drive, "torque": links.torque, "hall": links.hall}
    for kind, section in devices.items():
        if isinstance(section, DeviceFile):
            raise BadInput(
                f"links.{kind}.device: {section.device} is a file of your own, which the simulated rig"
                f" lacks; say kind: hardware, or try it by itself: needle-rig check-device {section.device}"
            )
    return [f"links.{kind}.device: {s.device}" for kind, s in devices.items() if s.device != "node"]


def _firmware(simulation: SimulationSection) -> tuple[Torque, Hall, Drive]:
    from needle_rig.simulation.nodes.firmware_nodes import (
        DriveFirmware,
        FirmwareNodes,
        HallFirmware,
        TorqueFirmware,
    )

    pages = None if simulation.node_pages is None else Path(simulation.node_pages)
    made = FirmwareNodes(image=simulation.nodes == "image", pages=pages)
    return TorqueFirmware(made), HallFirmware(made), DriveFirmware(made)
