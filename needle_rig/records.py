"""The words that rooms exchange: measurements, commands, phases and samples. SI and radians."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass


class DriveState(enum.IntEnum):
    """What the base drive says of itself (DRIVE_STATUS.state in the DBC)."""

    SILENT = 0  # after boot: no command accepted until a clear
    READY = 1  # holds still, takes commands
    RUNNING = 2
    FAULT = 3  # left only by a clear


class DriveFault(enum.IntFlag):
    """Reasons for which the drive stopped by itself (DRIVE_STATUS.faults in the DBC)."""

    NONE = 0
    COMMAND_AGE = 1  # temporary: no valid command for 50 ms
    HEARTBEAT = 2  # the host's heartbeat counter stood still
    VELOCITY = 4
    ANGLE = 8
    TORQUE_TRIP = 16
    ENCODER = 32
    FRAME = 64  # too many damaged frames
    TORQUE_AGE = 128  # the torque node went quiet


class Phase(enum.StrEnum):
    """Where a run stands. Motions are named as in datasets; `settle_` phases wait after them."""

    IDLE = "idle"
    REST = "rest"
    MOVING = "moving"
    SETTLING = "settling"
    MEASURING = "measuring"
    DONE = "done"
    ABORTED = "aborted"
    FAULT = "fault"


@dataclass(frozen=True, slots=True)
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
    """Why a link that speaks gives no good value, such as a magnet out of reach; for the fault's message."""


@dataclass(frozen=True, slots=True)
class Command:
    """What the drive is told each tick. `clear` leaves SILENT or FAULT; `enable` False stops."""

    velocity_rad_s: float = 0.0
    enable: bool = False
    clear: bool = False


STOP = Command()


@dataclass(frozen=True, slots=True)
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
