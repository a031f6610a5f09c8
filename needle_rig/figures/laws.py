"""Curves of laws that were learnt."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from needle_rig.workbench.laws.formulas import Formula
from needle_rig.workbench.laws.learn import Learnt


def laws_figure(found: Learnt) -> Figure:
    """Each law's curve with its 95 % band, that of halves of the trials, its formula, and where data are."""
    count = max(1, len(found.laws))
    figure = Figure(figsize=(7.0, 4.6 * count), layout="constrained")
    grid = figure.subplots(2 * count, 1, squeeze=False, height_ratios=[5, 1] * count).ravel()
    for law, axes, below in zip(found.laws, grid[::2], grid[1::2], strict=False):
        curve = law.curve
        covered = curve.data > 0
        axes.fill_between(curve.at, curve.low, curve.high, color="#cfe3da", label="95 %")
        for number, half in enumerate(curve.halves):
            label = "halves of the trials" if number == 0 else None
            axes.plot(curve.at, half, color="0.6", linewidth=0.8, linestyle=":", label=label)
        axes.plot(curve.at, np.where(covered, curve.value, np.nan), color="#0b6e4f", label="curve")
        axes.plot(curve.at, curve.value, color="#0b6e4f", linewidth=0.7, linestyle="--")
        if isinstance(law.told, Formula):
            form = law.told.form.name
            axes.plot(curve.at, law.told.at(curve.at), color="tab:red", linewidth=1.0, label=form)
        unit = "" if law.law.unit == "1" else f" / {law.law.unit}"
        axes.set_ylabel(f"curve{unit}", fontsize=9)
        axes.set_title(f"{found.origin.dataset}: {law.law.words()}", fontsize=10)
        axes.legend(frameon=False, fontsize=8)
        axes.tick_params(labelbottom=False)
        below.bar(curve.at, curve.data, width=float(curve.at[1] - curve.at[0]), color="0.7")
        below.sharex(axes)
        below.set_ylabel("data", fontsize=9)
        along = "" if law.law.variable_unit == "1" else f" / {law.law.variable_unit}"
        below.set_xlabel(f"{law.law.variable.replace('_', ' ')}{along}", fontsize=9)
    return figure
