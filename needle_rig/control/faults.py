"""What can be wrong: every fault by name, where to look, and whether it stays until a person clears it.

docs/safety.md tells each one's limit, how far the base can have turned by then, and what to do.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

from needle_rig.records import DriveFault


class FaultName(enum.StrEnum):
    """One name a fault, as logs, the API and docs/safety.md have it."""

    LINK_DEAD = "link_dead"
    BLIND = "blind"  # the drive is enabled and was not heard for too long
    NOT_A_NUMBER = "not_a_number"
    TORQUE_LIMIT = "torque_limit"
    ANGLE_LIMIT = "angle_limit"
    WINDUP_LIMIT = "windup_limit"
    TRAVEL_LIMIT = "travel_limit"
    DRIVE = "drive"  # the drive node stopped by itself; its fault bits say why
    NOT_TURNING = "not_turning"
    RUNAWAY = "runaway"
    WRONG_DIRECTION = "wrong_direction"
    IDLE_MOTION = "idle_motion"
    ENCODER_DISAGREES = "encoder_disagrees"
    TWIST_WITHOUT_TORQUE = "twist_without_torque"
    TORQUE_WITHOUT_TWIST = "torque_without_twist"
    HALL_JUMP = "hall_jump"
    HALL_DISAGREES = "hall_disagrees"
    REFERENCE_LOST = "reference_lost"
    SECOND_MASTER = "second_master"
    EMERGENCY_STOP = "emergency_stop"
    LATE_TICK = "late_tick"
    DRIVE_RESTARTED = "drive_restarted"
    CONTROL = "control"  # a strategy or the control loop gave something that cannot be done


REFERENCE_SETTLES = frozenset(
    {
        FaultName.REFERENCE_LOST,
        FaultName.ENCODER_DISAGREES,
        FaultName.TWIST_WITHOUT_TORQUE,
        FaultName.TORQUE_WITHOUT_TWIST,
        FaultName.HALL_DISAGREES,
    }
)
"""A person who says where the base stands ends these: the witnesses are compared from there on."""


@dataclass(frozen=True)
class Fault:
    """Why the drive may not move; `link` is torque, hall, drive or control.

    `bit` tells the drive's own faults of one name apart, and is NONE for all others.
    """

    name: FaultName
    link: str
    text: str
    latching: bool
    bit: DriveFault = DriveFault.NONE
