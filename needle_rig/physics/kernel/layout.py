"""What stands where in the arrays that the solver works on, and the records that go with them.

`rod` has shape (12, nodes), `states` (SLOTS, 6, nodes) and `work` (WORK_ROWS, nodes): one block each, as
a tuple of 33 arrays would be 231 machine words in every call.
"""

from __future__ import annotations

from typing import Any, NamedTuple

# rows of `rod` (Rod.coefficients)
(
    PLUS, MINUS, COMPLIANCE, CREEP_K, CREEP_ETA, VISCOUS, EXCESS, AGEING, POSITION, PER_TORQUE, PLAY,
    SLACK,
) = range(12)  # fmt: skip

# rows of a state (RodState); STATUS: 0 stuck, ±1 slipping that way, 2 nothing resists a turn
ANGLE, ANCHOR, CREEP, EXCESS_STATE, AGE, STATUS = range(6)
STUCK, FREE = 0.0, 2.0

# states that a step works with
SLOTS = 8

# rows of `work`
(
    SPRING,  # N·m/rad of the element towards the next node
    # law of a node over the step: θ = ANCHOR_START + ALGORITHMIC · r while stuck
    ALGORITHMIC,  # rad/(N·m), compliance and what creep adds within the step
    DAMPING,  # N·m/rad of a slipping node
    ANCHOR_START,
    LIMIT_PLUS,
    LIMIT_MINUS,
    # row i of the linear system: SCALE · (Kθ − f) + own θ = CONSTANT, or LOADED with torque laws
    SCALE,
    DIAGONAL,
    CONSTANT,
    PIVOT,
    RATIO,
    VALUE,
    SLIP,  # rad that the node slips in the step
    # torque laws, linearised: FORCE + SLOPE · θ
    FORCE,
    SLOPE,
    LOADED,
    CREEP_DECAY,  # part of the creep that is left at the end of the step
    # active set
    TORQUE,
    VIOLATION,
    # kept while something else stands in their place
    ALGORITHMIC_KEPT,
    DAMPING_KEPT,
    STATUS_KEPT,
    # slip limits with memory: factors of the kinetic limits and how they fall with the slip, at the end of
    # the step and as the step expects them
    FACTOR,
    FALL,
    FACTOR_EXPECTED,
    FALL_EXPECTED,
    SLIP_EXPECTED,
    SLIP_RATE,
    # kinetic slip limits, with what the torque that is carried adds
    KINETIC_PLUS,
    KINETIC_MINUS,
    # elements with play: the side, 0 inside; their stiffness there; what SPRING carries at no twist
    PLAY_SIDE,
    STIFFNESS,
    PLAY_TORQUE,
) = range(33)
WORK_ROWS = 33

# places in `counts`
STEPS, SOLVES, FAILED_NODE, FAILED_SAMPLE, FIRST_VIOLATION, LAST_VIOLATION, ENDED = range(7)
COUNTS = 7

# how following a path ended, in ENDED
DONE, NO_SOLUTION, TOO_MANY_SOLVES = range(3)

EPS = 2.220446049250313e-16


class Features(NamedTuple):
    """What some node of the rod has; code for what none has is passed over."""

    creep: bool
    viscous: bool
    memory: bool
    """Slip limits that depend on the slip before: static excess or ageing."""
    loaded: bool
    """Slip limits that grow with the torque that the rod carries."""
    laws: bool
    """Torque laws, a torque on the tip, or elements with play."""
    play: bool
    dry: bool
    """Dry nodes in a rod that depends on rates."""


class Settings(NamedTuple):
    """Scalars of the rod and of the choice of steps."""

    base_compliance_rad_per_nm: float
    stribeck_rate_rad_s: float
    stribeck_exponent: float
    weakening_rad: float
    ageing_time_s: float
    tolerance_rad: float
    longest_step_s: float
    shortest_step_s: float
    longest_slip_rad: float
    """Turn of the base in a step at most, where slip limits have a memory."""
    most_solves_per_sample: float
    torque_scale: float
    """Torques of the rod over those of the needle, whose torques TORQUE_PER_RAD stands for."""


class Drive(NamedTuple):
    """The base path and the torque on the tip, piecewise linear through samples: shapes (samples,).

    Without a torque on the tip `tip_nm` is empty.
    """

    time_s: Any
    base_rad: Any
    tip_nm: Any


class Laws(NamedTuple):
    """Torque laws: addresses of code and parameters, shapes (laws,); weights in m, shape (laws, nodes).

    The torque on the tip is one more, of time alone, and comes from `drive`.
    """

    addresses: Any
    parameters: Any
    weights_m: Any
    drive: Drive


class Output(NamedTuple):
    """What is stored: shapes (samples,), (samples, sensors), (samples,), (samples or 0, nodes)."""

    torque_nm: Any
    sensor_rad: Any
    tip_rad: Any
    shaft_rad: Any
