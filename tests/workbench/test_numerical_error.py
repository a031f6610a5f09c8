import dataclasses

import numpy as np
import pytest

from needle_rig.model import load_parameters
from needle_rig.workbench.claims import may_be_ours
from needle_rig.workbench.diagnose import diagnose
from needle_rig.workbench.fit import fit
from needle_rig.workbench.prepare import prepare, solver_error
from needle_rig.workbench.simulate import Noise, simulate_dataset
from tests.workbench.hidden import PROTOCOL, dataset, few


def test_our_own_error_is_a_direction_of_every_fit():
    data = dataset(seed=21)
    prepared = prepare(data, None, few())
    problem, found = prepared.problem, prepared.present
    error = np.concatenate([n[:, 0] for n in problem.nuisance])
    assert 0.05 < np.linalg.norm(error) < 10.0
    assert found.nuisance.shape == (1,)
    # data that hold this error twice over raise its coefficient, and no misfit
    shifted = []
    for b, w, n in zip(problem.trials, problem.whiteners, problem.nuisance, strict=True):
        mean = b.mean.copy()
        for c, (use, inverse) in enumerate(zip(w.use, w.inverse, strict=True)):
            mean[c, use] += 20.0 * np.linalg.solve(inverse, n[w.channel == c, 0]) / np.linalg.norm(error)
        shifted.append(dataclasses.replace(b, mean=mean))
    moved = dataclasses.replace(problem, trials=tuple(shifted))
    again = fit(moved, (), found.point)
    assert again.nuisance[0] > found.nuisance[0] + 0.5


def test_a_claim_under_three_times_our_own_error_is_refused():
    data = dataset(seed=22)
    prepared = prepare(data, None, few())
    problem, parent = prepared.problem, prepared.present

    def child(times):
        rows = tuple(r - times * n[:, 0] for r, n in zip(parent.residuals, problem.nuisance, strict=True))
        return dataclasses.replace(parent, residuals=rows)

    assert may_be_ours(problem, parent, child(2.9))
    assert may_be_ours(problem, parent, child(-1.0))
    assert not may_be_ours(problem, parent, child(3.1))
    freed = dataclasses.replace(child(1.0), pull_rigidity=parent.pull_rigidity + 12.0)
    assert not may_be_ours(problem, parent, freed)
    own = parent.point.trial_friction + 0.1 * np.linspace(-1.0, 1.0, len(problem.trials))
    steadied = dataclasses.replace(child(1.0), point=dataclasses.replace(parent.point, trial_friction=own))
    assert not may_be_ours(problem, parent, steadied)


def test_a_finer_solver_leaves_less_of_our_own_error():
    data = dataset(seed=23)
    problem = prepare(data, None, few()).problem
    found = fit(problem, (), prepare(data, None, few()).present.point)
    sizes = []
    for length_m in (4e-3, 0.5e-3):
        used = dataclasses.replace(
            problem,
            base=dataclasses.replace(problem.base, element_length_m=length_m),
        )
        error = solver_error(used, found, data.trials, 0.25e-3)
        sizes.append(float(np.linalg.norm(np.concatenate([e[:, 0] for e in error]))))
    assert sizes[1] < sizes[0]


@pytest.mark.parametrize("seed", [31, 32])
def test_a_sloppy_solver_is_not_an_effect(seed):
    """Data from cells and tolerances eight times coarser hold a numerical error, and no effect."""
    model = load_parameters("rig_rigid")
    sloppy = dataclasses.replace(
        model, element_length_m=8 * model.element_length_m, tolerance_rad=8 * model.tolerance_rad
    )
    found = diagnose(simulate_dataset(sloppy, PROTOCOL, seed, Noise(), name="sloppy"), few())
    assert found.verdict == "none"
