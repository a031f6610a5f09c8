"""A row on either side of every threshold that carries a verdict. Numbers are typed here on purpose."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.special import chdtri

from needle_rig.numerics import beyond_chance
from needle_rig.physics.library import built_in_effects
from needle_rig.workbench.estimation.baseline import Baseline, fit_baseline
from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.linear import LinearisedFit
from needle_rig.workbench.estimation.parameters import FreeParameter
from needle_rig.workbench.estimation.posterior import excess
from needle_rig.workbench.observations.snaps import Snap
from needle_rig.workbench.policy import POLICY, Policy, thresholds
from needle_rig.workbench.published.single_effects import Candidate as SettledCandidate
from needle_rig.workbench.selection import candidates, residual_patterns, screening, search
from needle_rig.workbench.selection.candidates import penalty, refinable
from needle_rig.workbench.selection.decisions import _decision
from needle_rig.workbench.selection.evidence import adjusted_p, within_discretisation_error
from needle_rig.workbench.selection.notes import contrived
from needle_rig.workbench.selection.places import Place, looked_through
from needle_rig.workbench.selection.residual_patterns import (
    Pattern,
    ResidualPatterns,
    find_residual_patterns,
)
from needle_rig.workbench.selection.rivals import cannot_be_told_apart
from needle_rig.workbench.selection.screening import (
    Screening,
    Start,
    screen,
)
from needle_rig.workbench.selection.search import (
    EffectSet,
    SearchTrace,
    next_move,
    promise_asked,
)
from needle_rig.workbench.selection.verdict import Findings, reasons, verdict
from tests.workbench.hidden import dataset, effect, few, null_fit

WORKBENCH_TESTS = Path(__file__).resolve().parents[1]


def fit(**known: Any) -> Any:
    """A stand-in for a fit, with what a rule looks at."""
    vector = SimpleNamespace(trial_friction=np.zeros(1))
    common: dict[str, Any] = {
        "objective": 0.0,
        "rank": 0,
        "scatter": 0.025,
        "scatter_dof": 9.0,
        "parameters": (),
    }
    return SimpleNamespace(**{**common, "effects": (), "pull_rigidity": 0.0, "vector": vector, **known})


@pytest.fixture(scope="module")
def baseline() -> Baseline:
    return null_fit(seed=21)


def test_every_threshold_says_why_and_names_a_test_that_is_there() -> None:
    rows = list(thresholds(POLICY))
    assert len(rows) > 25
    for row in rows:
        assert row.reason
        assert row.source
        assert (WORKBENCH_TESTS / row.guard).exists(), row


def test_the_policy_is_printed_as_plain_values() -> None:
    shown = Policy().as_json()
    assert shown["evidence"]["significance"] == 0.01
    assert sum(len(group) for group in shown.values()) == len(list(thresholds(Policy())))


@pytest.mark.parametrize(("p", "passes"), [(0.006, True), (0.017, False)])
def test_an_effect_is_seen_at_one_percent_over_the_library(p: float, passes: bool) -> None:
    names = tuple("abcdefghij")
    single = 1.0 - (1.0 - p) ** (1.0 / len(names))
    parent, child = fit(objective=float(chdtri(1, 2.0 * single))), fit()
    assert adjusted_p(parent, child, len(names)) == pytest.approx(p, rel=1e-6)
    problem = SimpleNamespace(nuisance=(np.zeros((1, 0)),))
    validation = CrossValidation(1.0, 10.0, ()), CrossValidation(1.0, 0.0, ())
    fits = {frozenset(): (parent, validation[0]), frozenset("a"): (child, validation[1])}
    trace: Any = SimpleNamespace(fits=fits, names=names, problem=problem, laws={})
    assert SearchTrace.passes(trace, frozenset(), frozenset("a")) is passes


@pytest.mark.parametrize(("change", "within"), [(2.4, True), (3.6, False)])
def test_a_change_beyond_three_times_the_discretisation_error_is_none_of_it(
    change: float, within: bool
) -> None:
    problem: Any = SimpleNamespace(nuisance=(np.array([[1.0], [0.0]]),))
    parent, child = fit(residuals=(np.array([change, 0.0]),)), fit(residuals=(np.zeros(2),))
    assert within_discretisation_error(problem, parent, child) is within


@pytest.mark.parametrize(("error_share", "decision"), [(0.8, "absent"), (1.25, "cannot_tell")])
def test_a_size_is_limited_at_its_one_sided_95_percent(
    baseline: Baseline, error_share: float, decision: str
) -> None:
    (parameter,) = baseline.problem.parameters(["torque_bias"])
    error = parameter.smallest / 1.645 * error_share
    vector = SimpleNamespace(scaled_values=np.zeros(1))
    found = fit(parameters=(parameter,), vector=vector, scaled_errors=np.array([error]))
    assert _decision("torque_bias", found, None).decision == decision


@pytest.mark.parametrize(("information", "seen"), [(0.7, 1), (1.4, 2)])
def test_a_parameter_counts_when_the_data_know_it_to_its_typical_size(
    baseline: Baseline, information: float, seen: int
) -> None:
    problem = baseline.problem
    parameters = problem.parameters(["torque_bias", "tip_friction"])
    rows = [np.zeros(w.channel.size) for w in problem.whiteners]
    jacobians = [np.zeros((r.size, 5)) for r in rows]
    for jacobian in jacobians:
        jacobian[0, 0] = jacobian[1, 1] = jacobian[2, 4] = jacobian[3, 2] = 1e3
    jacobians[0][4, 3] = np.sqrt(information)
    x = np.r_[np.log(1e-3), np.log(problem.base.torsional_rigidity_nm2), 0.0, 0.0, np.zeros(len(rows))]
    x = np.r_[x, np.zeros(problem.nuisance[0].shape[1])]
    assert LinearisedFit.at(problem, parameters, x, rows, jacobians, 1600.0).rank == seen


@pytest.mark.parametrize(("behind", "tied"), [(7.0, True), (14.0, False)])
def test_what_ties(behind: float, tied: bool) -> None:
    assert cannot_be_told_apart(behind) is tied


@pytest.mark.parametrize(("gain", "asked"), [(0.0, 0.0), (10.0, 0.0), (110.0, 25.0)])
def test_a_quarter_of_the_gain_that_would_tie_must_be_promised(gain: float, asked: float) -> None:
    assert promise_asked(gain) == asked


def test_a_parameter_costs_the_logarithm_of_five_times_the_trials() -> None:
    problem: Any = SimpleNamespace(trials=[None] * 4)
    assert penalty(problem) == pytest.approx(np.log(20.0))


@pytest.mark.parametrize(("left", "testable"), [(0.028, False), (0.056, True)])
def test_a_pattern_that_the_parameters_fit_is_not_tested(left: float, testable: bool) -> None:
    assert residual_patterns.testable(np.array([left]), np.array([2.0])) == [testable]


@pytest.mark.parametrize(("above", "refined"), [(1700.0, True), (3400.0, False)])
def test_first_fits_that_ended_early_are_refined(above: float, refined: bool) -> None:
    problem: Any = SimpleNamespace(size=200)
    value = 200 + 5.0 * np.sqrt(400.0) + above
    assert bool(refinable(problem, fit(objective=value))) is refined


@pytest.mark.parametrize(("sigmas", "above"), [(4.0, 0.0), (7.0, 2.0 * np.sqrt(400.0))])
def test_an_objective_misses_something_from_five_standard_deviations_on(sigmas: float, above: float) -> None:
    problem: Any = SimpleNamespace(size=200)
    assert excess(problem, 200 + sigmas * np.sqrt(400.0)) == pytest.approx(above)


class Trace(SimpleNamespace):
    """A stand-in for a search's trace: scores by set, and the effects that are named."""

    def score(self, key: EffectSet) -> float:
        return float(self.scores[key])

    def by_score(self, key: EffectSet) -> tuple[float, list[str]]:
        return self.scores[key], sorted(key)

    def named(self, key: EffectSet) -> list[str]:
        return sorted(key & self.large)


def sets(*words: str) -> list[EffectSet]:
    return [frozenset(word) for word in words]


def test_three_sets_are_followed_side_by_side() -> None:
    a, b, c, d = options = sets("a", "b", "c", "d")
    trace: Any = Trace(best=a, large=frozenset("abcd"))
    assert search._frontier(trace, options, 3) == [a, b, c]
    assert search._frontier(trace, [a, d], 3) == [a, d]
    assert search._frontier(trace, options, 1) == [a]


def test_what_promises_a_quarter_of_what_would_tie_is_fitted() -> None:
    promised = {"best": 100.0, "rival": 23.0, "faint": 22.0}
    fitted: list[str] = []

    def run(what: Any, tasks: Any) -> list[Any]:
        if what is candidates.screened:
            return [
                candidates.Candidate(n, None, None, Screening(n, promised[n], (), 1.0, 0.0)) for _, n in tasks
            ]
        fitted.extend(c.effect for _, c in tasks)
        return [c for _, c in tasks]

    work: Any = SimpleNamespace(run=run)
    key: EffectSet = frozenset()
    parent: Any = fit(objective=500.0)
    none: Any = None
    trace = SearchTrace(none, tuple(promised), parent, none, key, {key: (parent, None)}, {}, {})
    trace = search.expand(trace, work, key)
    assert fitted == ["best", "rival"]
    fitted.clear()
    search.expand(dataclasses.replace(trace, children={}), work, key, gain=110.0)
    assert fitted == ["best"]


@pytest.mark.parametrize(
    ("scaled", "set_aside_before", "move"),
    [(0.002, 0, "take out"), (0.004, 0, "set aside"), (0.02, 1, "set aside"), (0.02, 2, "end"),
     (0.5, 0, "forward")],
)  # fmt: skip
def test_what_becomes_of_an_effect_that_is_too_small(
    baseline: Baseline, scaled: float, set_aside_before: int, move: str
) -> None:
    (parameter,) = baseline.problem.parameters(["torque_bias"])
    found = fit(parameters=(parameter,), vector=SimpleNamespace(scaled_values=np.array([scaled])))
    key = frozenset(["torque_bias"])
    negligible = dict.fromkeys(range(set_aside_before))
    large = key if scaled >= parameter.smallest else frozenset()
    trace: Any = Trace(fits={key: (found, None)}, best=frozenset(), negligible=negligible, large=large)
    assert next_move(trace, key, 3)[0] == move


@pytest.mark.parametrize(
    ("rows", "asked"),
    [
        ([[n] for n in range(60)], 60),  # each is looked at
        ([list(range(64))], 64),
        ([list(range(128))], 64 + 2),  # every second, and both neighbours of the best
        ([list(range(1024))], 64 + 30),  # every sixteenth, and all between the best one's neighbours
    ],
)
def test_of_many_places_an_even_choice_is_looked_at_then_those_near_the_best(
    rows: list[list[float]], asked: int
) -> None:
    info = dataclasses.replace(
        few("torque_bias")["torque_bias"].parameters()["bias_nmm"], shapes=True, places=lambda _: rows
    )
    placed = FreeParameter("x", "at", None, info, tuple(map(tuple, rows)))
    best = rows[len(rows) // 3][len(rows[0]) // 3]
    seen: list[float] = []

    def seen_at(forms: Any) -> list[Place]:
        seen.extend(form[0] for form in forms)
        return [Place(Start(form, -abs(form[0] - placed.scaled_value(best))), 1.0) for form in forms]

    looked = looked_through([placed], seen_at)
    first = next(iter(looked.values()))
    assert first.start.scaled_values[0] == placed.scaled_value(best)
    assert len(seen) == len(set(seen)) == len(looked)
    assert abs(len(seen) - asked) <= 2


def left(size: float = 1.0, unit: str = "°") -> ResidualPatterns:
    return ResidualPatterns((Pattern("torque", "is off by a constant", 9.0, size, unit, 1.0),), 81.0)


NOTHING_LEFT = ResidualPatterns((), 0.0)


SNAPS = (Snap("trials/01.csv", "hold", "hall_1", 3.0, 8.0, 2.7),)


@pytest.mark.parametrize(
    ("found", "fired"),
    [
        (Findings((), NOTHING_LEFT, 1.0), []),
        (Findings(("a",), NOTHING_LEFT, 9.0), []),
        (Findings(("a",), NOTHING_LEFT, 9.0, fitted_error=1.27), []),
        (Findings(("a",), NOTHING_LEFT, 9.0, fitted_error=1.33), ["noise_not_reached"]),
        (Findings((), left(0.09), 1.0), []),
        (Findings((), left(0.16), 1.0), ["pattern_matters"]),
        (Findings((), left(0.0006, "N·mm"), 1.0), []),
        (Findings((), left(0.0011, "N·mm"), 1.0), ["pattern_matters"]),
        (Findings((), left(1.5, "%"), 1.0), []),
        (Findings((), left(2.8, "%"), 1.0), ["pattern_matters"]),
        (Findings(("a",), left(0.01), 1.27), []),
        (Findings(("a",), left(0.01), 1.33), ["noise_not_reached"]),
        (Findings((), NOTHING_LEFT, 1.27), []),
        (Findings((), NOTHING_LEFT, 1.33), ["noise_not_reached"]),
        (Findings((), NOTHING_LEFT, np.inf), []),
        (Findings((), NOTHING_LEFT, 1.27, SNAPS), []),
        (Findings((), NOTHING_LEFT, 1.33, SNAPS), ["stick_slip"]),
        (Findings((), NOTHING_LEFT, np.inf, SNAPS), []),
        (Findings(("a",), NOTHING_LEFT, 3.0, SNAPS), []),
        (Findings(("a",), NOTHING_LEFT, 3.0, SNAPS, fitted_error=1.33), ["stick_slip"]),
        (Findings(("a",), left(), 3.0), ["pattern_matters", "noise_not_reached"]),
    ],
)
def test_which_rules_find_something_unexplained(found: Any, fired: Any) -> None:
    why = reasons(found)
    assert [r.rule for r in why] == fired
    assert all(r.sentence for r in why)
    assert verdict(found.named, why) == ("unknown" if fired else "effect" if found.named else "none")


def test_an_effect_is_simulated_at_three_sizes_with_its_typical_form(
    baseline: Baseline, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried: list[np.ndarray] = []
    monkeypatch.setattr(screening, "signature", lambda *given: tried.append(given[-1]))
    problem = dataclasses.replace(baseline.problem, library=built_in_effects())
    screen(problem, baseline.current, "tissue_elasticity")
    assert np.ravel(tried) == pytest.approx([0.1, 0.5, 1.5])
    tried.clear()
    screen(problem, baseline.current, "tissue_viscoelasticity")
    assert len(tried) == 3


def test_stick_slip_is_named_with_where_it_was_seen_and_what_it_keeps_from_being_told() -> None:
    (reason,) = reasons(Findings((), NOTHING_LEFT, 3.0, SNAPS))
    for said in ("stick-slip", "trials/01.csv", "hall_1", "cannot be told"):
        assert said in reason.sentence


def test_patterns_and_trends_must_be_far_beyond_chance() -> None:
    assert POLICY.evidence.clear_of(1) == pytest.approx(3.29, abs=0.01)
    assert POLICY.evidence.clear_of(200) == pytest.approx(4.57, abs=0.02)
    assert beyond_chance(POLICY.evidence.trend, 2) == pytest.approx(4.06, abs=0.01)


def test_five_patterns_are_told() -> None:
    data = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45))
    there = fit_baseline(data, None, few("torque_bias"))
    told = find_residual_patterns(there.problem, there.current, data.sensor_names).patterns
    assert len([p for p in told if p.channel != "the trials' friction"]) == 5
    # each is as many σ as it lowers χ² beside those before it, which another way of fitting them says, too
    readings = there.problem.predict(there.current.parameters, there.current.vector)
    columns, names = residual_patterns._whitened_functions(there.problem, readings, data.sensor_names)
    project = LinearisedFit.of(there.problem, there.current).projection
    free = np.column_stack([project(columns), project.rigidity()])
    beside: list[np.ndarray] = []
    before = project.missed @ project.missed
    for pattern in told[:5]:
        name = (pattern.channel, pattern.law)
        beside.append(free[:, names.index(name) if name in names else -1])
        fitted = np.column_stack(beside)
        left = project.missed - fitted @ np.linalg.lstsq(fitted, project.missed, rcond=None)[0]
        assert pattern.sigmas**2 == pytest.approx(before - left @ left, rel=1e-6)
        before = left @ left


@pytest.mark.parametrize(
    ("count", "size", "assumed_noise", "described_only"),
    [
        (2, 50.0, False, False),
        (3, 50.0, False, True),
        (3, 0.0, False, False),
        (3, 0.0, True, True),
        (2, 0.0, True, False),
    ],
)
def test_more_than_two_effects_are_named_with_plausible_values_and_known_noise_only(
    baseline: Baseline, count: int, size: float, assumed_noise: bool, described_only: bool
) -> None:
    names = ["torque_bias", "tip_friction", "chuck_backlash"][:count]
    parameters = baseline.problem.parameters(names)
    vector = SimpleNamespace(
        scaled_values=np.array([size if a.bounds[1] >= size else a.bounds[1] for a in parameters])
    )
    found = fit(parameters=parameters, vector=vector, scaled_errors=np.ones(len(parameters)))
    validations: Any = [SimpleNamespace(error=error) for error in (9.0, 2.5)]
    fits = {frozenset(names): (found, validations[1])}
    trace: Any = SimpleNamespace(best=frozenset(names), fits=fits, root_validation=validations[0])
    said = contrived(trace, names, assumed_noise)
    assert ["9 → 2.5 × the noise" in each for each in said] == [True] * described_only


@pytest.mark.parametrize(("freedom", "testable"), [(0.35, False), (0.7, True)])
def test_settled_values_must_leave_half_a_degree_of_freedom(freedom: float, testable: bool) -> None:
    found: Any = SimpleNamespace(freedom=freedom)
    assert SettledCandidate("x", found, 1.0).testable is testable


def _smallest(parameter: FreeParameter) -> float:
    """Scaled value at which an effect begins to matter; of several items the first."""
    if parameter.info.shapes or parameter.item not in (None, 0):
        return 0.0
    return float(np.clip(parameter.scaled_value(parameter.info.smallest), *parameter.bounds))


def test_the_root_mean_square_that_matters_is_that_of_effects_at_the_smallest_size_that_matters(
    baseline: Baseline,
) -> None:
    """The same size, measured over whole trials: between the quartiles of what the library's effects do."""
    problem, current = baseline.problem, baseline.current
    here = problem.predict(current.parameters, current.vector)
    angles_deg, torques_nmm = [], []
    for name in few():
        own = problem.parameters([name])
        at = np.array([_smallest(a) for a in own])
        there = problem.predict((*current.parameters, *own), screening.beside(problem, current, own, at))
        change = [x - y for x, y in zip(there, here, strict=True)]
        rms = [float(np.sqrt(np.mean(np.concatenate([c[k] for c in change]) ** 2))) for k in range(5)]
        torques_nmm.append(rms[0] * 1e3)
        angles_deg.append(float(np.degrees(max(rms[1:]))))
    shown_deg = [a for a in angles_deg if a > 0.02]
    shown_nmm = [t for t in torques_nmm if t > 1e-4]
    assert min(shown_deg) * 0.7 < POLICY.size.rms_deg < np.median(shown_deg)
    assert min(shown_nmm) * 0.7 < POLICY.size.rms_nmm < 1.3 * np.median(shown_nmm)


def test_a_threshold_cannot_be_changed_in_passing() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        POLICY.ties.close = 1.0  # type: ignore[misc]
