import dataclasses

import numpy as np
import pytest
from scipy.special import fdtrc

from needle_rig.dataset import Dataset, in_series
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.observations.noise_terms.motion_scatter import MotionScatter
from needle_rig.workbench.observations.noise_terms.offset import Offset
from needle_rig.workbench.observations.noise_terms.white import White
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.lack_of_fit import LackOfFit, lack_of_fit
from needle_rig.workbench.virtual.noise import Noise
from tests.values import known
from tests.workbench.hidden import dataset, diagnosed, effect, few, fit, try_effect


def checked(data: Dataset) -> LackOfFit:
    baseline = fit_baseline(data, None, few())
    return known(lack_of_fit(baseline.problem, baseline.current, data.sensor_names))


@pytest.mark.whole
def test_nothing_hidden_is_seldom_significant_at_any_scatter() -> None:
    found = [
        checked(dataset(seed=300 + s, noise=Noise(friction_scatter=(0.02, 0.15)[s % 2]))) for s in range(12)
    ]
    assert sum(f.p < 0.01 for f in found) <= 1
    assert 0.75 < np.mean([f.statistic for f in found]) < 1.25
    assert np.median([f.p for f in found]) > 0.1


@pytest.mark.parametrize(
    "hidden",
    [
        effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=2.0),
        effect("torque_bias", bias_nmm=0.004),
        effect("chuck_backlash", play_deg=1.0),
    ],
)
def test_an_effect_is_significant_until_it_is_fitted(hidden: Effect) -> None:
    data = dataset(hidden, seed=41)
    baseline = fit_baseline(data, None, few())
    before = known(lack_of_fit(baseline.problem, baseline.current, data.sensor_names))
    found = try_effect(baseline.problem, baseline.current, hidden.name()).fit
    after = known(lack_of_fit(baseline.problem, found, data.sensor_names))
    assert before.p < 1e-6
    assert before.statistic > 5 * after.statistic
    assert after.p > 0.001


def test_a_wrong_noise_level_passes_for_no_effect() -> None:
    data = dataset(seed=43)
    baseline = fit_baseline(data, None, few())
    problem, noise = baseline.problem, baseline.problem.noise
    low = noise.having(White(noise.white / 2)).having(Offset(noise.term(Offset).sd / 2))
    low = low.having(MotionScatter(noise.term(MotionScatter).sd / 2))
    louder = problem.with_noise(low)

    found = fit(louder, (), baseline.current.vector)
    assert found.chi2 > 2.5 * louder.size
    assert known(lack_of_fit(louder, found, data.sensor_names)).p > 0.01
    assert baseline.current.chi2 < 1.2 * problem.size


@pytest.mark.parametrize(("share", "significant"), [(0.0, False), (1.0, False), (8.0, True)])
def test_what_replicates_share_within_the_accuracy_of_the_solver_is_no_lack_of_fit(
    share: float, significant: bool
) -> None:
    noise = Noise(hall_deg=0.03, torque_nmm=0.0001, friction_scatter=0.005)
    data = dataset(seed=47, noise=noise)
    trials = []
    for trial in data.trials:
        _, motion = np.unique(trial.phase, return_inverse=True)
        error_rad = np.radians(share * POLICY.noise.floor_deg) * np.where(motion % 2, 1.0, -1.0)
        trials.append(dataclasses.replace(trial, hall_rad=trial.hall_rad + error_rad[:, None]))
    found = checked(dataclasses.replace(data, trials=tuple(trials)))
    assert found.significant is significant, found
    # against an F distribution alone, errors of the accuracy are significant
    alone = float(fdtrc(found.shared_dof, found.differing_dof, found.statistic))
    assert (alone < POLICY.evidence.significance) is (share > 0.0)


def test_it_says_where_and_how_much() -> None:
    found = checked(dataset(effect("torque_bias", bias_nmm=0.02), seed=44))
    assert found.where.startswith("torque")
    assert found.unit == "N·mm"
    assert found.size == pytest.approx(0.02, rel=0.3)
    assert "alike in every replicate" in found.sentence()


def test_without_replicates_there_is_no_test() -> None:
    data = dataset(seed=45)
    once = dataclasses.replace(data, trials=in_series(tuple(data.trials[i] for i in (0, 2, 3))))
    baseline = fit_baseline(once, None, few())
    assert lack_of_fit(baseline.problem, baseline.current, once.sensor_names) is None
    answer = diagnose(once, few("torque_bias")).as_json()
    assert answer["lack_of_fit"] == {"before": None, "after": None}


def test_the_answer_carries_the_test_before_and_after() -> None:
    answer = diagnosed(effect("torque_bias", bias_nmm=0.02), seed=46, library=("torque_bias",)).as_json()
    assert known(answer["lack_of_fit"]["before"])["p"] < 1e-6
    assert known(answer["lack_of_fit"]["after"])["p"] > 0.001
    assert answer["effects"] == ["torque_bias"]
