"""What the bench says on its standard output, a JSON line each."""

from __future__ import annotations

from typing import Literal, TypedDict


class Said(TypedDict, total=False):
    """One line that the bench says, with the time: what happened, where it stands, its ports, or an error."""

    time_s: float
    """Monotonic clock."""
    event: Literal["late", "drive", "command", "fault", "turn", "weigh"]
    late_s: float
    state: str
    enable: bool
    clear: bool
    link: str
    fault: str
    turn_deg: float
    weight_nmm: float
    base_deg: float
    true_base_deg: float
    supply_on: bool
    velocity_deg_s: float
    drive: str
    faults: int | dict[str, str]
    """Bits that the drive stopped for; of where it stands: what is broken, by link."""
    node_clock_zero_s: float
    plant_s: float
    behind_s: float
    cpu_s: float
    can: str
    hall: str
    torque: str
    error: str
    exit_code: int
