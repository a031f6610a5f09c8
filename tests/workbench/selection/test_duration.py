"""How long a diagnosis takes is told from the first fit, and again where what was found is slow to solve."""

from __future__ import annotations

import pytest

from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.selection import duration
from needle_rig.workbench.selection.duration import _solution_s, expected
from needle_rig.workbench.selection.search import search
from tests.workbench.hidden import dataset, effect, few, try_effect


@pytest.mark.parametrize(
    ("fit_s", "processes", "told"),
    [
        (0.5, 2, "some 2 to 12 s"),
        (0.01, 2, "some 1 to 2 s"),
        (2.39, 2, "some 10 to 60 s"),
        (2.41, 2, "some 10 to 60 s (--quick: some 6 to 24 s, for one effect alone)"),
        (9.0, 2, "some 0.6 to 4 min (--quick: some 22 to 90 s, for one effect alone)"),
    ],
)
def test_how_long_it_will_take_is_told_after_the_first_fit(fit_s: float, processes: int, told: str) -> None:
    assert expected(fit_s, processes) == told
    assert "--quick" not in expected(fit_s, processes, quick=True)


@pytest.mark.parametrize(("times", "told"), [(1.9, 0), (5.0, 1)])
def test_what_is_slow_to_solve_is_told_once(monkeypatch: pytest.MonkeyPatch, times: float, told: int) -> None:
    hidden = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)
    baseline = fit_baseline(dataset(hidden), None, few())
    monkeypatch.setattr(duration, "_solution_s", lambda _, found: times if found.effects else 1.0)
    said: list[str] = []
    fits = (baseline.problem, tuple(few()), baseline.current, baseline.validation)
    search(*fits, max_effects=3, work=Work(), say=said.append)
    assert len(said) == told
    assert all(
        s.startswith("a model with tissue_elasticity takes 5 times as long to solve: some ") for s in said
    )


def test_a_solution_that_is_kept_is_timed_anew() -> None:
    hidden = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)
    baseline = fit_baseline(dataset(hidden), None, few())
    stiff = try_effect(baseline.problem, baseline.current, "tissue_elasticity").fit
    times = sorted(
        _solution_s(baseline.problem, stiff) / _solution_s(baseline.problem, baseline.current)
        for _ in range(5)
    )
    assert 0.5 < times[2] < 2.0
