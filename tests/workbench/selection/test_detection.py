"""How strong an effect must be before a dataset shows it."""

import math

import pytest

from campaigns.workbench.detection import detection_limit, smallest_strength
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.estimation.parameters import at_strength
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import dataset, few, null_fit


@pytest.mark.parametrize("name", ["tissue_elasticity", "hall_offset"])
def test_noisier_sensors_raise_the_limit(name: str) -> None:
    limits = [
        detection_limit(null_fit(noise=noise), name)
        for noise in (Noise(), Noise(hall_deg=2.0, torque_nmm=0.0064))
    ]
    assert 2.0 < limits[1] / limits[0] < 12.0


@pytest.mark.whole
def test_an_effect_that_the_data_cannot_show_has_no_limit() -> None:
    deaf = null_fit(noise=Noise(torque_nmm=20.0))
    assert detection_limit(deaf, "torque_bias") == math.inf


def test_signs_alternate_over_sensors_and_follow_the_turn() -> None:
    problem = null_fit().problem
    offsets = at_strength(problem.parameters(["hall_offset"]), 2.0, turn=-1.0)
    assert offsets.tolist() == [-2.0, 2.0, -2.0, 2.0]
    assert at_strength(problem.parameters(["chuck_backlash"]), 2.0, turn=-1.0).tolist() == [2.0]
    assert smallest_strength(problem.parameters(["hall_offset"])) > 0


def test_what_the_random_effects_can_absorb_shows_only_above_its_scatter() -> None:
    wear = few("friction_wear")
    baseline = fit_baseline(dataset(noise=Noise(friction_scatter=0.05)), None, wear)
    turns = baseline.problem.trials[-1].trial.travel_before_rad / math.tau
    limit = (
        detection_limit(baseline, "friction_wear")
        * wear["friction_wear"].parameters()["loss_per_turn"].typical
    )
    assert limit * turns > 2 * 0.05
