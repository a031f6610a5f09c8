"""A search: its fits stand for one problem, what is dropped is compared, how long it takes is told."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from needle_rig.physics.library import find_effects
from needle_rig.workbench.estimation.map_fit import fit
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.candidates import refit
from needle_rig.workbench.selection.search import (
    EffectSet,
    SearchTrace,
    back,
    expand,
    search,
    set_aside,
    that_matter,
)
from tests.workbench.hidden import null_fit

NAMES = ("chuck_backlash", "hall_offset", "tip_friction", "torque_bias")
HIDDEN = frozenset({"chuck_backlash"})


def begun_at(*effects: str) -> SearchTrace:
    """A search for backlash that begins at `effects`, however little these explain."""
    baseline = null_fit(find_effects()["chuck_backlash"].at_strength(1.0), library=NAMES)
    problem, current = baseline.problem, baseline.current
    sizes = np.zeros(len(problem.parameters(effects)))
    begin: Fit | None = fit(problem, effects, dataclasses.replace(current.vector, scaled_values=sizes))
    assert begin is not None
    return search(problem, NAMES, current, baseline.validation, max_effects=3, work=Work(), begin=begin)


def test_a_search_that_begins_at_another_effect_swaps_it() -> None:
    trace = begun_at("tip_friction")
    assert trace.best == HIDDEN
    assert [step.kind for step in trace.steps][-1] in ("swapped", "back")


def test_a_search_that_begins_at_too_much_drops_it() -> None:
    trace = begun_at("chuck_backlash", "torque_bias")
    assert trace.best == HIDDEN
    assert "back" in [step.kind for step in trace.steps]


def aside() -> SearchTrace:
    """A search that stands at backlash, once a torque bias too small to matter is set aside."""
    hidden = find_effects()["chuck_backlash"].at_strength(1.0)
    baseline = null_fit(hidden, library=NAMES)
    work = Work()
    work.share(baseline.problem)
    trace = SearchTrace.begin(baseline.problem, NAMES, baseline.current, baseline.validation)
    trace = expand(trace, work, trace.start)
    trace = expand(dataclasses.replace(trace, best=HIDDEN), work, HIDDEN)
    return set_aside(trace, work, HIDDEN | {"torque_bias"}, "torque_bias")


def test_an_effect_set_aside_is_a_nuisance_of_every_fit() -> None:
    trace = aside()
    directions = trace.problem.nuisance[0].shape[1]
    assert directions == 2  # of the discretisation error, and of the bias
    assert len(trace.fits) > 2
    for found, _ in trace.fits.values():
        assert found.nuisance.size == directions


def test_what_is_needed_is_not_dropped_for_a_fit_that_was_never_cross_validated() -> None:
    trace = aside()
    pair, three = HIDDEN | {"hall_offset"}, HIDDEN | {"hall_offset", "tip_friction"}
    assert trace.fits[pair][1] is None
    best, start = trace.fits[pair][0], trace.problem.parameters(sorted(three))
    vector = dataclasses.replace(
        best.vector,
        scaled_values=np.r_[best.vector.scaled_values, np.zeros(len(start) - best.vector.scaled_values.size)],
    )
    trace = trace.keep(*refit(trace.problem, ("chuck_backlash", "hall_offset", "tip_friction"), vector))
    work = Work()
    work.share(trace.problem)
    assert back(dataclasses.replace(trace, best=three), work).best == HIDDEN


SMALL, LARGE = frozenset({"small"}), frozenset({"large"})


@pytest.mark.parametrize(
    ("aside", "options", "left"),
    [
        (1, [SMALL, LARGE], [SMALL, LARGE]),  # the small one is set aside next
        (2, [SMALL, LARGE], [LARGE]),
        (2, [SMALL], [SMALL]),  # nothing large passes: the search ends there
    ],
)
def test_what_is_too_small_to_matter_does_not_end_a_search_in_which_something_large_passes(
    aside: int, options: list[EffectSet], left: list[EffectSet]
) -> None:
    def fit_of(name: str, size: float) -> Any:
        parameter = SimpleNamespace(effect=name, info=SimpleNamespace(shapes=False), smallest=1.0)
        return SimpleNamespace(parameters=[parameter], vector=SimpleNamespace(scaled_values=[size])), None

    trace: Any = SimpleNamespace(
        negligible=dict.fromkeys(range(aside)),
        best=frozenset(),
        fits={SMALL: fit_of("small", 0.5), LARGE: fit_of("large", 2.0)},
    )
    assert that_matter(trace, options) == left
