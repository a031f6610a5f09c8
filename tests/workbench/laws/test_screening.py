"""Laws of what was not recorded are not asked for."""

import dataclasses

import numpy as np

from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.laws.screening import candidates
from tests.workbench.hidden import dataset, few


def test_no_law_of_a_channel_that_was_not_recorded_is_screened() -> None:
    whole = dataset()
    blank = [dataclasses.replace(t, torque_nm=t.torque_nm * np.nan) for t in whole.trials]
    angles = dataclasses.replace(whole, trials=tuple(blank))
    both, alone = (
        {made.law.name for made in candidates(fit_baseline(data, None, few()).problem, "law")}
        for data in (whole, angles)
    )
    assert alone < both
