"""The closed circle: runs with the paper's sequence, what is missing in the model, and a better sequence."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from needle_rig.control.strategy import make_strategy
from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg, nmm, rad
from needle_rig.workbench.contest import untold_law
from needle_rig.workbench.contest.strategies_table import Bout, Spread, predicted
from needle_rig.workbench.learning.learn import Lesson, learn
from needle_rig.workbench.learning.learn_law import LawLesson, learn_law
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise
from needle_rig.workbench.virtual.settled_run import SettledRun

FRESH_SEED = 500
"""Runs after learning meet needles that no run before it met."""


class RunsInShort(TypedDict):
    """Runs of one strategy: medians, angles as absolute values."""

    worst_deg: Spread
    tip_lag_deg: float
    torque_nmm: float
    rotations: float
    time_s: float
    runs: int


class ErrorLeftOut(TypedDict):
    """Error on commands left out, in units of the noise, without and with what was learnt."""

    before: float | None
    after: float | None
    noise_floor: float | None


class LearntParameter(TypedDict):
    """One parameter of the model that was learnt."""

    value: float
    uncertainty: float | None


class StoryNumbers(TypedDict):
    """The circle in numbers."""

    hidden: list[str]
    target_deg: float
    verdict: str
    adopted: list[str]
    laws: list[dict[str, Any]]
    """That were learnt, as `learn --json` has them; none where effects of the library were looked for."""
    found: bool
    parameters: dict[str, LearntParameter]
    held_out_error: ErrorLeftOut
    predicted: str
    reed2008: RunsInShort
    planned: RunsInShort | None
    times_better: float | None


@dataclass(frozen=True)
class Story:
    """All of the circle, for a person, a picture or a program."""

    hidden: tuple[str, ...]
    target_deg: float
    lesson: Lesson
    told_before: str
    """What planning was expected to bring, said before it was tried."""
    plain: tuple[SettledRun, ...]
    planned: tuple[SettledRun, ...]
    """Empty when planned refused."""

    @property
    def found(self) -> bool:
        """Whether exactly what was hidden was adopted: the effects, or the law by place and variable."""
        if isinstance(self.lesson, LawLesson):
            named = [law.law for law in self.lesson.learnt.laws]
            return named == [untold_law.SLIT] and len(self.lesson.adopted) == 1
        return set(self.hidden) == set(self.lesson.adopted)

    def worst_deg(self, runs: tuple[SettledRun, ...]) -> list[float]:
        """Worst error along the shaft of each run."""
        return [deg(run.worst_rad(rad(self.target_deg))) for run in runs]

    def as_json(self) -> StoryNumbers:
        """The circle in numbers."""
        lesson = self.lesson
        errors = lesson.after.history[-1].errors["noise_units"]
        before = lesson.before.history[-1].errors["noise_units"]
        return {
            "hidden": list(self.hidden),
            "target_deg": self.target_deg,
            "verdict": lesson.verdict,
            "adopted": list(lesson.adopted),
            "laws": [law.as_json() for law in lesson.learnt.laws] if isinstance(lesson, LawLesson) else [],
            "found": self.found,
            "parameters": {
                name: {"value": value, "uncertainty": lesson.after.uncertainties.get(name)}
                for name, value in lesson.after.model.values().items()
                if np.isfinite(value)
            },
            "held_out_error": {
                "before": before.held_out_after,
                "after": errors.held_out_after,
                "noise_floor": errors.floor,
            },
            "predicted": self.told_before,
            "reed2008": self._summary(self.plain),
            "planned": self._summary(self.planned) if self.planned else None,
            "times_better": self.times_better,
        }

    @property
    def times_better(self) -> float | None:
        """Median worst error of reed2008 over that of planned."""
        if not self.planned:
            return None
        return float(np.median(self.worst_deg(self.plain)) / np.median(self.worst_deg(self.planned)))

    def _summary(self, runs: tuple[SettledRun, ...]) -> RunsInShort:
        worst = self.worst_deg(runs)
        return {
            "worst_deg": {"median": float(np.median(worst)), "q95": float(np.quantile(worst, 0.95))},
            "tip_lag_deg": float(
                np.median([abs(deg(r.history[-1].base_angle_rad - r.tip_rad)) for r in runs])
            ),
            "torque_nmm": float(np.median([abs(nmm(r.torque_nm)) for r in runs])),
            "rotations": float(np.median([r.rotations for r in runs])),
            "time_s": float(np.median([r.time_s for r in runs])),
            "runs": len(runs),
        }


def tell_story(
    plant: NeedleModel,
    library: Mapping[str, type[Effect]],
    *,
    target_deg: float = 45.0,
    runs: int = 8,
    seed: int = 1,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Story:
    """Measure, diagnose, adopt, plan and measure again on `plant`, whose effects nobody knows.

    Raises BadInput, SolverError.
    """
    hidden = tuple(e.name() for e in plant.effects if not e.is_off())
    return _story(
        plant,
        hidden,
        lambda dataset: learn(dataset, library, work=work, say=say),
        target_deg=target_deg,
        runs=runs,
        seed=seed,
        say=say,
    )


def tell_law_story(
    bare: NeedleModel,
    library: Mapping[str, type[Effect]],
    draft: Path,
    *,
    target_deg: float = 45.0,
    runs: int = 8,
    seed: int = 1,
    work: Work | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Story:
    """The same with a law hidden that no library holds, learnt and drafted as an effect file at `draft`.

    Raises BadInput, SolverError.
    """
    law = untold_law.slit(bare.layout)
    return _story(
        bare.with_effects(law),
        (untold_law.in_words(law),),
        lambda dataset: learn_law(dataset, library, draft, work=work, say=say),
        target_deg=target_deg,
        runs=runs,
        seed=seed,
        say=say,
    )


def _story(
    plant: NeedleModel,
    hidden: tuple[str, ...],
    teach: Callable[[Dataset], Lesson],
    *,
    target_deg: float,
    runs: int,
    seed: int,
    say: Callable[[str], None],
) -> Story:
    noise = Noise(friction_scatter=0.05)
    say("eight runs of the standard protocol with reed2008")
    dataset = simulate_dataset(plant, load_protocol("standard"), seed=seed, noise=noise, name="runs")
    lesson = teach(dataset)
    bout = Bout(plant, dataset.needle.torsional_rigidity_nm2, noise, lesson.after)
    told = predicted(bout, (target_deg,), ("relaxed",)).sentence
    say(told)
    say(f"{runs} fresh needles to {target_deg:g}° with each strategy")
    plain, planned = [], []
    for k in range(runs):
        fresh = FRESH_SEED + 100 * seed + k
        plain.append(bout.run(make_strategy("reed2008", {}), target_deg, "relaxed", fresh))
        try:
            planned.append(bout.run(make_strategy("planned", {}), target_deg, "relaxed", fresh))
        except BadInput as refusal:
            say(str(refusal))
    return Story(hidden, target_deg, lesson, told, tuple(plain), tuple(planned))


def in_words(story: Story) -> list[str]:
    """The story as paragraphs."""
    numbers = story.as_json()
    held, plain, planned = numbers["held_out_error"], numbers["reed2008"], numbers["planned"]
    told = [
        f"1. reed2008 on {plain['runs']} fresh needles to {story.target_deg:g}°: the worst place of the shaft"
        f" is {plain['worst_deg']['median']:.1f}° off (95 %: {plain['worst_deg']['q95']:.1f}°), after"
        f" {plain['rotations']:g} rotations and {plain['time_s']:.0f} s.",
        f"2. The model behind it, rigid tissue, predicts runs left out of its fit with an error of"
        f" {held['before']:.1f} × the noise. Something is missing.",
        f"3. {_named(story.lesson)}; adopting brings that error to {held['after']:.1f} × the noise"
        f" (a perfect model: {held['noise_floor']:.1f}).",
    ]
    known = {
        name: value
        for name, value in numbers["parameters"].items()
        if "." in name and value["uncertainty"] is not None
    }
    if known:
        values = ", ".join(f"{n} = {v['value']:.4g} ± {v['uncertainty']:.2g}" for n, v in known.items())
        told[-1] += f" {values}."
    told.append(f"4. Before it moves: {story.told_before}.")
    if planned is None:
        told.append("5. planned refused, so nothing more was run.")
    else:
        told.append(
            f"5. planned with the new model on the same needles: {planned['worst_deg']['median']:.1f}° off"
            f" (95 %: {planned['worst_deg']['q95']:.1f}°), after {planned['rotations']:g} rotations and"
            f" {planned['time_s']:.0f} s: {numbers['times_better']:.1f} times better."
        )
    said = "It was exactly that." if story.found else "That is not what was hidden."
    if story.found and isinstance(story.lesson, LawLesson):
        said = "Nobody had told it."
    told.append(f"Hidden in the rig was {' and '.join(story.hidden) or 'nothing'}. {said}")
    return told


def _named(lesson: Lesson) -> str:
    """What was found, and how."""
    if not isinstance(lesson, LawLesson):
        return f"diagnose names {' and '.join(lesson.adopted) or 'no effect'}"
    found = lesson.learnt
    if found.verdict != "law":
        return f"learn says {found.verdict.replace('_', ' ')}: {found.sentence.rstrip('.')}"
    laws = " and ".join(law.law.words() + (f", {law.formula}" if law.formula else "") for law in found.laws)
    return f"No effect of the library explains it; learn says that {laws}"
