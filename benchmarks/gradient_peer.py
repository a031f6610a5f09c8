"""Forward sensitivities by CasADi and IDAS of the same rod with its dry friction made smooth.

Same mesh, springs and limits. A node in elastic tissue follows θ = p + r/k, and its anchor p slips at

    dp/dt = (s(r/Υ − 1) − s(−r/Υ − 1)) / τ,    s(x) = (x + √(x² + ε²)) / 2:

dry friction as τ and ε go to 0. Angles are algebraic, anchors differential. The base turns at a constant rate
from sample to sample, where IDAS begins anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from needle_rig.numerics import Array
    from needle_rig.physics.rod import Rod
    from needle_rig.physics.solution import Path

SLIP_TIME_S = 1e-3
"""τ: at 45°/s a node carries 0.08 % more than its limit."""
ROUNDING = 3e-5
"""ε, over the slip limit."""
RELATIVE_TOLERANCE = 1e-4
ABSOLUTE_TOLERANCE = 1e-5
UNIT_NM = 1e-4
"""Torques are told in this unit, so that they are as large as the angles."""


@dataclass(frozen=True)
class Smooth:
    """Torque and sensors of one trial (samples, 1 + sensors), and their derivatives (…, parameters)."""

    solved: Callable[[Array], Array]
    derived: Callable[[Array], Array]


def smooth(rod: Rod, path: Path, friction_factor: float, parameters: int) -> Smooth | None:
    """The rod's trial by parameters as `bench gradient` has them; None where CasADi is missing."""
    try:
        import casadi as ca
    except ImportError:
        return None
    inside = np.flatnonzero(rod.tissue_length_m > 0)
    x = ca.SX.sym("x", parameters)
    base, base_rate = ca.SX.sym("base"), ca.SX.sym("base_rate")
    anchor, angle = ca.SX.sym("anchor", len(inside)), ca.SX.sym("angle", len(rod.position_m) - 1)
    shares = [x[2 + s] if 2 + s < parameters else 0 for s in rod.section[inside]]
    slip = friction_factor * rod.slip_plus_nm[inside] / UNIT_NM
    limit = ca.vertcat(*[ca.exp(x[0] + share) * of_node for share, of_node in zip(shares, slip, strict=True)])
    every = ca.vertcat(base, angle)
    carried = rod.stiffness_nm_per_rad / UNIT_NM * ca.exp(x[1]) * (every[1:] - every[:-1])
    tissue = (every[inside.tolist()] - anchor) / (rod.compliance_rad_per_nm[inside] * UNIT_NM)
    loads: list[Any] = [0] * len(rod.position_m)
    for k, node in enumerate(inside):
        loads[node] = tissue[k]
    balance = ca.vertcat(carried[1:], 0) - carried - ca.vertcat(*loads[1:])

    def beyond(share: ca.SX) -> ca.SX:
        return (share + ca.sqrt(share**2 + ROUNDING**2)) / 2

    slipping = (beyond(tissue / limit - 1) - beyond(-tissue / limit - 1)) / SLIP_TIME_S
    state = ca.vertcat(base, anchor)
    times = path.time_s.tolist()
    follow = ca.integrator(
        "follow",
        "idas",
        {
            "x": state,
            "z": angle,
            "p": x,
            "u": base_rate,
            "ode": ca.vertcat(base_rate, slipping),
            "alg": balance,
        },
        times[0],
        times[1:],
        {"reltol": RELATIVE_TOLERANCE, "abstol": ABSOLUTE_TOLERANCE, "max_num_steps": 100_000},
    )
    read = ca.Function("read", [state, angle, x], [ca.vertcat(-carried[0], every[rod.sensors.tolist()])])
    rates = np.diff(path.base_rad) / np.diff(path.time_s)
    X = ca.MX.sym("X", parameters)
    begin = np.append(path.base_rad[0], np.zeros(len(inside)))
    found = follow(x0=begin, z0=np.zeros(len(rod.position_m) - 1), p=X, u=ca.DM(rates).T)
    readings = read.map(len(rates))(found["xf"], found["zf"], ca.repmat(X, 1, len(rates)))
    values = ca.Function("values", [X], [readings])
    forward = values.forward(parameters)
    shape = (len(rates), 1 + len(rod.sensors))

    def solved(x: Array) -> Array:
        return np.array(values(x)).T

    def derived(x: Array) -> Array:
        told = forward(x, ca.DM(*shape[::-1]), ca.DM(np.eye(parameters)))
        return np.array(told).T.reshape(parameters, *shape).transpose(1, 2, 0)

    return Smooth(solved, derived)
