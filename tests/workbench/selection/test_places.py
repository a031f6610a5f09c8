"""What a fit holds, an order or an instant: it is looked for, priced by its chances, and named."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.physics.effect import Effect
from needle_rig.physics.solver import solve_series
from needle_rig.workbench.estimation import simulator
from needle_rig.workbench.estimation.problem import ParameterVector
from needle_rig.workbench.selection.candidates import score
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.evidence import adjusted_p
from needle_rig.workbench.selection.places import look_through
from needle_rig.workbench.selection.screening import signature
from tests.workbench.hidden import FEW, dataset, effect, few, fit, null_fit, try_effect

PLACED = ("coupling_slip", "transmission_error", "torque_ripple")
GEARED = effect("transmission_error", sine_deg=0.8, cosine_deg=-0.6, order=14)
RIPPLED = effect("torque_ripple", sine_nmm=0.006, cosine_nmm=0.004, order=7)


def slipped(trial: int, after_s: float = 0.0) -> Effect:
    """A slip so long after the beginning of a trial (from 0)."""
    start_s = dataset().trials[trial].trial.start_s
    return effect("coupling_slip", slip_deg=5.0, at_s=start_s + after_s)


def test_a_fit_keeps_the_order_that_it_is_given() -> None:
    baseline = null_fit(GEARED, library=PLACED)
    problem = baseline.problem
    parameters = problem.parameters(["transmission_error"])
    for order in (13.0, 14.0):
        start = dataclasses.replace(
            baseline.current.vector, scaled_values=np.array([0.1, 0.1, parameters[2].scaled_value(order)])
        )
        found = fit(problem, ["transmission_error"], start)
        assert parameters[2].value(found.vector.scaled_values[2]) == order
        assert found.rank == 2  # the order is no direction that data see
        assert all(not j[:, 4].any() for j in found.jacobians)


@pytest.mark.parametrize(
    ("hidden", "place"),
    [(GEARED, 14.0), (RIPPLED, 7.0), (slipped(3), None), (slipped(2, 1.13), None)],
    ids=["gear", "torque", "between trials", "within a trial"],
)
def test_the_place_is_found_and_fitted(hidden: Effect, place: float | None) -> None:
    baseline = null_fit(hidden, library=(*FEW, *PLACED))
    name = hidden.name()
    found = try_effect(baseline.problem, baseline.current, name).fit
    assert adjusted_p(baseline.current, found, 33) < 1e-6
    values = {a.field: a.value(x) for a, x in zip(found.parameters, found.vector.scaled_values, strict=True)}
    for field, value in values.items():
        true = getattr(hidden, field)
        if field == "order":
            assert value == place
        elif field == "at_s":
            assert value == pytest.approx(true, abs=0.05)
        else:
            assert value == pytest.approx(true, abs=0.1 * abs(true))


def test_without_any_no_place_is_worth_a_fit() -> None:
    baseline = null_fit(library=(*FEW, *PLACED))
    for name in PLACED:
        ahead = look_through(baseline.problem, baseline.current, name)
        assert (ahead.gain, ahead.starts) == (0.0, ())
        assert 0.0 < ahead.error < np.inf


@pytest.mark.parametrize(("chances", "times"), [(1, 1.0), (60, 60.0)])
def test_the_best_of_many_places_has_as_many_chances(chances: int, times: float) -> None:
    baseline = null_fit(library=(*FEW, *PLACED))
    parent, (sine, cosine, order) = baseline.current, baseline.problem.parameters(["torque_ripple"])
    order = dataclasses.replace(order, places=tuple((float(n),) for n in range(chances)))
    child: Any = SimpleNamespace(
        parameters=(sine, cosine, order), objective=parent.objective - 40.0, scatter=parent.scatter, rank=2
    )
    assert adjusted_p(parent, child, 1) == pytest.approx(times * np.exp(-20.0), rel=1e-3)
    single: Any = SimpleNamespace(**{**vars(child), "parameters": (sine, cosine)})
    paid = score(baseline.problem, child) - score(baseline.problem, single)
    assert paid == pytest.approx(2.0 * np.log(chances))


def test_trials_that_an_event_leaves_alone_are_not_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    baseline = null_fit(library=PLACED)
    problem, current = baseline.problem, baseline.current
    solved: list[int] = []

    def counted(rod: Any, paths: Any, *given: Any, **named: Any) -> Any:
        solved.append(len(paths))
        return solve_series(rod, paths, *given, **named)

    problem.predict(current.parameters, current.vector)
    monkeypatch.setattr(simulator, "solve_series", counted)
    added = problem.parameters(["coupling_slip"])
    for event, new in ((slipped(3), []), (slipped(2, 1.13), [1])):
        values = np.array([1.0, added[1].scaled_value(event.at_s)])  # type: ignore[attr-defined]
        assert signature(problem, current, added, values) is not None
        assert solved == new
        solved.clear()


def test_an_uneven_drive_is_sketched_to_a_quarter_without_a_solution(monkeypatch: pytest.MonkeyPatch) -> None:
    """Against the solver, the turning points alone are half of it; a slip is solved."""
    baseline = null_fit(library=PLACED)
    problem, current = baseline.problem, baseline.current
    before = problem.predict(current.parameters, current.vector)
    solved: list[int] = []

    def counted(rod: Any, paths: Any, *given: Any, **named: Any) -> Any:
        solved.append(len(paths))
        return solve_series(rod, paths, *given, **named)

    monkeypatch.setattr(simulator, "solve_series", counted)

    def vector(name: str, *scaled_values: float) -> ParameterVector:
        return dataclasses.replace(current.vector, scaled_values=np.array(scaled_values))

    for name, scaled_values in (("transmission_error", (0.1, 0.0, 1.0)), ("coupling_slip", (0.5, 0.0, 0.0))):
        added = problem.parameters([name])
        at = vector(name, *scaled_values[: len(added)])
        if name == "coupling_slip":
            at.scaled_values[1] = added[1].scaled_value(slipped(2, 1.13).at_s)  # type: ignore[attr-defined]
        solved.clear()
        sketched = problem.sketched(current.parameters, current.vector, added, [at])
        assert solved == [1] * (name == "coupling_slip")
        exact = problem.predict(added, at)
        change = np.concatenate([(e - b).ravel() for e, b in zip(exact, before, strict=True)])
        missed = np.concatenate([(s[:, :, 0] - e).ravel() for s, e in zip(sketched, exact, strict=True)])
        assert np.linalg.norm(change) > 0.0
        assert np.linalg.norm(missed) < 0.25 * np.linalg.norm(change)


@pytest.mark.whole
@pytest.mark.timeout(120)
@pytest.mark.parametrize("hidden", [GEARED, slipped(3)], ids=["gear", "slip"])
def test_it_is_named_beside_what_looks_like_it(hidden: Effect) -> None:
    library = few(*FEW, *PLACED, "encoder_eccentricity")
    found = diagnose(dataset(hidden), library)
    assert (found.verdict, found.effects) == ("effect", (hidden.name(),))
    assert not found.ranking[0].indistinguishable_from
