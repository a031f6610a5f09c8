"""Curves of laws that were learnt."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from needle_rig.figures.figure import Figure
from needle_rig.numerics import Array
from needle_rig.workbench.laws.curve import Curve
from needle_rig.workbench.laws.draft import formula_text
from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.learnt import Learnt, LearntLaw

CURVE, BAND, HALVES, FORMULA, EMPTY = "#0b6e4f", "#cfe3da", ("#8a5a00", "#3d6fb5"), "tab:red", "0.93"
SHORT = 0.05
"""Share of the axis: stretches without data that are shorter lie between readings, and are no gap."""
FEW = 12
"""A variable with so few values in the data (a direction, the number of a trial) is shown by points."""
AGAIN = 1.3
"""The axis shows so many times the curve and its band where data are: a band without data has no end."""


def laws_figure(found: Learnt) -> Figure:
    """Each law's curve with its 95 % band, those of halves of the trials, its formula, and where data are."""
    count = max(1, len(found.laws))
    figure = Figure(figsize=(7.4, 5.0 * count), layout="constrained")
    grid = figure.subplots(2 * count, 1, squeeze=False, height_ratios=[5, 1] * count).ravel()
    for law, axes, below in zip(found.laws, grid[::2], grid[1::2], strict=False):
        draw_curve(axes, law)
        axes.set_title(f"{found.origin.dataset}: {law.law.words()}", fontsize=10)
        axes.legend(frameon=False, fontsize=8)
        axes.tick_params(labelbottom=False)
        axes.set_xlabel("")
        _draw_data(below, law)
        below.sharex(axes)
    return figure


def draw_curve(axes: Any, law: LearntLaw) -> None:
    """The curve of one law, in its units; grey where there are no data, where it means nothing."""
    curve = law.curve
    for start, end in _gaps(curve):
        axes.axvspan(start, end, color=EMPTY, linewidth=0.0)
    covered = _covered(curve)
    marker = {"marker": "o", "markersize": 4} if covered.sum() <= FEW else {}
    axes.axhline(0.0, color="0.8", linewidth=0.8)
    axes.fill_between(curve.at, curve.low, curve.high, color=BAND, label="95 % of the curve")
    for number, half in enumerate(curve.halves):
        label = f"from {'one half' if number == 0 else 'the other half'} of the trials"
        axes.plot(curve.at, _where(covered, half), color=HALVES[number], linewidth=0.9, label=label, **marker)
    axes.plot(curve.at, _where(covered, curve.value), color=CURVE, linewidth=1.8, label="curve", **marker)
    axes.plot(curve.at, curve.value, color=CURVE, linewidth=0.7, linestyle="--")
    shown = [curve.low[covered], curve.high[covered]]
    if isinstance(law.told, Formula):
        values = law.told.at(curve.at)
        text = f"{law.told.form.name}: {formula_text(law.told)}"
        axes.plot(curve.at, values, color=FORMULA, linewidth=1.1, linestyle=(0, (5, 2)), label=text)
        shown.append(values[covered])
    if covered.any():
        _limits(axes, np.concatenate(shown))
    axes.set_xlim(curve.at[0], curve.at[-1])
    axes.set_ylabel(_axis(_quantity(law), law.law.unit), fontsize=9)
    axes.set_xlabel(_variable(law), fontsize=9)


def _draw_data(axes: Any, law: LearntLaw) -> None:
    curve = law.curve
    for start, end in _gaps(curve):
        axes.axvspan(start, end, color=EMPTY, linewidth=0.0)
    axes.bar(curve.at, curve.data, width=float(curve.at[1] - curve.at[0]), color="0.55")
    axes.set_yscale("log")
    axes.set_ylim(bottom=0.5)
    axes.set_ylabel("readings", fontsize=9)
    axes.set_xlabel(f"{_variable(law)} (grey: no data)" if _gaps(curve) else _variable(law), fontsize=9)


def _limits(axes: Any, shown: Array) -> None:
    low, high = min(0.0, float(np.nanmin(shown))), max(0.0, float(np.nanmax(shown)))
    room = 0.5 * (AGAIN - 1.0) * max(high - low, np.finfo(float).tiny)
    axes.set_ylim(low - room, high + room)


def _gaps(curve: Curve) -> list[tuple[float, float]]:
    """Stretches of the axis without data."""
    half = 0.5 * float(curve.at[1] - curve.at[0])
    return [(float(curve.at[a]) - half, float(curve.at[b - 1]) + half) for a, b in _runs(~_covered(curve))]


def _covered(curve: Curve) -> npt.NDArray[np.bool_]:
    """Where the axis has data, short stretches between them counted in."""
    covered = curve.data > 0
    if covered.sum() > FEW:
        for a, b in _runs(~covered):
            if a > 0 and b < covered.size and b - a < SHORT * covered.size:
                covered[a:b] = True
    return covered


def _runs(there: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(first, end) of the stretches that are true."""
    edges = np.flatnonzero(np.diff(np.r_[False, there, False].astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _where(covered: npt.NDArray[np.bool_], values: Array) -> Array:
    return np.where(covered, values, np.nan)


def _quantity(law: LearntLaw) -> str:
    """What the curve is a value of."""
    if law.law.hook == "torque":
        return "torque along the needle"
    if law.law.hook == "drive":
        return "needle − encoder"
    if law.law.hook == "observe":
        return "error of the torque reading" if law.law.place == "torque" else f"error of {law.law.place}"
    if law.law.place == "stiffness":
        return "angle before it slips"
    return f"{law.law.place.replace('_', ' ')} / that without it − 1"


def _variable(law: LearntLaw) -> str:
    return _axis(law.law.words().rpartition(" depends on ")[2], law.law.variable_unit)


def _axis(words: str, unit: str) -> str:
    return words if unit == "1" else f"{words} / {unit}"
