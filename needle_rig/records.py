"""The words that rooms exchange: measurements, commands, phases and samples. SI and radians."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

JsonObject = dict[str, object]
"""A mapping as JSON and YAML have it, for those who pass it on: who reads it holds it against a form."""


class DriveState(enum.IntEnum):
    """What the base drive says of itself (DRIVE_STATUS.state in the DBC)."""

    SILENT = 0  # after boot: no command accepted until a clear
    READY = 1  # holds still, takes commands
    RUNNING = 2
    FAULT = 3  # left only by a clear


COMMAND_AGE_S = 0.05
"""Without a valid command for longer the drive node stops by itself (`command_age_us` of firmware/core)."""


class DriveFault(enum.IntFlag):
    """Reasons for which the drive stopped by itself.

    The low byte is DRIVE_STATUS.faults of the DBC, the next one DRIVE_HEALTH.motion_faults.
    """

    NONE = 0
    COMMAND_AGE = 1  # temporary: no valid command for COMMAND_AGE_S
    HEARTBEAT = 2  # the host's heartbeat counter stood still
    VELOCITY = 4
    ANGLE = 8
    TORQUE_TRIP = 16
    ENCODER = 32
    FRAME = 64  # too many damaged frames
    TORQUE_AGE = 128  # the torque node went quiet
    STALL = 256  # asked to turn, and the encoder does not follow
    RUNAWAY = 512  # it turns more than it was asked to
    DIRECTION = 1024  # it turns against what was asked
    IDLE_MOTION = 2048  # it moves while nothing is asked
    MASTER = 4096  # commands of another master on the bus
    EMERGENCY_STOP = 8192


TEMPORARY = DriveFault.COMMAND_AGE | DriveFault.FRAME | DriveFault.TORQUE_AGE
"""These end with their cause; every other one latches until a person clears it."""


class Phase(enum.StrEnum):
    """Where a run stands. Motions are named as in datasets."""

    IDLE = "idle"
    REST = "rest"
    MOVING = "moving"
    SETTLING = "settling"
    MEASURING = "measuring"
    HOLDING = "holding"
    DONE = "done"
    ABORTED = "aborted"
    FAULT = "fault"


@dataclass(slots=True)  # built in every tick: a frozen one costs ten times the processor time
class Measurement:
    """Newest value of every sensor with its age. Ages are infinite until a first value came."""

    time_s: float
    base_angle_rad: float
    torque_nm: float
    hall_rad: tuple[float, ...]
    drive_state: DriveState = DriveState.READY
    drive_faults: DriveFault = DriveFault.NONE
    torque_age_s: float = math.inf
    hall_age_s: float = math.inf
    drive_age_s: float = math.inf
    torque_complaint: str = ""
    hall_complaint: str = ""
    drive_complaint: str = ""
    """Why a link that speaks gives no good value, such as a magnet out of reach; for the fault's message."""
    referenced: bool = True
    """The drive node knows its zero; False after it started, until a reference."""
    supply_on: bool = True
    """The safe-torque-off line lets the motor have its supply."""
    emergency_stop: bool = False
    index_rad: float = math.nan
    """Base angle at which the encoder's index mark passed last; NaN until it did."""
    foreign_commands: int = 0
    """Commands to the drive that another master sent, counted since the rig was opened."""


@dataclass(frozen=True, slots=True)
class Firmware:
    """What a node says of itself; None for each thing that it did not tell.

    `protocol` is what its frames mean: up to 255 of this project's nodes, else another maker's CiA profile.
    `build` is the first 24 bits of its sources' SHA-256 (0 where there are none), `calibration_serial` that
    of the page that it calibrates with.
    """

    protocol: int | None = None
    version: str | None = None
    build: int | None = None
    calibrated: bool | None = None
    calibration_serial: int | None = None
    refusal: str = ""
    """Why the host does not work with it, for a person; empty when it does."""

    @property
    def of_another_maker(self) -> bool:
        """Whether its version is none of needle-rig."""
        return self.protocol is not None and self.protocol > 255  # the byte that our frames have for it


@dataclass(frozen=True, slots=True)
class Command:
    """What the drive is sent each tick. `enable` False stops.

    `clear` leaves SILENT, and FAULT when all of its reasons are `TEMPORARY`; with `acknowledge`, which a
    person alone gives, also a FAULT that latches, unless a cause came after what the drive said `sight_s`
    ago.
    `reference_rad` says at which angle the base stands; the drive takes it as such unless it is running.
    `release` sends nothing at all: a drive that hears nothing falls silent, its supply opens, and a hand may
    turn it.
    """

    velocity_rad_s: float = 0.0
    enable: bool = False
    clear: bool = False
    acknowledge: bool = False
    reference_rad: float | None = None
    release: bool = False
    sight_s: float = 0.0


STOP = Command()
RELEASE = Command(release=True)


@dataclass(slots=True)  # as Measurement
class Sample:
    """One row of a run: what the brain saw and said in one tick.

    `waypoint_rad` is where the present motion goes, NaN where there is none; `velocity_rad_s` is the command
    after the limits and `limited` says that they changed it. `motion` is the motion's name as in datasets.
    """

    time_s: float
    dt_s: float
    phase: Phase
    motion: str
    base_angle_rad: float
    torque_nm: float
    hall_rad: tuple[float, ...]
    waypoint_rad: float
    velocity_rad_s: float
    enable: bool
    limited: bool
    drive_state: DriveState
    drive_faults: DriveFault
    torque_age_s: float
    hall_age_s: float
    drive_age_s: float
