"""The typed configuration. Key names end in their unit; ranges are checked where the key stands."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field


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
    """The CAN bus of the torque and drive nodes; `interface` and `channel` as python-can names them."""

    interface: Literal["slcan", "socketcan", "virtual"] = "slcan"
    channel: str
    bitrate_kbit_s: Annotated[int, Field(ge=10, le=1000)] = 1000


class SerialSection(Section):
    """The serial port of the Hall node."""

    port: str
    baud: Annotated[int, Field(ge=9600, le=4_000_000)] = 921_600


class LinksSection(Section):
    """How the nodes are reached, and how old a value may be before it is a fault."""

    can: CanSection
    hall: SerialSection
    torque_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50
    hall_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50
    drive_age_limit_ms: Annotated[float, Field(ge=5, le=1000)] = 50


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


class RecordingSection(Section):
    """Where runs go, and how long they stay; one that nobody exported or diagnosed is never removed."""

    directory: str = "runs"
    keep_days: Annotated[float, Field(ge=1, le=36_500)] | None = None
    """Runs that are older are removed once they were read; not given: they stay."""
    keep_gb: Annotated[float, Field(ge=0.01, le=1e6)] | None = None
    """When all runs take more, the oldest that were read are removed; not given: they stay."""


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
