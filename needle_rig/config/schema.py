"""The typed configuration. Key names end in their unit; ranges are checked where the key stands."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag


class Section(BaseModel):
    """Every section refuses unknown keys and cannot be changed after it was read."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class NeedleSection(Section):
    """The needle: its stated constants."""

    diameter_mm: Annotated[float, Field(gt=0.05, le=5)]
    shear_modulus_gpa: Annotated[float, Field(gt=0.5, le=200)]
    density_g_cm3: Annotated[float, Field(gt=0.5, le=25)]
    length_mm: Annotated[float, Field(gt=10, le=2000)]
    torsional_rigidity_nmm2: Annotated[float, Field(gt=0.01, le=1e6)] | None = None
    """JG where it is stated as one number; otherwise it follows from diameter and modulus."""


class HallSensor(Section):
    """One Hall sensor and where it sits along the needle, from the base."""

    name: str
    position_mm: Annotated[float, Field(ge=0, le=2000)]


class LayoutSection(Section):
    """Where the needle runs through tissue and where it is seen."""

    tissue_sections_mm: tuple[tuple[float, float], ...]
    hall_sensors: tuple[HallSensor, ...]


class CanSection(Section):
    """The CAN bus of torque node and drive; `interface` and `channel` as python-can names them."""

    interface: Literal["slcan", "socketcan", "virtual"] = "slcan"
    channel: str
    bitrate_kbit_s: Annotated[int, Field(ge=10, le=1000)] = 1000


class NodeDevice(Section):
    """A node with this project's firmware."""

    device: Literal["node"] = "node"


class Cia402Drive(Section):
    """A drive that speaks CiA 402 over CANopen, such as EPOS4, Elmo Gold and Nanotec's."""

    device: Literal["cia402"]
    node_id: Annotated[int, Field(ge=1, le=127)]
    mode: Literal["csv", "pv"] = "csv"
    """Cyclic synchronous velocity or profile velocity."""
    position_units_per_turn: Annotated[float, Field(ge=100, le=1e9)]
    """Units of object 0x6064 in one turn of the base, gear included."""
    velocity_units_per_rpm: Annotated[float, Field(ge=12, le=1e9)]
    """Units of object 0x60FF in one revolution per minute of the base; fewer than 12 are steps of 0.5°/s."""
    reversed: bool = False
    """The drive's positive way is clockwise seen from the base."""
    lost_host_ms: Annotated[int, Field(ge=10, le=100)] = 50
    """Without this computer's heartbeat for longer the drive stops by itself (object 0x1016)."""


class NetFtTorque(Section):
    """A force-torque sensor of ATI with Ethernet: Net F/T, Ethernet Axia."""

    device: Literal["netft"]
    address: str
    """Its IP address; the factory sets 192.168.1.1."""
    rdt_port: Annotated[int, Field(ge=1, le=65535)] = 49152
    http_port: Annotated[int, Field(ge=1, le=65535)] = 80
    axis: Literal["x", "y", "z"] = "z"
    """The sensor's axis that lies along the needle."""
    reversed: bool = False
    """The sensor's torque is negative when the base leads the needle."""
    offset_nmm: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    """What it shows without a torque; subtracted."""


class SerialSection(Section):
    """The serial port of the Hall node."""

    device: Literal["node"] = "node"
    port: str
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 921_600


class TextHall(Section):
    """Angle sensors that send lines of text: a clock, then one angle a sensor."""

    device: Literal["text"]
    port: str
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 115_200
    clock: Literal["ms", "us"] = "ms"
    """What the first number of a line counts, as millis() or micros() do, modulo 2^32."""
    angle: Literal["deg", "rad", "counts"] = "deg"
    counts_per_turn: Annotated[int, Field(ge=100, le=16_777_216)] | None = None
    """Needed where angles are counts: 4096 of 12 bits."""
    checksum: bool = False
    """Lines end in *HH, the exclusive or of the bytes before it (as in NMEA 0183); others are refused."""


class DeviceFile(Section):
    """A device of one's own: `config/devices/NAME.py`, whose options stand beside its name."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)

    device: str

    @property
    def options(self) -> dict[str, Any]:
        """What stands beside the name."""
        return dict(self.model_extra or {})


def _device_word(*words: str) -> Callable[[Any], str]:
    """Tells sections apart by their key `device`: a shipped word, node where there is none, else a file."""

    def word(section: Any) -> str:
        given = section.get("device", "node") if isinstance(section, dict) else getattr(section, "device", "")
        return given if given in words else "file"

    return word


DriveDevice = Annotated[
    Annotated[NodeDevice, Tag("node")]
    | Annotated[Cia402Drive, Tag("cia402")]
    | Annotated[DeviceFile, Tag("file")],
    Discriminator(_device_word("node", "cia402")),
]
TorqueDevice = Annotated[
    Annotated[NodeDevice, Tag("node")]
    | Annotated[NetFtTorque, Tag("netft")]
    | Annotated[DeviceFile, Tag("file")],
    Discriminator(_device_word("node", "netft")),
]
HallDevice = Annotated[
    Annotated[SerialSection, Tag("node")]
    | Annotated[TextHall, Tag("text")]
    | Annotated[DeviceFile, Tag("file")],
    Discriminator(_device_word("node", "text")),
]


class LinksSection(Section):
    """How the devices are reached, and how old a value may be before it is a fault.

    `drive`, `torque` and `hall` say with one word, `device`, what stands there.
    """

    can: CanSection
    drive: DriveDevice = NodeDevice()
    torque: TorqueDevice = NodeDevice()
    hall: HallDevice
    torque_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50
    hall_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50
    drive_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50

    @property
    def hall_port(self) -> str | None:
        """The serial port of the Hall sensors; None where a device of one's own knows it."""
        return None if isinstance(self.hall, DeviceFile) else self.hall.port

    @property
    def ports(self) -> dict[str, str]:
        """Where the devices are, by key below `links`."""
        found = {"can.channel": self.can.channel}
        if self.hall_port is not None:
            found["hall.port"] = self.hall_port
        if isinstance(self.torque, NetFtTorque):
            found["torque.address"] = self.torque.address
        return found


class DriveSection(Section):
    """Limits of the base drive: the last gate before the motor."""

    angle_limit_deg: Annotated[float, Field(gt=0, le=3600)] = 720
    velocity_limit_deg_s: Annotated[float, Field(gt=0, le=360)] = 60
    acceleration_limit_deg_s2: Annotated[float, Field(gt=0, le=20_000)] = 360
    torque_limit_nmm: Annotated[float, Field(gt=0, le=50)] = 2.0
    windup_limit_deg: Annotated[float, Field(gt=0, le=3600)] = 270
    """What the needle bears between base and tip."""
    travel_limit_deg: Annotated[float, Field(gt=0, le=360_000)] = 7200
    """All turns of the base in one sequence, both ways added."""
    following_deg: Annotated[float, Field(ge=0.1, le=30)] = 1.5
    """How far the base may be from what was commanded so far, at standstill."""
    response_ms: Annotated[float, Field(ge=1, le=1000)] = 60
    """What bus, drive and motor may take to answer a command; at speed the base may lag by that."""
    disagreement_deg: Annotated[float, Field(ge=0.5, le=90)] = 8
    """How far the encoder may be from what torque and first Hall angle say, within one motion."""
    reference_tolerance_deg: Annotated[float, Field(ge=0.5, le=90)] = 5
    """How well encoder and Hall angles must agree to confirm the zero of a drive that was switched on."""
    index_deg: Annotated[float, Field(ge=-180, le=180)] = 0
    """Base angle at which the encoder's index mark stands, within one turn."""


class PidSection(Section):
    """Gains of the base position loop, whose output is a velocity."""

    kp_per_s: Annotated[float, Field(gt=0, le=100)] = 10.0
    ki_per_s2: Annotated[float, Field(ge=0, le=500)] = 10.0
    kd: Annotated[float, Field(ge=0, le=1)] = 0.0


class SequenceSection(Section):
    """The compensation sequence and how a settled state is judged."""

    settle_s: Annotated[float, Field(ge=0.1, le=600)] = 3.0
    speed_deg_s: Annotated[float, Field(gt=0, le=360)] = 45
    still_deg: Annotated[float, Field(gt=0, le=5)] = 0.1
    torque_window_s: Annotated[float, Field(gt=0, le=10)] = 0.5
    motion_timeout_s: Annotated[float, Field(gt=1, le=3600)] = 60
    aligned_deg: Annotated[float, Field(gt=0, le=90)] = 5.0
    aligned_torque_nmm: Annotated[float, Field(gt=0, le=5)] = 0.02


class SimulationSection(Section):
    """The simulated rig: which needle, and the imperfections of its sensors and drive."""

    parameters: str = "rig_elastic"
    seed: int = 1
    sensor_rate_hz: Annotated[float, Field(ge=50, le=5000)] = 1000
    torque_noise_nmm: Annotated[float, Field(ge=0, le=1)] = 0.0008
    hall_noise_deg: Annotated[float, Field(ge=0, le=10)] = 0.25
    encoder_step_deg: Annotated[float, Field(gt=0, le=1)] = 0.01
    hall_step_deg: Annotated[float, Field(gt=0, le=5)] = 0.01
    torque_step_nmm: Annotated[float, Field(gt=0, le=1)] = 0.0001
    drive_gain: Annotated[float, Field(gt=0.1, le=3)] = 1.0
    drive_delay_ms: Annotated[float, Field(ge=0, le=50)] = 2.0
    drive_time_constant_ms: Annotated[float, Field(ge=0, le=200)] = 10.0
    drive_droop_deg_s_per_nmm: Annotated[float, Field(ge=0, le=100)] = 1.0
    nodes: Literal["python", "firmware", "image"] = "python"
    """What serves the simulated ports: nodes in Python, the firmware as a library, or its Cortex-M images."""
    sensor_errors_seed: Annotated[int, Field(ge=0)] = 0
    """Which offsets, gains and eccentricities the firmware's sensors have; 0: none."""
    node_pages: str | None = None
    """Folder with the calibration pages that were flashed into the nodes."""
    free_needle: bool = False
    """The needle is out of the tissue: no friction, no other effect; for calibration."""


class WatchSection(Section):
    """What the runs of the rig are watched with."""

    model: str | None = None
    """Parameter set, or a model file; not given: rigid tissue with uniform friction."""
    reference_runs: Annotated[int, Field(ge=10, le=500)] = 20
    """The first runs, whose range the later ones are held against."""


class RecordingSection(Section):
    """Where runs go, and how long they stay; one that nobody exported or diagnosed is never removed."""

    directory: str = "runs"
    keep_days: Annotated[float, Field(ge=1, le=36_500)] | None = None
    """Runs that are older are removed once they were read; not given: they stay."""
    keep_gb: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    """When all runs take more, the oldest that were read are removed; not given: they stay."""
    watch: WatchSection | None = None
    """Every run that ends is held against those before it; not given: none is."""


class RigConfig(Section):
    """A whole rig file."""

    format: Literal["needle-rig/1"]
    name: str
    kind: Literal["simulated", "hardware"]
    tick_hz: Annotated[float, Field(ge=50, le=1000)] = 200
    needle: NeedleSection
    layout: LayoutSection
    links: LinksSection
    drive: DriveSection
    pid: PidSection
    sequence: SequenceSection
    recording: RecordingSection
    simulation: SimulationSection | None = None
