"""What the brain is asked and what it tells: requests, settled motions, outcomes and its present state."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

from needle_rig.control.lag import lag_rad
from needle_rig.control.strategy import Reason, SettledMotion, Strategy, Task, Trust, Waypoint
from needle_rig.records import Measurement, Phase

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel

Status = Literal["aligned", "not_aligned", "aborted", "fault"]


@dataclass(frozen=True)
class Request:
    """One alignment: where to, by which strategy, with which options.

    `strategy` is a name (the file in control/strategies) or an instance; `options` are the fields of its
    dataclass by name (`{"extra_deg": 12}`). `settle_s` and `speed_rad_s` stand in for those of the
    configuration. `lag_left_rad` is the tip lag that the run before left, for strategies that learn from it;
    None takes it from the brain's own last run. `run` names the run in sentences. `model`, and how far its
    file says to `trust` it, stand in for the brain's own.
    """

    target_rad: float
    strategy: str | Strategy = "reed2008"
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    settle_s: float | None = None
    speed_rad_s: float | None = None
    lag_left_rad: float | None = None
    run: str = "RUN"
    model: NeedleModel | None = None
    trust: Trust = field(default_factory=Trust)


def settled_motion(
    task: Task,
    waypoint: Waypoint | None,
    *,
    index: int,
    moved_s: float,
    time_s: float,
    base_angle_rad: float,
    torque_nm: float,
    hall_rad: tuple[float, ...],
) -> SettledMotion:
    """The record of the motion to `waypoint`, or of the rest before the first, with the lags by its means."""
    return SettledMotion(
        index=index,
        name=waypoint.name if waypoint else Phase.REST.value,
        moved_s=moved_s,
        time_s=time_s,
        waypoint_rad=waypoint.angle_rad if waypoint else base_angle_rad,
        base_angle_rad=base_angle_rad,
        torque_nm=torque_nm,
        hall_rad=hall_rad,
        predicted_lag_rad=lag_rad(torque_nm, task.layout, task.torsional_rigidity_nm2),
        tip_lag_rad=base_angle_rad - hall_rad[-1] if hall_rad else math.nan,
        reason=waypoint.reason if waypoint else Reason.STRATEGY,
    )


@dataclass(frozen=True)
class Condition:
    """One of the paper's three conditions for an aligned needle, its value and its limit.

    `unit` is rad or N·m; `value` must be at most `limit` in size.
    """

    name: Literal["8a", "8b", "8c"]
    text: str
    value: float
    limit: float
    unit: str
    met: bool


@dataclass(frozen=True)
class Outcome:
    """How a sequence ended, with a sentence for a person. Angles and torque are NaN when nothing settled."""

    status: Status
    text: str
    target_rad: float
    strategy: str
    base_angle_rad: float
    torque_nm: float
    hall_rad: tuple[float, ...]
    tip_lag_rad: float
    """Base minus last Hall angle at the end."""
    lag_rad: float
    """Lag predicted from the torque after the first motion."""
    mean_rad: float
    """Mean of the Hall angles."""
    range_rad: float
    """Largest minus smallest Hall angle."""
    conditions: tuple[Condition, ...] = ()
    fault_name: str | None = None
    """The fault that ended it; see faults.FaultName."""


@dataclass(frozen=True)
class BrainState:
    """A snapshot for displays and the API. `remaining_s` counts down what is waited for."""

    time_s: float
    phase: Phase
    motion: str
    motion_index: int
    motions_expected: int
    waiting_for: str
    remaining_s: float | None
    progress: float
    """0..1 over the whole sequence, estimated; never falls within one sequence."""
    target_rad: float | None
    strategy: str | None
    model: str | None
    """Name of the model that the strategy may plan with."""
    waypoint_rad: float | None
    velocity_rad_s: float
    limited: bool
    released: bool
    """Nothing is sent to the drive: a hand may turn it."""
    measurement: Measurement | None
    settled: tuple[SettledMotion, ...]
    """Settled motions of the present or last sequence, without the rest before the first."""
    outcome: Outcome | None
    fault: str | None
    """The fault that holds the brain, as a sentence; None when there is none."""
    fault_name: str | None
    """Its name; see faults.FaultName."""
    latched: bool
    """The fault stays until a clear."""
