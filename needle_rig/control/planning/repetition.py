"""Repeat a sequence from a start of its own, corrected by the Hall angles that it left.

Iterative learning control with a quadratic cost (Amann, Owens and Rogers, IEE Proc. D 143, 1996): the base
angles u_k left the errors e_k at the Hall sensors; u_{k+1} = u_k + g Δ, where Δ minimises
|e_k + J Δ|² + ρ |Δ|² and J, the slopes of the errors, is the model's. What the model does not predict of a
needle that snaps, but what comes back when the sequence does, is taken out that way.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from needle_rig.control.planning.effort import Effort
from needle_rig.control.planning.plans import Aim
from needle_rig.control.strategy import History, Waypoint
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.solver import relaxed
from needle_rig.units import deg, rad

UNWIND = "unwind"
"""Beginning of the name of every repetition's first motion."""
UNWIND_SHARE = 2.5
"""How far that goes beyond the target, against the sequence, in the furthest overshoot: a shaft whose static
friction is twice the kinetic slips all along then."""
SHARES = np.array([1.0, -0.75, 0.45, -0.2, 0.0])
"""What is repeated first: turns about the target whose amplitude falls, in the furthest overshoot. With one
turn fewer, those of Reed (2008), the shaft stays bent by 0.4° to either side of what a correction reaches."""
GAIN, RIDGE = 0.7, 0.05
"""g and ρ. Below 1, as no two repetitions are quite alike in a needle that snaps."""
STEP_RAD = rad(2.0)
"""Of the slopes, to either side."""


def begun(history: History) -> bool:
    """Whether a repetition has begun."""
    return any(motion.name.startswith(UNWIND) for motion in history)


def next_repetition(
    aim: Aim, model: NeedleModel, history: History, most: int, enough_rad: float, effort: Effort
) -> Waypoint | None:
    """The next motion of a repetition; None where the shaft is straight within `enough_rad` at every Hall
    sensor in tissue, after `most` repetitions, or where no sensor is in tissue.

    `history` is of a sequence that has ended, and of the repetitions so far. Raises Spent, SolverError.
    """
    first, *repeated = _runs(history)
    target = aim.task.target_rad
    beyond = max((motion.base_angle_rad - target for motion in first), key=abs)
    if repeated and (done := len(repeated[-1]) - 1) < len(SHARES):
        angles = target + beyond * SHARES
        if len(repeated) > 1:
            angles = _corrected(aim, model, repeated[-2], effort)
        settle_s = aim.settle_s if done < len(SHARES) - 1 else None
        return Waypoint(float(angles[done]), f"repeat_{len(repeated)}_{done + 1}", settle_s=settle_s)
    errors = _errors_rad(aim, model, history)
    worst = float(np.abs(errors).max(initial=0.0))
    if worst <= enough_rad or len(repeated) == most:
        return None
    low, high = aim.reach
    return Waypoint(
        min(max(target - UNWIND_SHARE * beyond, low), high),
        f"{UNWIND}_{len(repeated) + 1}",
        settle_s=aim.settle_s,
        note=f"Hall angles are up to {deg(worst):.1f}° from the target: repeats the sequence, corrected by"
        f" them ({len(repeated) + 1} of at most {most})",
    )


def _runs(history: History) -> list[History]:
    """The motions of the sequence itself, without the rest before it, and those of each repetition."""
    starts = [place for place, motion in enumerate(history) if motion.name.startswith(UNWIND)]
    ends = [*starts, len(history)]
    return [history[start:end] for start, end in zip([1, *starts], ends, strict=True)]


def _errors_rad(aim: Aim, model: NeedleModel, run: History) -> Array:
    seen: Array = np.array(run[-1].hall_rad)[_in_tissue(model)] - aim.task.target_rad
    return seen


def _in_tissue(model: NeedleModel) -> NDArray[np.bool_]:
    entry = model.layout.tissue_sections_m[0][0]
    return np.array(model.layout.sensor_positions_m) >= entry


def _corrected(aim: Aim, model: NeedleModel, run: History, effort: Effort) -> Array:
    """The angles of the repetition after `run`, (motions,)."""
    angles = np.array([motion.base_angle_rad for motion in run[1:]])
    slopes = _slopes(aim, model, run[0].base_angle_rad, effort)
    curvature = slopes.T @ slopes + RIDGE * np.eye(len(angles))
    change = -np.linalg.solve(curvature, slopes.T @ _errors_rad(aim, model, run))
    corrected: Array = np.clip(angles + GAIN * change, *aim.reach)
    return corrected


def _slopes(aim: Aim, model: NeedleModel, begin_rad: float, effort: Effort) -> Array:
    """Of the Hall angles in tissue on the angles, (sensors, motions), where the model's own lag is turned."""
    target = aim.task.target_rad
    _, lag_rad = _left(aim, model, begin_rad, np.array([target]), effort)
    nominal = target + lag_rad * SHARES
    steps = STEP_RAD * np.eye(len(SHARES))

    def hall_rad(angles: Array) -> Array:
        return _left(aim, model, begin_rad, angles, effort)[0]

    sides = [hall_rad(nominal + step) - hall_rad(nominal - step) for step in steps]
    return np.array(sides).T / (2.0 * STEP_RAD)


def _left(
    aim: Aim, model: NeedleModel, begin_rad: float, angles_rad: Array, effort: Effort
) -> tuple[Array, float]:
    """Hall angles in tissue and the tip's lag after the turns `angles_rad`, relaxed at `begin_rad` before."""
    times, path = [0.0], [begin_rad]
    for angle in angles_rad:
        travel = max(abs(angle - path[-1]) / aim.task.speed_rad_s, 1e-3)
        times += [times[-1] + travel, times[-1] + travel + aim.settle_s]
        path += [angle, angle]
    trial = Trial(np.array(times), np.array(path))
    rod = model.rod(trial)
    solution = effort.truth(model, trial, relaxed(rod, begin_rad))
    halls: Array = np.asarray(solution.sensor_rad[-1])[_in_tissue(model)]
    return halls, path[-1] - float(solution.state.angle_rad[rod.tip])
