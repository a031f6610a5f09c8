"""What goes over the daemon's socket, as types: degrees, N·mm, mm and seconds; None where there is no number.

The daemon makes these documents, the commands and the OpenAPI document read them; a key that one side does
not know is an error of the type check.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, NotRequired, TypedDict

from needle_rig.control.reports import Status

Message = Mapping[str, Any]
"""An order before it is judged by the models of `orders`, or an answer: one line between two processes."""


class Asked(TypedDict):
    """What the API's process asks the daemon."""

    number: int
    order: str
    content: Message
    begun_s: float
    """When the request's first byte came."""
    lease: str | None


class Answered(TypedDict):
    """The daemon's answer to the question of that number."""

    number: int
    status: int
    """The HTTP status of a refusal; 0 when it was done."""
    content: Message


class Rig(TypedDict):
    """What does not change while the daemon lives."""

    name: str
    simulated: bool
    parameters: str | None
    """Of the simulated needle; None on a real rig."""
    tick_hz: float
    needle_length_mm: float
    torsional_rigidity_nmm2: float
    """As the rig file states it."""
    tissue_sections_mm: list[list[float]]
    hall_positions_mm: list[float]
    angle_limit_deg: float


class Ages(TypedDict):
    """How old the newest value of each link is."""

    torque: float | None
    hall: float | None
    drive: float | None


class Node(TypedDict):
    """What one node says of itself; None for each thing that it did not tell."""

    text: str
    """All of it, for a person."""
    protocol: int | None
    version: str | None
    build: str | None
    """First six hexadecimal digits of its sources' SHA-256."""
    calibrated: bool | None
    calibration_serial: int | None
    refusal: str | None
    """Why the daemon does not work with it."""


class Sensors(TypedDict):
    """The newest measurement."""

    base_deg: float | None
    torque_nmm: float | None
    hall_deg: list[float | None]
    drive_state: str
    referenced: bool
    supply_on: bool
    emergency_stop: bool
    drive_faults: list[str]
    age_ms: Ages


class Settled(TypedDict):
    """One settled motion, with what the model behind the torque predicts."""

    phase: str
    waypoint_deg: float | None
    base_deg: float | None
    torque_nmm: float | None
    predicted_lag_deg: float | None
    hall_deg: list[float | None]
    tip_lag_deg: float | None
    moved_s: float | None
    settled_s: float | None


class Condition(TypedDict):
    """One of the paper's conditions."""

    name: str
    text: str
    value: float | None
    limit: float | None
    unit: Literal["°", "N·mm"]
    met: bool


class Motion(TypedDict):
    """One motion in a run's result."""

    phase: str
    base_deg: float | None
    torque_nmm: float | None
    hall_deg: list[float | None]


class Final(TypedDict):
    """Where the needle stands at a run's end."""

    base_deg: float | None
    torque_nmm: float | None
    hall_deg: list[float | None]
    tip_lag_deg: float | None
    mean_deg: float | None
    range_deg: float | None


class Result(TypedDict):
    """The result of a run: the object that `needle-rig compensate --json` prints."""

    status: Status
    target_deg: float | None
    strategy: str
    simulated: bool
    parameters: str | None
    lag_deg: float | None
    motions: list[Motion]
    final: Final
    run: str
    fault_name: str | None


class Told(TypedDict):
    """How a run ended."""

    result: Result
    text: str
    conditions: list[Condition]
    settled: list[Settled]


class Ended(Told):
    """`Told`, as an event of the stream."""

    type: Literal["ended"]


class Standing(TypedDict):
    """Where the brain stands and what the sensors say."""

    time_s: float | None
    phase: str
    motion: str
    motion_index: int
    motions_expected: int
    waiting_for: str
    remaining_s: float | None
    progress: float
    target_deg: float | None
    strategy: str | None
    model: str | None
    """Name of the model that the strategy may plan with."""
    waypoint_deg: float | None
    velocity_deg_s: float | None
    limited: bool
    sensors: Sensors | None
    settled: list[Settled]
    fault: str | None
    fault_name: str | None
    latched: bool
    released: bool


class Ticks(TypedDict, total=False):
    """How well the ticks keep their time; lateness over the newest 4096."""

    count: int
    missed: int
    late_p50_ms: float | None
    late_p99_ms: float | None
    late_max_ms: float | None
    lost_rows: int


class Whole(Standing):
    """All that the daemon says of itself."""

    version: str
    """Of the needle-rig that the daemon runs."""
    rig: Rig
    runs: str
    """Folder of the runs."""
    run: str | None
    model_sha256: str | None
    """Of the model file that came with the order of the present or last run; None where none came."""
    last: Told | None
    """How the last run of this daemon ended."""
    warnings: list[str]
    starting: bool
    since_utc: str
    before: str | None
    """How the daemon before this one ended."""
    unfinished: list[dict[str, str]]
    """Runs that an earlier daemon could not close."""
    rates_hz: dict[str, float]
    """Readings of each node in the last second, a second."""
    firmware: dict[str, Node]
    """What each node says of itself, by link; a device of another make is not among them."""
    lease: str | None
    """Who commands."""
    motions: int
    """Motions begun so far that are no run."""
    moving: bool


class State(Whole):
    """`Whole` as an event of the stream, regularly and when the phase is new; GET /state adds the ticks."""

    type: Literal["state", "phase"]
    ticks: NotRequired[Ticks]


class Moved(Whole):
    """`Whole` when a motion that is no run is over."""

    type: Literal["moved"]
    moved: int
    """Which one."""


class Started(TypedDict, total=False):
    """The answer to an order: the run's file, the motion's number, or what was done."""

    run: str
    motion: int
    done: str
    stopping: bool


Document = State | Moved | Ended
"""What the stream carries."""
