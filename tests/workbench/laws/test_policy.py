"""A row on either side of the thresholds of laws, and of what a law must do to be said."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from needle_rig.workbench.laws import learn_laws as room
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.law_search import FoundLaw, borne, tied
from needle_rig.workbench.laws.learn_laws import (
    Term,
    _Learning,
    best_of_library,
    goes_on,
    laws_in,
    reaches,
    verdict_of,
)
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection import search
from needle_rig.workbench.selection.evidence import asked_of, changes_matter
from needle_rig.workbench.selection.search import SearchTrace, back

NO_PROBLEM: Any = SimpleNamespace(size=1000, trials=range(8), groups=range(6))
START: frozenset[str] = frozenset()


def fitted(score: Any, loss: Any = 0.0, error: Any = 1.0, law: Any = None) -> Any:
    validation = SimpleNamespace(loss=loss, error=error)
    return SimpleNamespace(score=score, validation=validation, fit=None, law=law)


def fit_at(score: float, *effects: str) -> Any:
    """A fit of so high a score; its numbers count for nothing."""
    vector = SimpleNamespace(trial_friction=np.zeros(8))
    return SimpleNamespace(
        objective=score,
        effects=effects,
        rank=0,
        parameters=(),
        vector=vector,
        scatter=0.02,
        scatter_dof=12.0,
    )


def trace_of(*sets: tuple[tuple[str, ...], float, float, float], best: tuple[str, ...] = ()) -> SearchTrace:
    """A search with sets of effects of these scores, losses and errors left out; `law…` are laws."""
    fits = {
        frozenset(names): (fit_at(score, *names), cast(Any, SimpleNamespace(loss=loss, error=error)))
        for names, score, loss, error in sets
    }
    root, validation = fits[START]
    laws = {name: 0.0 for names, *_ in sets for name in names if name.startswith("law")}
    return SearchTrace(
        NO_PROBLEM,
        ("damping", "drag", *(f"other_{k}" for k in range(28))),
        root,
        validation,
        frozenset(best),
        fits,
        {},
        {},
        laws=laws,
        laws_tried=70,
    )


BEFORE = ((), 1000.0, 100.0, 3.0)


def is_law(score: float, loss: float = 0.0, error: float = 1.0) -> bool:
    """Whether a law of this score on top of the present model passes."""
    return trace_of(BEFORE, (("law",), score, loss, error)).passes(START, frozenset({"law"}))


@pytest.fixture(autouse=True)
def large_and_not_ours(monkeypatch: Any) -> Any:
    monkeypatch.setattr(search, "within_discretisation_error", lambda *_: False)
    monkeypatch.setattr(search, "matters", lambda *_: True)


@pytest.mark.parametrize(("formula", "said"), [(99.9, True), (100.0, True), (100.1, False)])
def test_a_formula_is_said_where_it_costs_no_more_than_its_spline(formula: Any, said: Any) -> None:
    assert (borne(fitted(formula), fitted(100.0)) is not None) is said


def test_no_formula_at_all_is_none() -> None:
    assert borne(None, fitted(100.0)) is None


@pytest.mark.parametrize(
    ("reached", "tied_with", "verdict"),
    [(True, 0, "law"), (True, 1, "law"), (True, 2, "cannot_tell"), (False, 0, "cannot_tell")],
)
def test_a_law_is_said_in_a_tie_of_two_at_most_and_where_the_noise_is_reached(
    reached: Any, tied_with: Any, verdict: Any
) -> None:
    assert verdict_of(reached, tied_with) == verdict


@pytest.mark.parametrize(
    ("found", "reached", "on"), [(0, False, True), (1, False, True), (2, False, False), (1, True, False)]
)
def test_two_laws_are_looked_for_as_long_as_something_is_left(found: Any, reached: Any, on: Any) -> None:
    assert goes_on(found, reached) is on


def test_the_price_grows_with_the_number_of_laws_that_were_tried() -> None:
    assert asked_of(1) == pytest.approx(10.0)
    assert asked_of(70) == pytest.approx(10.0 + 2.0 * np.log(70.0))


@pytest.mark.parametrize(("score", "is_kept"), [(1000.0 - 18.4, False), (1000.0 - 18.6, True)])
def test_a_law_must_beat_its_parent_by_what_is_asked(score: Any, is_kept: Any) -> None:
    assert is_law(score) is is_kept


def test_what_the_freedom_of_a_curve_costs_counts_in_its_score() -> None:
    trace = trace_of(BEFORE, (("law",), 975.0, 0.0, 1.0))
    law = frozenset({"law"})
    assert trace.passes(START, law)
    assert not dataclasses.replace(trace, laws={"law": 10.0}).passes(START, law)


@pytest.mark.parametrize(("rival", "is_kept"), [(910.0, False), (930.0, True)])
def test_a_law_is_not_named_where_a_library_effect_does_as_well(rival: Any, is_kept: Any) -> None:
    trace = trace_of(BEFORE, (("law",), 900.0, 0.0, 1.0), (("drag",), rival, 50.0, 1.5))
    assert trace.beats(frozenset({"drag"}), frozenset({"law"})) is is_kept


def test_a_law_that_predicts_nothing_is_not_kept() -> None:
    assert is_law(900.0, loss=99.0)
    assert not is_law(900.0, loss=101.0)


@pytest.mark.parametrize(("fall", "is_kept"), [(0.0, False), (9.9, False), (10.1, True)])
def test_commands_left_out_tell_a_law_from_what_one_command_has(fall: Any, is_kept: Any) -> None:
    assert is_law(900.0, 50.0, math.sqrt(9.0 - fall / NO_PROBLEM.size)) is is_kept


def test_a_law_that_cannot_be_solved_without_a_command_is_kept_until_more_is_found() -> None:
    assert is_law(900.0, math.inf, math.inf)
    trace = trace_of(BEFORE, (("law",), 900.0, math.inf, math.inf), (("drag",), 905.0, 50.0, 1.5))
    assert not trace.beats(frozenset({"drag"}), frozenset({"law"}))


def test_a_law_that_predicts_less_than_the_library_is_not_kept() -> None:
    trace = trace_of(BEFORE, (("law",), 900.0, 60.0, 1.0), (("drag",), 960.0, 50.0, 1.5))
    assert not trace.beats(frozenset({"drag"}), frozenset({"law"}))


@pytest.mark.parametrize("which", ["within_discretisation_error", "matters"])
def test_what_may_be_our_own_error_or_is_too_small_is_no_law(which: Any, monkeypatch: Any) -> None:
    assert is_law(900.0)
    monkeypatch.setattr(search, which, lambda *_: which == "within_discretisation_error")
    assert not is_law(900.0)


def test_laws_within_ten_of_the_first_tie_with_it() -> None:
    before: Any = None
    laws = (Law("observe", "torque", v) for v in ("torque", "rate", "travel"))
    first, near, far = (
        FoundLaw(fitted(s, law=law), None, before) for s, law in zip((100.0, 109.9, 110.1), laws, strict=True)
    )
    assert tied(first.law, first.score, (near, far)) == (near,)
    assert tied(first.law, first.score, ()) == ()


def test_kinds_of_one_law_that_are_told_alike_are_one() -> None:
    before: Any = None
    gain = Law("observe", "torque", "clock", "gain")
    plays = [Law("observe", "hall_1", "angle", "play", width) for width in (2.0, 4.0)]
    laws = (gain, Law("observe", "torque", "clock"), *plays)
    first, same, other, again = (FoundLaw(fitted(100.0, law=law), None, before) for law in laws)
    assert tied(first.law, first.score, (same, other, again)) == (other,)


def test_the_formula_is_what_is_added_where_there_is_one() -> None:
    before: Any = None
    found = FoundLaw(fitted(100.0), None, before)
    assert found.best.score == 100.0
    assert dataclasses.replace(found, formula=fitted(90.0)).score == 90.0


def test_a_model_that_cannot_be_solved_with_commands_left_out_does_not_reach_the_noise() -> None:
    assert not reaches(math.inf, 6)
    assert reaches(math.inf, 1)
    assert reaches(POLICY.laws.reached, 6)
    assert not reaches(1.01 * POLICY.laws.reached, 6)


def learning(monkeypatch: pytest.MonkeyPatch, on_rest: Any) -> _Learning:
    """Of two laws, each on top of nothing; what the library does there stands in the search already."""
    found = object.__new__(_Learning)
    found.say = lambda _: None
    found.work = cast(Any, SimpleNamespace(share=lambda _: None))
    of: Any = None
    laws = {"law_1": Law("observe", "torque", "torque"), "law_2": Law("observe", "torque", "rate")}
    found.terms = {
        name: Term(FoundLaw(fitted(100.0, law=law), None, of), (), 3.0) for name, law in laws.items()
    }
    monkeypatch.setattr(room, "without_law", lambda _, now, name: fit_at(800.0, *(set(now.effects) - {name})))
    monkeypatch.setattr(room, "expand", on_rest)
    monkeypatch.setattr(found, "_looked_for_again", lambda trace, *_: trace)
    return found


def with_children(trace: SearchTrace, key: frozenset[str], *more: tuple[str, float]) -> SearchTrace:
    """The search with effects of the library, each of its score, tried on top of a set."""
    left_out = {score: cast(Any, SimpleNamespace(loss=score / 20.0, error=1.0)) for _, score in more}
    fits = {key | {name}: (fit_at(score, *key, name), left_out[score]) for name, score in more}
    children = {**trace.children, key: tuple(cast(Any, SimpleNamespace(effect=name)) for name, _ in more)}
    return dataclasses.replace(trace, fits={**trace.fits, **fits}, children=children)


BOTH = (BEFORE, (("law_1", "law_2"), 100.0, 0.0, 1.0))


@pytest.mark.parametrize(
    ("behind", "left"),
    [
        (-5.0, {"damping", "law_2"}),
        (asked_of(70) - 0.1, {"damping", "law_2"}),
        (asked_of(70) + 0.1, {"law_1", "law_2"}),
    ],
)
def test_a_law_that_an_effect_does_as_well_as_once_all_is_found_is_the_effect(
    behind: float, left: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A law is kept while another is missing, as damping was beside a gear's error."""

    def on_rest(trace: SearchTrace, _: Any, key: frozenset[str], *__: Any) -> SearchTrace:
        # the first alone has a rival near it
        near = [("damping", 100.0 + behind)] if key == {"law_2"} else []
        return with_children(trace, key, *near)

    found = learning(monkeypatch, on_rest)
    trace = trace_of(*BOTH, best=("law_1", "law_2"))
    after = found._swapped(frozenset(), trace)
    assert after.best == left
    # what a law was taken out of is no fit
    assert frozenset({"law_2"}) not in after.fits


def test_two_effects_of_the_library_may_stand_in_the_place_of_a_law(monkeypatch: pytest.MonkeyPatch) -> None:
    steps = {frozenset({"law_2"}): ("drag", 600.0), frozenset({"law_2", "drag"}): ("damping", 95.0)}

    def on_rest(trace: SearchTrace, _: Any, key: frozenset[str], *__: Any) -> SearchTrace:
        return with_children(trace, key, steps[key])

    found = learning(monkeypatch, on_rest)
    trace = trace_of(*BOTH, (("law_2",), 800.0, math.inf, math.inf), best=("law_1", "law_2"))
    library = found._library_in_place(trace, frozenset({"law_2"}))
    assert library is not None
    assert library.best == {"law_2", "drag", "damping"}
    assert laws_in(library) == ["law_2"]


def test_the_best_of_the_library_passes_on_its_own() -> None:
    trace = with_children(trace_of(BEFORE), START, ("drag", 999.0), ("damping", 900.0))
    assert best_of_library(trace, START) == frozenset({"damping"})
    assert best_of_library(with_children(trace_of(BEFORE), START, ("drag", 999.0)), START) is None


@pytest.mark.parametrize(("score", "left"), [(109.0, False), (150.0, True)])
def test_an_effect_to_which_a_law_leaves_nothing_is_dropped(score: float, left: bool) -> None:
    trace = trace_of(
        BEFORE,
        (("drag",), 500.0, 50.0, 1.5),
        (("law",), score, 5.0, 1.0),
        (("drag", "law"), 100.0, 0.0, 1.0),
        best=("drag", "law"),
    )
    assert (back(trace, cast(Any, None)).best == {"drag", "law"}) is left


def readings(row: int, largest: float, rms: float) -> Any:
    """Changes of a torque (N·m) and two angles (rad) in a trial of 100 bins, in one row alone."""
    change = np.zeros((3, 100))
    change[row] = np.sqrt(np.maximum(100.0 * rms**2 - largest**2, 0.0) / 99.0)
    change[row, 7] = -largest
    return change


@pytest.mark.parametrize(
    ("row", "unit", "most", "rms"),
    [
        (0, 1e-3, POLICY.size.largest_nmm, POLICY.size.rms_nmm),
        (2, np.radians(1.0), POLICY.size.largest_deg, POLICY.size.rms_deg),
    ],
)
def test_a_change_counts_at_once_or_over_one_trial(row: int, unit: float, most: float, rms: float) -> None:
    small, nothing = readings(row, 0.99 * most * unit, 0.99 * rms * unit), np.zeros((3, 40))
    assert not changes_matter([nothing, small], 1.0)
    assert changes_matter([nothing, readings(row, 1.01 * most * unit, 0.5 * rms * unit)], 1.0)
    assert changes_matter([nothing, readings(row, 0.99 * most * unit, 1.01 * rms * unit)], 1.0)
    # a shaft of larger torques has larger ones that do not count; an angle is an angle
    assert changes_matter([readings(row, 1.01 * most * unit, 0.5 * rms * unit)], 10.0) is (row == 2)
    # what is not measured does not count
    unseen = small.copy()
    unseen[1] = np.nan
    assert not changes_matter([unseen], 1.0)
