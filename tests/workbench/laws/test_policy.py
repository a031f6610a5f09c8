"""A row on either side of the thresholds of laws, and of what a law must do to be said."""

import dataclasses
import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from needle_rig.workbench.laws import law_search
from needle_rig.workbench.laws.fitting import Parent
from needle_rig.workbench.laws.law import Law
from needle_rig.workbench.laws.law_search import FoundLaw, asked_of, borne, changes_matter, kept, tied
from needle_rig.workbench.laws.learn_laws import Hypothesis, Term, _Learning, goes_on, reaches, verdict_of
from needle_rig.workbench.policy import POLICY

NO_PROBLEM: Any = SimpleNamespace(size=1000)


def fitted(score: Any, loss: Any = 0.0, error: Any = 1.0, law: Any = None) -> Any:
    validation = SimpleNamespace(loss=loss, error=error)
    found = SimpleNamespace(pull_rigidity=0.0)
    return SimpleNamespace(score=score, validation=validation, fit=found, law=law)


def parent(score: Any, loss: Any = 100.0, error: Any = 3.0) -> Any:
    made = fitted(score, loss, error)
    return Parent(made.fit, made.validation, score)


@pytest.fixture(autouse=True)
def large_and_not_ours(monkeypatch: Any) -> Any:
    monkeypatch.setattr(law_search, "within_discretisation_error", lambda *_: False)
    monkeypatch.setattr(law_search, "matters", lambda *_: True)


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
    before = parent(1000.0)
    assert kept(NO_PROBLEM, before, FoundLaw(fitted(score), None, before), 70) is is_kept


@pytest.mark.parametrize(("rival", "is_kept"), [(910.0, False), (930.0, True)])
def test_a_law_is_not_named_where_a_library_effect_does_as_well(rival: Any, is_kept: Any) -> None:
    before = parent(1000.0)
    found = FoundLaw(fitted(900.0), None, before)
    assert kept(NO_PROBLEM, parent(rival, loss=50.0), found, 70) is is_kept


def test_a_law_that_predicts_nothing_is_not_kept() -> None:
    before = parent(1000.0)
    assert not kept(NO_PROBLEM, before, FoundLaw(fitted(900.0, loss=101.0), None, before), 70)


@pytest.mark.parametrize(("fall", "is_kept"), [(0.0, False), (9.9, False), (10.1, True)])
def test_commands_left_out_tell_a_law_from_what_one_command_has(fall: Any, is_kept: Any) -> None:
    before = parent(1000.0)
    error = math.sqrt(before.validation.error**2 - fall / NO_PROBLEM.size)
    found = FoundLaw(fitted(900.0, loss=50.0, error=error), None, before)
    assert kept(NO_PROBLEM, before, found, 70) is is_kept


def test_a_law_that_cannot_be_solved_without_a_command_is_kept_until_more_is_found() -> None:
    before = parent(1000.0)
    found = FoundLaw(fitted(900.0, loss=math.inf, error=math.inf), None, before)
    assert kept(NO_PROBLEM, before, found, 70)
    assert not kept(NO_PROBLEM, parent(905.0), found, 70)


def test_a_law_that_predicts_less_than_the_library_is_not_kept() -> None:
    before = parent(1000.0)
    found = FoundLaw(fitted(900.0, loss=60.0), None, before)
    assert not kept(NO_PROBLEM, parent(960.0, loss=50.0), found, 70)


@pytest.mark.parametrize("which", ["within_discretisation_error", "matters"])
def test_what_may_be_our_own_error_or_is_too_small_is_no_law(which: Any, monkeypatch: Any) -> None:
    before = parent(1000.0)
    found = FoundLaw(fitted(900.0), None, before)
    assert kept(NO_PROBLEM, before, found, 70)
    monkeypatch.setattr(law_search, which, lambda *_: which == "within_discretisation_error")
    assert not kept(NO_PROBLEM, before, found, 70)


def test_laws_within_ten_of_the_first_tie_with_it() -> None:
    before = parent(1000.0)
    laws = (Law("observe", "torque", v) for v in ("torque", "rate", "travel"))
    first, near, far = (
        FoundLaw(fitted(s, law=law), None, before) for s, law in zip((100.0, 109.9, 110.1), laws, strict=True)
    )
    assert tied(first.law, first.score, (near, far)) == (near,)
    assert tied(first.law, first.score, ()) == ()


def test_kinds_of_one_law_that_are_told_alike_are_one() -> None:
    before = parent(1000.0)
    gain = Law("observe", "torque", "clock", "gain")
    plays = [Law("observe", "hall_1", "angle", "play", width) for width in (2.0, 4.0)]
    laws = (gain, Law("observe", "torque", "clock"), *plays)
    first, same, other, again = (FoundLaw(fitted(100.0, law=law), None, before) for law in laws)
    assert tied(first.law, first.score, (same, other, again)) == (other,)


def test_the_formula_is_what_is_added_where_there_is_one() -> None:
    before = parent(1000.0)
    found = FoundLaw(fitted(100.0), None, before)
    assert found.best.score == 100.0
    assert dataclasses.replace(found, formula=fitted(90.0)).score == 90.0


def test_a_model_that_cannot_be_solved_with_commands_left_out_does_not_reach_the_noise() -> None:
    assert not reaches(math.inf, 6)
    assert reaches(math.inf, 1)
    assert reaches(POLICY.laws.reached, 6)
    assert not reaches(1.01 * POLICY.laws.reached, 6)


def learning(**asked: Any) -> _Learning:
    found = object.__new__(_Learning)
    problem = SimpleNamespace(groups=range(6))
    found.search = cast(Any, SimpleNamespace(problem=problem, say=lambda _: None, **asked))
    found.trace = cast(Any, SimpleNamespace(start=frozenset()))
    found.tried = 70
    return found


def term(score: float, name: str) -> Term:
    best = fitted(score)
    best.made, best.price = SimpleNamespace(name=name), 5.0
    return Term(FoundLaw(best, None, parent(200.0)), (), 3.0)


@pytest.mark.parametrize(
    ("behind", "left"),
    [(-5.0, ["other"]), (asked_of(70) - 0.1, ["other"]), (asked_of(70) + 0.1, ["damping", "other"])],
)
def test_a_law_that_an_effect_does_as_well_as_once_all_is_found_is_the_effect(
    behind: float, left: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A law is kept while another is missing, as damping was beside a gear's error."""
    terms = (term(100.0, "damping"), term(100.0, "other"))
    found = learning(
        without_law=lambda _, made, __: parent(500.0 if made.name == "damping" else 700.0),
        on_top_of=lambda *_: [],
        promises=lambda _: [],
    )
    # the first alone has a rival near it
    near = parent(100.0 + behind)
    monkeypatch.setattr(found, "_with_effect", lambda rest, _: near if rest.score == 500.0 else None)
    monkeypatch.setattr(found, "_looked_for_again", lambda at, *_: at)
    at = found._swapped(Hypothesis(parent(100.0)), Hypothesis(parent(100.0), terms))
    assert [each.made.name for each in at.terms] == left
    assert at.fitted.score == (100.0 if len(left) == 2 else 100.0 + behind)


def test_two_effects_of_the_library_may_stand_in_the_place_of_a_law(monkeypatch: pytest.MonkeyPatch) -> None:
    found, steps = learning(), iter((parent(600.0), parent(95.0)))
    monkeypatch.setattr(found, "_with_effect", lambda *_: next(steps))
    library = found._library_in_place(parent(1000.0), parent(100.0))
    assert library is not None
    assert library.score == 95.0


@pytest.mark.parametrize(
    ("score", "error", "left"),
    [(109.9, 1.0, False), (110.1, 1.0, True), (109.9, 2.0, True)],
)
def test_an_effect_to_which_a_law_leaves_nothing_is_dropped(score: float, error: float, left: bool) -> None:
    found = learning(without_effect=lambda *_: parent(score, error=error))
    at = parent(100.0, error=1.0)
    at.fit.effects = ("drag", "damping")
    dropped = found._dropped(Hypothesis(at, (term(100.0, "damping"),)))
    assert (dropped.fitted is at) is left


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
