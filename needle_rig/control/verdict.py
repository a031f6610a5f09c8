"""How a sequence ended: the paper's three conditions for an aligned needle, and a sentence."""

from __future__ import annotations

import math

from needle_rig.control.reports import Condition, Outcome, Status
from needle_rig.control.strategy import SettledMotion, Strategy, Task
from needle_rig.units import deg, nmm


def judge(
    task: Task,
    strategy: Strategy,
    settled: tuple[SettledMotion, ...],
    aligned_rad: float,
    aligned_torque_nm: float,
    run: str,
) -> Outcome:
    """The outcome of a sequence that ran to its end, from its last settled motion.

    Reed 2008: (8a) no net torque of the tissue, for which the spread of the angles along the shaft stands in;
    (8b) no torque at the base; (8c) base and tip at the target.
    """
    last = settled[-1]
    angles = (last.base_angle_rad, *last.hall_rad)
    off = max((last.base_angle_rad - task.target_rad, angles[-1] - task.target_rad), key=abs)
    spread = max(angles) - min(angles)
    conditions = (
        Condition(
            "8a", "the angles along the shaft agree", spread, aligned_rad, "rad", spread <= aligned_rad
        ),
        Condition(
            "8b",
            "no torque is left at the base",
            last.torque_nm,
            aligned_torque_nm,
            "N·m",
            abs(last.torque_nm) <= aligned_torque_nm,
        ),
        Condition("8c", "base and tip are at the target", off, aligned_rad, "rad", abs(off) <= aligned_rad),
    )
    aligned = all(condition.met for condition in conditions)
    text = (
        f"aligned: base and tip are within {deg(abs(off)):.1f}° of {deg(task.target_rad):g}°,"
        f" {nmm(abs(last.torque_nm)):.3f} N·mm left"
        if aligned
        else _miss(last, conditions, task, run)
    )
    return outcome("aligned" if aligned else "not_aligned", text, task, strategy, settled, conditions)


def outcome(
    status: Status,
    text: str,
    task: Task,
    strategy: Strategy,
    settled: tuple[SettledMotion, ...],
    conditions: tuple[Condition, ...] = (),
) -> Outcome:
    """An outcome with what the settled motions say; NaN where nothing settled."""
    last = settled[-1] if settled else None
    halls = last.hall_rad if last else ()
    return Outcome(
        status=status,
        text=text,
        target_rad=task.target_rad,
        strategy=strategy.name,
        base_angle_rad=last.base_angle_rad if last else math.nan,
        torque_nm=last.torque_nm if last else math.nan,
        hall_rad=halls,
        tip_lag_rad=last.tip_lag_rad if last else math.nan,
        lag_rad=settled[0].predicted_lag_rad if settled else math.nan,
        mean_rad=sum(halls) / len(halls) if halls else math.nan,
        range_rad=max(halls) - min(halls) if halls else math.nan,
        conditions=conditions,
    )


def _miss(last: SettledMotion, conditions: tuple[Condition, ...], task: Task, run: str) -> str:
    spread, torque, place = conditions
    told = []
    tip = last.hall_rad[-1] if last.hall_rad else last.base_angle_rad
    off = tip - task.target_rad
    if abs(off) > place.limit:
        short = off * math.copysign(1.0, task.target_rad) < 0
        told.append(f"the tip {'lags' if short else 'leads'} {deg(abs(off)):.0f}°")
    elif not spread.met or not place.met:
        told.append(f"the tip is there, but the shaft is twisted by {deg(spread.value):.0f}°")
    if not torque.met:
        told.append(f"{nmm(abs(torque.value)):.3f} N·mm are left at the base, limit {nmm(torque.limit):g}")
    return (
        f"not aligned: {' and '.join(told)}; the model behind this strategy may lack an effect:"
        f" needle-rig diagnose {run}"
    )
