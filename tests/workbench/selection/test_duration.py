"""How long a diagnosis takes is told at the beginning, and again where what was found is slow to solve."""

from __future__ import annotations

from typing import Any

import pytest

from needle_rig.physics.solver import solve_batch
from needle_rig.workbench.estimation import baseline as baseline_module
from needle_rig.workbench.estimation import simulator
from needle_rig.workbench.estimation.baseline import FirstFit, fit_baseline
from needle_rig.workbench.estimation.problem import Problem
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.duration import Duration, Slowest, expected, slowest
from needle_rig.workbench.selection.search import search
from tests.workbench.hidden import dataset, effect, few, null_fit


@pytest.mark.parametrize(
    ("solution_s", "processes", "told"),
    [
        (0.0028, 1, "some 6 to 25 s"),
        (0.00001, 2, "some 1 to 2 s"),
        (0.0132, 2, "some 13 to 59 s"),
        (0.0134, 2, "some 13 to 60 s (quick: some 3 to 21 s, for one effect alone)"),
        (0.18, 2, "some 3.0 to 14 min (quick: some 36 s to 5 min, for one effect alone)"),
    ],
)
def test_how_long_it_will_take_is_told_at_the_beginning(solution_s: float, processes: int, told: str) -> None:
    assert expected((solution_s, solution_s), processes) == told
    assert "quick" not in expected((solution_s, solution_s), processes, quick=True)


def test_the_slowest_effect_is_told_with_what_it_takes() -> None:
    """Friction that ages is solved in many steps a sample: minutes for a search of seconds."""
    slow = Slowest("stiction_ageing", 0.112)
    told = expected((0.0028, 0.0028), 1, slow=slow)
    assert told == (
        "some 6 to 25 s, up to 17 min if stiction_ageing is missing"
        " (quick: some 1 to 9 s, up to 6 min, for one effect alone)"
    )
    assert "quick" not in expected((0.0001, 0.0001), 1, slow=Slowest("stiction_ageing", 0.004))
    # where every sample drives it, the model without takes as long
    assert "stiction_ageing" not in expected((0.0028, 0.06), 1, slow=slow)


def test_the_slowest_effect_is_found_before_anything_is_fitted() -> None:
    at: list[FirstFit] = []
    fit_baseline(dataset(), None, few("torque_bias", "stiction_ageing", "tip_friction"), beginning=at.append)
    found = slowest(at[0].problem, at[0].parameters, at[0].vector, 0.5)
    assert found is not None
    assert found.effect == "stiction_ageing"
    assert found.solution_s > 2.5
    told = Duration(1, quick=False).at_first(at[0])
    assert " if stiction_ageing is missing" in told


def test_no_effect_is_told_where_all_are_as_fast() -> None:
    at: list[FirstFit] = []
    fit_baseline(dataset(), None, few("torque_bias"), beginning=at.append)
    assert slowest(at[0].problem, at[0].parameters, at[0].vector, 0.5) is None


def test_it_is_told_before_anything_is_fitted(monkeypatch: pytest.MonkeyPatch) -> None:
    class Told(Exception):
        pass

    def fitted(*_: object) -> None:
        raise Told

    said: list[str] = []
    monkeypatch.setattr(baseline_module, "fit", fitted)
    with pytest.raises(Told):
        diagnose(dataset(), few(), say=said.append)
    assert said[-1].startswith("fitting the current model, trying every effect, some ")


def test_it_is_told_between_both_kinds_of_solution() -> None:
    assert expected((0.015, 0.18), 2, quick=True) == "some 3 s to 5 min"


@pytest.mark.parametrize(("times", "told"), [(1.9, 0), (5.0, 1)])
def test_what_is_slow_to_solve_is_told_once(monkeypatch: pytest.MonkeyPatch, times: float, told: int) -> None:
    hidden = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)
    baseline = null_fit(hidden)
    monkeypatch.setattr(Problem, "solution_s", lambda _, added, __: times if added else 1.0)
    said: list[str] = []
    fits = (baseline.problem, tuple(few()), baseline.current, baseline.validation)
    search(*fits, max_effects=3, work=Work(), say=said.append)
    assert len(said) == told
    assert all(
        s.startswith("a model with tissue_elasticity takes 5 times as long to solve: some ") for s in said
    )


def test_a_solution_that_is_kept_is_timed_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    baseline = null_fit()
    solved: list[int] = []

    def counted(rods: Any, *given: Any, **settings: Any) -> Any:
        solved.append(len(rods))
        return solve_batch(rods, *given, **settings)

    monkeypatch.setattr(simulator, "solve_batch", counted)
    problem, root = baseline.problem, baseline.current
    assert problem.solution_s(root.parameters, root.vector) > 0.0
    assert solved == [len(problem.trials)] * 3
