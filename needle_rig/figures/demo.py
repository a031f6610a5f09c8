"""The demo as one picture."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.layout_engine import ConstrainedLayoutEngine

from needle_rig.figures.figure import Figure
from needle_rig.figures.laws import draw_curve
from needle_rig.figures.plan import base_path
from needle_rig.figures.style import spelt
from needle_rig.units import mm
from needle_rig.workbench.contest.demo import Story
from needle_rig.workbench.learning.learn_law import LawLesson


def demo_figure(story: Story) -> Figure:
    """The model's error before and after, the law if one was learnt, the shaft at the end, the base's way."""
    laws = story.lesson.learnt.laws if isinstance(story.lesson, LawLesson) else ()
    picture = Figure(figsize=(12.0 + 4.5 * len(laws), 4.2), layout=ConstrainedLayoutEngine(w_pad=0.12))
    left, *between, middle, right = picture.subplots(
        1, 3 + len(laws), width_ratios=(1, *(1.6 for _ in laws), 1.6, 1.6)
    )
    for law, axes in zip(laws, between, strict=True):
        draw_curve(axes, law)
        axes.set_title("\n".join(textwrap.wrap(law.law.words(), 44)), fontsize=10)
        axes.legend(frameon=False, fontsize=7)
    held = story.as_json()["held_out_error"]
    adopted = "\n+ ".join(story.lesson.adopted) or "nothing"
    bars = left.bar(["rigid", f"+ {spelt(adopted)}"], [held["before"], held["after"]])
    left.bar_label(bars, fmt="%.1f", padding=3)
    left.margins(y=0.1)
    bars[0].set_color("#b04a3a")
    bars[1].set_color("#0b6e4f")
    left.axhline(held["noise_floor"], color="black", linewidth=1.0, linestyle="--")
    left.set_yscale("log")
    left.set(ylabel="error / noise", title="runs left out")
    looks = (("reed2008", story.plain, "#b04a3a"), ("planned", story.planned, "#0b6e4f"))
    for name, runs, colour in looks:
        for k, run in enumerate(runs):
            label = name if k == 0 else None
            middle.plot(mm(run.position_m), np.degrees(run.shaft_rad), color=colour, alpha=0.6, label=label)
        if runs:
            time_s, base_deg = base_path(runs[0])
            right.plot(time_s, base_deg, color=colour, label=f"{name}, {runs[0].rotations} rotations")
    middle.axhline(story.target_deg, color="black", linewidth=1.0, linestyle="--")
    middle.set(xlabel="place along the needle / mm", ylabel="angle / °", title="the shaft at the end")
    middle.legend()
    right.axhline(story.target_deg, color="black", linewidth=1.0, linestyle="--")
    right.set(xlabel="time / s", ylabel="angle / °", title="the base on its way")
    right.legend()
    return picture
