"""Plan the rotations with a model of the needle, and correct the plan by what each one showed."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from needle_rig.control.planning.belief import (
    Belief,
    Errors,
    after_next,
    corrected,
    first_belief,
    misfit,
    needles,
)
from needle_rig.control.planning.effort import Effort, Spent
from needle_rig.control.planning.fallback import doubted_at, reed_remaining
from needle_rig.control.planning.plans import (
    ROBUST_EVALUATIONS,
    Aim,
    Plan,
    cheapest,
    likeliest_plans,
    rate,
    refine,
)
from needle_rig.control.planning.repetition import begun, next_repetition
from needle_rig.control.strategy import History, Reason, Strategy, Task, Waypoint
from needle_rig.errors import BadInput, SolverError
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import FRICTION, NeedleModel
from needle_rig.units import deg, nmm, rad

SAMPLES = 8
MOST_AHEAD = 5
PLAN_SOLVES = 350_000.0
"""What one plan may spend, belief and all: half a second of a core that does nothing else."""
TOO_MANY_SOLVES = f"the model snaps too often to be planned with in {PLAN_SOLVES:.0f} solves"
GOING_ON = "going on as reed2008"
TURNING_FIRST = "turning to the target first, as reed2008 does, and planning again from there"
"""For the first motion: it is no correction, so the next one may be planned (see `doubted_at`)."""
CORRECTION_SHARE, LIKELY_SHARE = 0.4, 0.55
"""What correcting the belief may take of it, and the search in the likeliest needle of what is then left."""
FRICTION_SIGMA = 1.64
"""Before friction was seen, also a needle is planned for of which one in twenty slips easier."""
QUICK_SETTLE_S = 0.5
"""For motions between, of a needle that neither creeps nor flows; the last settles as the task says."""


@dataclass(frozen=True)
class Planned(Strategy):
    """The fewest and shortest rotations that leave the shaft straight at the target, by the rig's model.

    Minimised is a quantile, over what is uncertain of the needle, of the worst angle error from the first
    tissue to the tip, plus the torque left (as the lag that it stands for, weighted), plus a price:
    `rotation_price_deg` for each rotation and 0.5° for every 100° turned. After each settled motion, friction
    and the model's other uncertain values are corrected from the torques (and, with `use_hall`, the Hall
    angles), and the rest is planned anew. As long as the friction of the run has not been seen, the base goes
    only as far as every likely needle needs.

    It refuses a model whose error on runs held out of its fit is above `largest_error` times the noise floor.
    When torque or Hall angles are more than `doubt_sigma` from what any likely needle gives, it says so and
    goes on as reed2008.

    Where friction falls as the shaft begins to slip, small causes move it far. If a Hall angle in tissue is
    more than `repeat_above_deg` from the target in the end, the base is turned back, and alternating turns
    are repeated, corrected by these angles, at most `repetitions` times (`planning.repetition`). With
    `use_hall` that is done for every model.
    """

    largest_overshoot_deg: float = 120.0
    rotation_price_deg: float = 0.1
    quantile: float = 0.9
    friction_scatter: float = 0.05
    """Relative standard deviation of friction from run to run."""
    largest_error: float = 5.0
    doubt_sigma: float = 5.0
    use_hall: bool = False
    motions: int = 8
    repetitions: int = 8
    repeat_above_deg: float = 0.4

    def __post_init__(self) -> None:
        if not 0.0 < self.largest_overshoot_deg <= 720.0 or not 0.0 < self.rotation_price_deg <= 20.0:
            raise BadInput("planned: largest_overshoot_deg must be 0 to 720, rotation_price_deg 0 to 20")
        if not 0.5 <= self.quantile <= 1.0 or not 0.0 < self.friction_scatter <= 0.5:
            raise BadInput("planned: quantile must be 0.5 to 1 and friction_scatter above 0, to 0.5")
        if not 0 <= self.repetitions <= 50 or self.repetitions % 1 or not 0.0 < self.repeat_above_deg <= 20.0:
            raise BadInput("planned: repetitions must be a whole number 0 to 50, repeat_above_deg 0 to 20")
        if not self.largest_error > 0 or not self.doubt_sigma > 0 or not 1 <= self.motions <= 20:
            raise BadInput("planned: largest_error and doubt_sigma must be above 0, motions 1 to 20")

    def check(self, task: Task) -> None:
        """Refuse without a model, with one of another rig, or with one that predicts badly."""
        model = task.model
        if model is None:
            raise BadInput(
                "planned needs a model of this rig: give a model file (needle-rig adopt makes one from runs),"
                " or choose reed2008"
            )
        sections, sensors = len(model.layout.tissue_sections_m), len(model.layout.sensor_positions_m)
        have = task.layout
        if sections != len(have.tissue_sections_m) or sensors != len(have.sensor_positions_m):
            raise BadInput(
                f"planned: the model {model.name} is of a rig with {sections} tissue sections and {sensors}"
                f" Hall sensors, this one has {len(have.tissue_sections_m)} and"
                f" {len(have.sensor_positions_m)}; give a model made from runs of this rig"
            )
        error = task.trust.error_over_floor
        if error is not None and error > self.largest_error:
            raise BadInput(
                f"planned refuses the model {model.name}: on runs held out of its fit its error was"
                f" {error:.1f} times the noise floor, limit {self.largest_error:g} (option largest_error);"
                " look for the missing effect (needle-rig diagnose), or choose reed2008"
            )

    def next(self, task: Task, history: History) -> Waypoint | None:
        """The next motion of the newest plan or of a repetition; None when nothing is to be gained."""
        self.check(task)
        inside = _in_this_rig(task)
        if not begun(history):
            waypoint = self._planned(inside, history)
            if waypoint is not None:
                return waypoint
        assert task.model is not None
        if not (self.use_hall or _weakens(replace(task.model, layout=task.layout))):
            return None
        return self._repeated(inside, history)

    def _planned(self, task: Task, history: History) -> Waypoint | None:
        before = doubted_at(history)
        if before is not None:
            return reed_remaining(task, history, before, history[-1].reason)
        effort = Effort(PLAN_SOLVES)
        try:
            belief = self.belief(task, history, effort)
            doubt = self.doubt(task, history, belief, effort)
            if doubt:
                return reed_remaining(task, history, len(history) - 1, Reason.MODEL_DOUBTED, doubt)
            if len(history) > self.motions:
                return None
            plan, note = self.plan(task, history, belief, effort)
        except (Spent, SolverError):
            note = f"{TOO_MANY_SOLVES}, {TURNING_FIRST if len(history) == 1 else GOING_ON}"
            return reed_remaining(task, history, len(history) - 1, Reason.EFFORT_SPENT, note)
        if not plan.angles_rad:
            return None
        last = len(plan.angles_rad) == 1
        return Waypoint(
            plan.angles_rad[0],
            "final" if last else f"step_{len(history)}",
            settle_s=None if last else self._settle_s(task),
            note=note,
        )

    def _repeated(self, task: Task, history: History) -> Waypoint | None:
        assert task.model is not None
        most, enough = self.repetitions, rad(self.repeat_above_deg)
        with suppress(Spent, SolverError):
            return next_repetition(
                self._aim(task, history), task.model, history, most, enough, Effort(PLAN_SOLVES)
            )
        return None

    def _aim(self, task: Task, history: History) -> Aim:
        return Aim(
            task,
            history[-1].base_angle_rad,
            rad(self.largest_overshoot_deg),
            self._settle_s(task),
            self.quantile,
            rad(self.rotation_price_deg),
        )

    def expected_motions(self) -> int:
        """Three: the turn in two parts, and the way back."""
        return 3

    def belief(self, task: Task, history: History, effort: Effort) -> Belief:
        """What is known of the needle after `history`."""
        assert task.model is not None
        first = first_belief(task.model, task.trust.uncertainties, self.friction_scatter)
        return corrected(first, task, history, Errors(), self.use_hall, effort.part(CORRECTION_SHARE))

    def doubt(self, task: Task, history: History, belief: Belief, effort: Effort) -> str:
        """A sentence if no likely needle explains the last settled motion. Raises Spent, SolverError."""
        if len(history) == 1:
            return ""
        sigma, told = misfit(belief, task, history, Errors(), effort)
        if sigma <= self.doubt_sigma:
            return ""
        return f"{told}, {sigma:.0f}σ: the model does not hold here, {GOING_ON}"

    def plan(self, task: Task, history: History, belief: Belief, effort: Effort) -> tuple[Plan, str]:
        """The best rest of the sequence (angles may be none), and what is expected of it.

        Every plan is judged in all samples. Raises Spent when the effort does not suffice for that, and
        SolverError when a sample cannot be followed.
        """
        samples = needles(belief, task, history, SAMPLES, effort)
        aim = self._aim(task, history)
        left = min(MOST_AHEAD, self.motions + 1 - len(history))
        likely = likeliest_plans(aim, samples[0], left, effort.part(LIKELY_SHARE))
        if len(history) == 1:
            plan = rate(aim, samples, cheapest(likely).angles_rad, effort)
            with suppress(Spent, SolverError):
                plan = self._careful(task, history, aim, belief, plan, effort)
            # planning anew may spare a rotation that is not worth its price any more
            slack_rad, unseen = aim.rotation_price_rad, True
        else:
            plans = [rate(aim, samples, (), effort)]
            # the best first: a search cut short has no use for the shortest alone
            for chosen in dict.fromkeys([cheapest(likely).angles_rad, likely[0].angles_rad]):
                with suppress(Spent):
                    plans.append(refine(aim, samples, chosen, ROBUST_EVALUATIONS, effort))
            if len(plans) == 1:
                raise Spent
            plan = cheapest(plans)
            slack_rad, unseen = 0.0, False
        if not plan.followed:
            raise Spent
        return plan, _expectation(plan, belief, slack_rad, unseen)

    def _careful(
        self, task: Task, history: History, aim: Aim, belief: Belief, plan: Plan, effort: Effort
    ) -> Plan:
        """The plan, its first motion cut to what the needle that slips easiest needs, where that pays.

        Going on in the same direction later loses nothing; having gone too far would cost a reversal. What
        it will leave is judged by needles as alike as they will be when the torque has been read.
        """
        easy = belief.mean.copy()
        easy[belief.names.index(FRICTION)] -= FRICTION_SIGMA
        light = needles(replace(belief, mean=easy), task, history, 1, effort)
        near = refine(aim, light, plan.angles_rad, ROBUST_EVALUATIONS, effort).angles_rad[0]
        near = min((near, plan.angles_rad[0]), key=lambda angle: abs(angle - aim.base_rad))
        surer = after_next(belief, task, history, near, Errors(), effort)
        sure = needles(surer, task, history, SAMPLES, effort)
        known = refine(aim, sure, plan.angles_rad, ROBUST_EVALUATIONS, effort)
        if plan.cost_rad <= known.cost_rad + aim.rotation_price_rad:
            return plan
        return replace(known, angles_rad=(near, *known.angles_rad))

    def _settle_s(self, task: Task) -> float:
        assert task.model is not None
        return task.settle_s if _takes_time(task.model) else min(QUICK_SETTLE_S, task.settle_s)


def _in_this_rig(task: Task) -> Task:
    assert task.model is not None
    return replace(task, model=_without_snaps(replace(task.model, layout=task.layout)))


@lru_cache(maxsize=8)
def _without_snaps(model: NeedleModel) -> NeedleModel:
    """The model; where it snaps, without the static excess, since snaps end at the kinetic friction.

    Following snaps takes so many solves that a search with them ends far from the best plan: on a needle
    with e = 0.25 it left 2.3° where the kinetic friction's plan left 0.5° and reed2008 0.9°.
    """
    if not _snaps(model):
        return model
    place, bare = Trial(np.empty(0), np.empty(0)), replace(model, effects=())
    return model.without(
        *(e.name() for e in model.effects if bare.with_effects(e).rod(place).static_excess.any())
    )


@lru_cache(maxsize=8)
def _snaps(model: NeedleModel) -> bool:
    """Whether the model's static friction is above its kinetic friction by so much that the shaft snaps."""
    return model.rod(Trial(np.empty(0), np.empty(0))).snaps


@lru_cache(maxsize=8)
def _weakens(model: NeedleModel) -> bool:
    """Whether the friction falls as the shaft begins to slip, so that small causes move it far."""
    return bool(model.rod(Trial(np.empty(0), np.empty(0))).static_excess.any())


@lru_cache(maxsize=8)
def _takes_time(model: NeedleModel) -> bool:
    """Whether the needle goes on moving while its base stands still."""
    rod = model.rod(Trial(np.empty(0), np.empty(0)))
    creeps = np.isfinite(rod.creep_viscosity_nms_per_rad) & np.isfinite(rod.creep_stiffness_nm_per_rad)
    return bool(creeps.any() or rod.viscous_nms_per_rad.any())


def _expectation(plan: Plan, belief: Belief, slack_rad: float, unseen: bool) -> str:
    """What should be left, as a person wants to know it."""
    median, high = (deg(float(q)) for q in np.quantile(plan.ends.worst_rad, [0.5, 0.95]))
    high += deg(slack_rad)
    torque = np.quantile(np.abs(plan.ends.torque_nm), 0.95)
    factor, spread = belief.friction_factor()
    count = len(plan.angles_rad)
    rotations = "1 rotation" if count == 1 else f"{count} rotations"
    friction = "" if unseen else f", friction {100 * factor:.0f} ± {100 * spread:.0f} % of the model's"
    return (
        f"plans {rotations}, expects {median:.1f}° (95 %: {high:.1f}°) at the"
        f" worst place of the shaft and up to {nmm(float(torque)):.3f} N·mm left{friction}"
    )
