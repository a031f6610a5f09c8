"""Effects held against each other from the unknown starts that each finds itself."""

import dataclasses
import functools
import math
from collections.abc import Iterator
from typing import Any

import pytest

from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection import unknown_starts
from needle_rig.workbench.selection.diagnose import Diagnosis
from needle_rig.workbench.selection.rivals import find_rivals
from needle_rig.workbench.selection.unknown_starts import FoundStarts, Holder
from tests.workbench.hidden import dataset, diagnosed, effect

NAMED, LIKE, UNLIKE = "tip_friction", "platform_friction", "hall_offset"
ERROR, CLOSE = 0.9, 10.0


@functools.cache
def friction_at_the_tip() -> Diagnosis:
    found = diagnosed(effect(NAMED, torque_nmm=0.03), library=(NAMED, LIKE, UNLIKE))
    assert found.effects == (NAMED,)
    return found


def holder(names: tuple[str, ...], behind: float) -> Holder:
    """With an error by so much of −2 log predictive density over `ERROR`."""
    found = friction_at_the_tip()
    fit, values = found.search.fits[frozenset(names)][0], found.search.problem.size
    return Holder(fit.vector, fit, ERROR * math.exp(behind / (2.0 * values)))


def starts(owner: str, behind: dict[str, float], least: float = 1000.0) -> FoundStarts:
    found = friction_at_the_tip()
    holders = {name: holder((name,), behind.get(name, 0.0)) for name in (NAMED, LIKE, UNLIKE)}
    own = holders[owner].fit
    return FoundStarts(found.search.problem, found.baseline, own, holders, holder((NAMED,), least).error)


def tied(given: FoundStarts) -> set[str]:
    rivals = find_rivals(friction_at_the_tip().search, Work(), 0, given)[1][NAMED]
    assert all(r.held is given.holders[r.effect] for r in rivals if r.tied)
    return {r.effect for r in rivals if r.tied}


def test_what_predicts_as_well_from_its_own_starts_is_a_rival() -> None:
    far = {LIKE: 1.1 * CLOSE, UNLIKE: 1.1 * CLOSE}
    assert tied(starts(NAMED, far)) == set()
    assert tied(starts(NAMED, far | {LIKE: 0.9 * CLOSE})) == {LIKE}
    assert tied(starts(NAMED, {})) == {LIKE, UNLIKE}


def test_what_predicts_no_more_than_the_current_model_is_no_rival() -> None:
    assert tied(starts(NAMED, {}, least=0.9 * CLOSE)) == set()


def test_starts_of_another_effect_tell_nothing_of_rivals() -> None:
    assert tied(starts(LIKE, {})) == set()


@pytest.mark.parametrize(
    ("together", "simpler"), [(-0.9 * CLOSE, LIKE), (-1.1 * CLOSE, None), (CLOSE, LIKE), (None, LIKE)]
)
def test_a_second_effect_must_predict_more_from_the_starts_of_both(
    monkeypatch: pytest.MonkeyPatch, together: float | None, simpler: str | None
) -> None:
    def held(_: Any, names: tuple[str, ...], *__: Any) -> Holder | None:
        assert set(names) == {NAMED, LIKE}
        if together is None:
            return None
        return dataclasses.replace(holder((NAMED,), together), fit=both)

    search = friction_at_the_tip().search
    key = frozenset({NAMED, LIKE})
    both = search.fits[key][0]
    monkeypatch.setattr(unknown_starts, "held", held)
    monkeypatch.setattr(type(search), "named", lambda self, key: sorted(key))
    found = starts(NAMED, {NAMED: 1.0}).simpler(dataset(), dataclasses.replace(search, best=key))
    assert (found.fit.effects if found else None) == (simpler and (simpler,))


def test_one_effect_from_the_starts_of_another_is_asked_for_its_own() -> None:
    search = friction_at_the_tip().search
    given = starts(LIKE, {})
    assert given.simpler(dataset(), search) is given.holders[NAMED]
    assert starts(NAMED, {}).simpler(dataset(), search) is None


@pytest.mark.parametrize(
    ("errors", "kept"),
    [
        ((0.97, 0.949, 0.985, 0.9237, 0.9229, 0.9229, 0.8), 0.9229),
        ((0.975, 1.013, 1.027, 1.027, 0.8), 1.027),
        ((0.92, 0.9207, 0.9207, 0.8), 0.9207),
        ((0.98, 0.8), 0.98),
        ((0.97, 0.93, 0.97, 0.93, 0.97, 0.93, 0.97, 0.92, 0.8), 0.92),
    ],
    ids=["falls late", "holds a worse one", "a change that matters", "not below", "never holds"],
)
def test_starts_and_fit_are_found_in_turn_until_they_hold_each_other(
    monkeypatch: pytest.MonkeyPatch, errors: tuple[float, ...], kept: float
) -> None:
    found, left = rounds_that_leave(errors, monkeypatch)
    shared = (found.baseline.dataset, found.baseline.problem)
    held = unknown_starts.held(shared, (), found.search.root.vector, 0.976)
    assert held is not None
    assert held.error == kept
    assert next(left) == 0.8


def rounds_that_leave(
    errors: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> tuple[Diagnosis, Iterator[float]]:
    """A diagnosis with its data, and the errors of rounds to come in which starts are found."""
    left = iter(errors)
    found = friction_at_the_tip()
    monkeypatch.setattr(unknown_starts, "judged", lambda data, _: data)
    monkeypatch.setattr(unknown_starts, "cross_validate", lambda *_: found.search.root_validation)
    monkeypatch.setattr(unknown_starts, "over_strength", lambda *_: found.search.root)
    monkeypatch.setattr(unknown_starts, "_error", lambda *_: next(left))
    return found, left
