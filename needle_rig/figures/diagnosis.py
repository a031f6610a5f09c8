"""A diagnosis as one picture."""

from __future__ import annotations

import numpy as np

from needle_rig.figures.figure import Figure
from needle_rig.workbench.selection.answer import Answer

SHOWN = 12


def ranking_figure(found: Answer) -> Figure:
    """Error left out by candidate, the best first, beside the current model and the noise."""
    rows = [r for r in found.ranking if r.held_out_error is not None][:SHOWN]
    figure = Figure(figsize=(7.5, 1.4 + 0.34 * (len(rows) + 1)), layout="constrained")
    axes = figure.subplots()
    names = ["the current model", *(r.effect for r in rows)]
    errors = [found.held_out_error_before, *(float(r.held_out_error or np.nan) for r in rows)]
    colours = ["0.6", *("#0b6e4f" if r.effect in found.effects else "#b5bcc2" for r in rows)]
    bars = axes.barh(names, errors, color=colours)
    axes.bar_label(bars, fmt=" %.2f", fontsize=8)
    axes.axvline(found.noise_floor, color="black", linewidth=1.0, linestyle="--", label="noise")
    axes.set_xscale("log")
    axes.set_xlim(0.7, 1.8 * float(np.nanmax(errors)))
    axes.invert_yaxis()
    axes.set_xlabel(f"error on {found.left_out} left out, × the noise")
    axes.set_title(f"{found.dataset}: {' and '.join(found.effects) or found.verdict}", fontsize=11)
    axes.legend(frameon=False, fontsize=8)
    return figure
