import dataclasses

import numpy as np

from needle_rig.workbench.selection.decisions import decide
from needle_rig.workbench.selection.diagnose import diagnose
from tests.workbench.hidden import dataset, few


def test_a_limit_of_what_is_not_there_is_no_finer_than_the_derivatives_step() -> None:
    """Next to stick-slip a step from 0 moves slips: errors of what was fitted there come out as good as 0."""
    search = diagnose(dataset(seed=24), few("tissue_elasticity", "torque_bias")).search
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
    decision = decide(search, [])["tissue_elasticity"]
    assert decision.decision == "absent"
    assert decision.limit is not None
    assert np.isfinite(decision.limit)
