"""Every threshold that can change what a diagnosis says: value, reason, source, and the test that guards it.

Tolerances of iterations, steps of derivatives, numbers of random draws and what only decides what is reported
are not here: they stand where they are used, and change an answer by less than its stated uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from needle_rig.numerics import beyond_chance
from needle_rig.physics.torque_scale import RIGIDITY_NM2, TORQUE_SPAN_NM
from needle_rig.records import JsonObject
from needle_rig.units import nm, nmm, rad

IN_TISSUE_M = 0.22
"""Length of the shipped needle that is in tissue."""

TABLE = "judged by the campaign diagnosis_table: 920 datasets with known answers"
CHOSEN = "chosen, not derived; " + TABLE


def _threshold(value: Any, reason: str, source: str, guard: str) -> Any:
    """A field with its value; `guard` names a test of tests/workbench that notices when it moves."""
    return field(default=value, metadata={"reason": reason, "source": source, "guard": guard})


_RULES = "selection/test_policy.py"
_NOISE = "observations/test_policy.py"
_SHOWN = "observations/test_shown_terms.py"
_SNAPS = "observations/test_snaps.py"


@dataclass(frozen=True)
class NoisePolicy:
    """What counts as noise."""

    still_deg: float = _threshold(
        0.12,
        "a base that stays within this of where it ends holds still",
        CHOSEN,
        _NOISE,
    )
    smallest_motion_rad: float = _threshold(
        0.01,
        "a base that turns by less has moved in no direction: 0.6°",
        CHOSEN,
        _NOISE,
    )
    outlier_sigmas: float = _threshold(
        6.0,
        "further from the median of its neighbours is an outlier, and a larger turn a snap: one Gaussian"
        " sample in 500 million",
        "normal distribution",
        _NOISE,
    )
    floor_deg: float = _threshold(
        0.03,
        "angles are compared no finer than the solver promises",
        "solver.DEFAULT_TOLERANCE_RAD: 0.034°",
        _NOISE,
    )
    held_share: float = _threshold(
        0.1,
        "share of a recording in which the base has settled; below it a hold may be the turning point of a"
        " base that does not rest, and replicates tell the noise",
        "0.04 in a recording that follows a sine (config/recordings/davinci.yaml); 0.25 and more of steps,"
        " turns to and fro that relax the shaft between them counted",
        _NOISE,
    )
    replicate_misfit: float = _threshold(
        3.0,
        "mean square of what replicates share over that of how they differ, above which the model is wrong"
        " and they tell nothing of noise",
        "0.6 to 1.5 in 22 sets with nothing hidden, four kinds of noise; 36 and more with something hidden",
        _SHOWN,
    )
    residual_share: float = _threshold(
        1.0,
        "size of a term that the residual alone shows, in units of the white noise of a sample, above which"
        " it is something missing",
        "noise that drifts by as much as it is white",
        _SHOWN,
    )
    clock_jitter_s: float = _threshold(
        1e-3, "time between base and sensors varies from trial to trial by a tick of 1 kHz", CHOSEN, _NOISE
    )
    start_sigmas: float = _threshold(
        0.5,
        "half of what a shaft's two extreme starts differ by, in σ of a reading, below which that no longer"
        " matters",
        "a bias of 0.5σ in one reading is not seen: p = 0.62",
        _NOISE,
    )
    start_free_share: float = _threshold(
        0.5,
        "share of a trial's readings that must be free of its start for a run-in; below it, that is fitted",
        "chosen, not derived",
        _NOISE,
    )
    offset_floor_share: float = _threshold(
        0.7, "share of the floor that an offset from trial to trial has at least", CHOSEN, _NOISE
    )
    scatter: float = _threshold(0.025, "prior scatter of friction from trial to trial", CHOSEN, _NOISE)
    scatter_dof: float = _threshold(
        4.0,
        "trials that the prior scatter is worth",
        "weak: the replicates of one series outweigh it",
        _NOISE,
    )
    motion_dof: float = _threshold(10.0, "differences of replicates that the floor is worth", CHOSEN, _NOISE)

    @property
    def floor_nmm(self) -> float:
        """The same of the base torque: what twists the needle's shaft in the tissue by `floor_deg`."""
        return nmm(RIGIDITY_NM2 * rad(self.floor_deg) / IN_TISSUE_M)


@dataclass(frozen=True)
class SnapPolicy:
    """When a sensor turned further than its base did for a moment: stick-slip, seen in the data alone."""

    span_s: float = _threshold(
        0.06,
        "time over which turns are compared: a snap ends in it, while at 45°/s the base turns 2.7°",
        "three samples at the 50 Hz of the practice datasets",
        _SNAPS,
    )
    sensor_gain: float = _threshold(
        1.25,
        "a sensor may show this much more than what turned",
        "`hall_gain` and `hall_eccentricity` at five times their typical size",
        _SNAPS,
    )


@dataclass(frozen=True)
class ScreeningPolicy:
    """Which starts are tried before an effect is fitted."""

    strengths: tuple[float, ...] = _threshold(
        (0.1, 0.5, 1.5),
        "sizes, in typical ones, at which an effect is simulated: dry friction answers differently to each",
        "derivatives at 0 miss slip",
        _RULES,
    )
    kept: float = _threshold(
        0.25,
        "share of a fit's gain that screening promises at least",
        "what fitted as well promised 0.7 and more; " + TABLE,
        _RULES,
    )
    places: int = _threshold(
        64,
        "values of what a fit holds (an instant, an order) that are tried, if there are more of them then"
        " also those near the best",
        "every order of a ripple, and each motion of a series of a dozen trials",
        _RULES,
    )


@dataclass(frozen=True)
class SearchPolicy:
    """Which sets of effects are fitted, and which is chosen."""

    price_times_trials: float = _threshold(
        5.0,
        "one parameter costs ln(5 T) with T trials of five motions",
        "the Bayesian information criterion with motions for observations",
        _RULES,
    )
    frontier: int = _threshold(
        3, "sets that are followed side by side", "the first effect may be half of a pair", _RULES
    )
    set_aside: int = _threshold(2, "effects too small to matter that are made nuisances", CHOSEN, _RULES)


@dataclass(frozen=True)
class EvidencePolicy:
    """What the gain of one more effect is worth."""

    significance: float = _threshold(
        0.01,
        "largest p, adjusted over the library, at which an effect counts as seen",
        "the usual level; Šidák's adjustment keeps it over the library",
        _RULES,
    )
    false_alarm: float = _threshold(
        1e-3,
        "chance that a residual pattern, an odd trial, a drift or an interference is named that is not there,"
        " over all forms that are looked for",
        "one false unknown in a thousand datasets",
        _RULES,
    )
    clear_sigmas: float = _threshold(
        5.0,
        "standard deviations that chance does not make: of an objective above the noise, of a discretisation"
        " error that one nuisance no longer stands for, of an autocorrelation",
        "one in two million",
        _RULES,
    )
    discretisation_margin: float = _threshold(
        3.0,
        "a change of the residuals below this many times the discretisation error along it may be that error",
        CHOSEN,
        _RULES,
    )
    rarely: float = _threshold(
        0.05,
        "chance that a size lies beyond its range; that a gain is refined, or the scatter of the rests taken"
        " for an offset, which are none",
        "the usual level of an interval",
        _RULES,
    )
    seen_information: float = _threshold(
        1.0,
        "information on a parameter, scaled to its typical size, above which it is a degree of freedom",
        "a standard deviation of one typical size",
        _RULES,
    )

    @property
    def likely_sigmas(self) -> float:
        """Of a standard normal value that chance seldom exceeds, to either side."""
        return beyond_chance(self.rarely)

    @property
    def limit_sigmas(self) -> float:
        """Upper end of a size's one-sided range."""
        return beyond_chance(2.0 * self.rarely)

    def clear_of(self, tried: int) -> float:
        """Largest of so many standard normal values that chance exceeds with `false_alarm`."""
        return beyond_chance(self.false_alarm, tried)

    @property
    def trend(self) -> float:
        """p of a trend in the trials' friction: an effect that tells of it, of a library of about 30 with
        `significance` each, is to be named first."""
        return self.significance / 100.0


@dataclass(frozen=True)
class TiePolicy:
    """When two explanations cannot be told apart."""

    close: float = _threshold(
        10.0,
        "difference of −2 log posterior within which two explanations tie",
        "odds of e⁵ = 148 to 1",
        _RULES,
    )


@dataclass(frozen=True)
class LawPolicy:
    """When a law that no library holds is said."""

    reached: float = _threshold(
        1.1,
        "error on commands left out, in units of the noise, above which one more law is looked for",
        TABLE + ", where nothing hidden left 0.997 at most",
        "laws/test_policy.py",
    )

    ties: int = _threshold(
        1,
        "further laws that may tie with one that is said; with more, nothing is said",
        "a pair can be told apart by one trial",
        "laws/test_policy.py",
    )


@dataclass(frozen=True)
class SizePolicy:
    """A change of the readings that matters: the largest, and the root mean square of the same change.

    Effects' smallest sizes (`ParameterInfo.smallest`) are such largest changes in Reed's sequence. The root
    mean square of the same changes over a trial is smaller, as most act on a part of it only.
    """

    largest_deg: float = _threshold(
        0.5,
        "an angle off by this counts",
        "a tenth of sequence.aligned_deg of a rig file",
        "../effects/test_contract.py",
    )
    largest_nmm: float = _threshold(0.002, "torque of 0.5° of lag", "the same", "../effects/test_contract.py")
    rms_deg: float = _threshold(
        0.12,
        "root mean square of the same over a trial",
        "below the median of the library's effects: 0.19°",
        _RULES,
    )
    rms_nmm: float = _threshold(
        0.0008,
        "root mean square of the same over a trial",
        "below the median of the library's effects: 0.0009",
        _RULES,
    )

    @property
    def percent(self) -> float:
        """Friction or rigidity off by this moves the torque at the end of the needle's span by
        `largest_nmm`."""
        return 100.0 * nm(self.largest_nmm) / (0.5 * TORQUE_SPAN_NM)

    def small(self, rms: float, unit: str, torque_scale: float = 1.0) -> bool:
        """Whether a change of this root mean square, in °, N·mm or %, does not matter, of a shaft of this
        scale of torques."""
        return rms <= {"°": self.rms_deg, "N·mm": torque_scale * self.rms_nmm, "%": self.percent}[unit]


@dataclass(frozen=True)
class VerdictPolicy:
    """When an answer explains the data."""

    testable_share: float = _threshold(
        0.02,
        "share of a pattern that projection must leave for it to be tested: less is rounding and curvature",
        CHOSEN,
        _RULES,
    )
    reached: float = _threshold(
        1.3,
        "error in units of the noise above which something is left",
        "the campaign null_rates: nothing hidden left 1.26 at most in ten kinds of noise;"
        " a needle of another code that snaps left 1.66",
        _RULES,
    )
    at_any_value: int = _threshold(
        2,
        "effects that may be named together whatever their values, and laws that are added one after the"
        " other: more can stand for anything",
        TABLE,
        _RULES,
    )


@dataclass(frozen=True)
class Policy:
    """All of them."""

    noise: NoisePolicy = NoisePolicy()
    snaps: SnapPolicy = SnapPolicy()
    screening: ScreeningPolicy = ScreeningPolicy()
    search: SearchPolicy = SearchPolicy()
    evidence: EvidencePolicy = EvidencePolicy()
    ties: TiePolicy = TiePolicy()
    laws: LawPolicy = LawPolicy()
    size: SizePolicy = SizePolicy()
    verdict: VerdictPolicy = VerdictPolicy()

    def as_json(self) -> dict[str, JsonObject]:
        """Values by group and name."""
        found: dict[str, JsonObject] = {}
        for row in thresholds(self):
            value = list(row.value) if isinstance(row.value, tuple) else row.value
            found.setdefault(row.group, {})[row.name] = value
        return found


@dataclass(frozen=True)
class Threshold:
    """One of them as a row of a table."""

    group: str
    name: str
    value: Any
    reason: str
    source: str
    guard: str


def thresholds(policy: Policy) -> Iterator[Threshold]:
    """Every threshold of a policy."""
    for group in fields(policy):
        part = getattr(policy, group.name)
        assert is_dataclass(part)
        for each in fields(part):
            yield Threshold(group.name, each.name, getattr(part, each.name), **each.metadata)


POLICY = Policy()
