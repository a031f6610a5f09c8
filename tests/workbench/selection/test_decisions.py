import dataclasses

import numpy as np
import pytest

from needle_rig.workbench.selection.decisions import decide, decision_at, may_snap
from needle_rig.workbench.selection.search import SearchTrace
from tests.workbench.hidden import diagnosed


def test_a_limit_of_what_is_not_there_is_no_finer_than_the_derivatives_step() -> None:
    """Next to stick-slip a step from 0 moves slips: errors of what was fitted there come out as good as 0."""
    search = diagnosed(seed=24, library=("tissue_elasticity", "torque_bias")).search
    candidates = {c.effect: c for c in search.children[search.best]}
    fit = candidates["tissue_elasticity"].fit
    assert fit is not None
    covariance = fit.covariance.copy()
    covariance[2:, 2:] = 1e-10
    at_off = dataclasses.replace(fit.vector, scaled_values=np.zeros(1))
    sure = dataclasses.replace(fit, covariance=covariance, vector=at_off, objective=search.root.objective)
    on_top = tuple(
        dataclasses.replace(c, fit=sure) if c.effect == "tissue_elasticity" else c
        for c in search.children[search.best]
    )
    search = dataclasses.replace(search, children={search.best: on_top})
    decision = decide(search, [], 1.0)["tissue_elasticity"]
    assert decision.decision == "absent"
    assert decision.limit is not None
    assert np.isfinite(decision.limit)


@pytest.fixture(scope="module")
def nothing_found() -> SearchTrace:
    return diagnosed(seed=24, library=("tissue_elasticity", "torque_bias")).search


def test_a_limit_stiffer_than_its_file_allows_is_the_stiffest_allowed(nothing_found: SearchTrace) -> None:
    (stiffness,) = nothing_found.problem.parameters(["tissue_elasticity"])
    decision = decision_at("tissue_elasticity", stiffness, 1e-4, "absent", 0.0)
    assert decision.sentence() == "tissue_elasticity (> 2e+02 N·mm/rad per 100 mm)"
    assert decision_at("tissue_elasticity", stiffness, 0.005, "absent", 0.0).limit == pytest.approx(70.0)


@pytest.mark.parametrize(("error", "told"), [(1.27, True), (np.inf, True), (1.33, False)])
def test_nothing_is_absent_or_has_a_limit_while_commands_left_out_are_missed(
    nothing_found: SearchTrace, error: float, told: bool
) -> None:
    decisions = decide(nothing_found, [], error).values()
    assert any(d.decision in ("absent", "negligible") for d in decisions) is told
    assert all(d.limit is not None for d in decisions) is told


def test_what_is_present_stays_so_while_commands_left_out_are_missed(nothing_found: SearchTrace) -> None:
    key = frozenset(["torque_bias"])
    search = dataclasses.replace(nothing_found, best=key)
    decisions = decide(search, ["torque_bias"], 1.13)
    assert decisions["torque_bias"].decision == "present"
    assert decisions["torque_bias"].limit is not None
    assert decisions["tissue_elasticity"].decision == "cannot_tell"


def test_of_friction_that_may_let_the_needle_snap_no_size_is_ruled_out() -> None:
    """Another code's needle whose excess of 0.25 is lost within no slip was fitted by 0.02 over 1.9°."""
    found = diagnosed(seed=24, library=("stribeck", "torque_bias"))
    assert found.verdict == "none"
    assert found.decisions["torque_bias"].decision == "absent"
    told = found.decisions["stribeck"]
    assert (told.decision, told.limit) == ("cannot_tell", None)
    search = found.search
    assert not may_snap(search.problem, search.root, "torque_bias")
