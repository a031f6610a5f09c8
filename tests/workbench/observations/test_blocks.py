"""One command alone, cut into blocks of time."""

import dataclasses

import numpy as np
import pytest

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import Protocol, compensation
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.workbench.estimation.baseline import fit_baseline
from needle_rig.workbench.observations.blocks import BLOCKS, NOTE, in_blocks
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.residual_patterns import find_residual_patterns
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import dataset, effect, few


def alone(data: Dataset, place: int = 0) -> Dataset:
    return dataclasses.replace(data, trials=data.trials[place : place + 1])


def test_several_commands_stay_trials() -> None:
    data = dataset()
    assert in_blocks(data) is data


def test_the_blocks_of_a_trial_hold_each_reading_once() -> None:
    given = alone(dataset())
    found = in_blocks(given)
    assert len(found.trials) == BLOCKS == len({t.command for t in found.trials})
    assert NOTE in found.notes
    trial = given.trials[0]
    seen = np.zeros(trial.hall_rad.shape, dtype=int)
    for block in found.trials:
        end = len(block.trial.time_s)
        assert np.array_equal(block.trial.base_angle_rad, trial.trial.base_angle_rad[:end])
        known = np.isfinite(block.hall_rad)
        assert np.array_equal(block.hall_rad[known], trial.hall_rad[:end][known])
        seen[:end] += known
    assert (seen == np.isfinite(trial.hall_rad)).all()


def test_replicates_of_the_command_stay_replicates_block_by_block() -> None:
    data = dataset()
    given = dataclasses.replace(data, trials=(data.trials[0], data.trials[1], data.trials[4]))
    assert sorted(map(len, in_blocks(given).replicates.values())) == [3] * BLOCKS


def test_a_trial_too_short_to_be_cut_stays_whole() -> None:
    data = alone(dataset())
    trial = data.trials[0]
    few_known = np.arange(len(trial.torque_nm)) < 4 * 10 - 1
    torque = np.where(few_known, trial.torque_nm, np.nan)
    hall = np.where(few_known[:, None], trial.hall_rad, np.nan)
    short = dataclasses.replace(data, trials=(dataclasses.replace(trial, torque_nm=torque, hall_rad=hall),))
    assert in_blocks(short) is short


@pytest.mark.parametrize(
    ("hidden", "low", "high"),
    [
        ((), 0.7, 1.3),
        ((effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45),), 5.0, 500.0),
    ],
)
def test_the_error_left_out_of_one_command_is_a_number_that_tells_a_right_model(
    hidden: tuple[Effect, ...], low: float, high: float
) -> None:
    baseline = fit_baseline(alone(dataset(*hidden, seed=2)), None, few())
    assert low < baseline.validation.error < high
    assert NOTE in baseline.dataset.notes


@pytest.mark.whole
def test_the_blocks_of_a_trial_have_one_friction_whose_scatter_is_no_trend() -> None:
    """Three draws may lie along a line, and twelve blocks are three draws."""
    for seed in range(4):
        protocol = Protocol("thrice", (compensation(45.0),) * 3)
        data = simulate_dataset(load_parameters("rig_rigid"), protocol, seed, Noise(friction_scatter=0.05))
        there = fit_baseline(data, None, few("torque_bias"))
        assert len(there.problem.trials) == 3 * BLOCKS
        assert not find_residual_patterns(there.problem, there.current, data.sensor_names).patterns, seed
        assert there.problem.recorded.tolist() == [0] * BLOCKS + [1] * BLOCKS + [2] * BLOCKS
        each = there.current.vector.trial_friction.reshape(3, BLOCKS)
        assert np.ptp(each, axis=1) == pytest.approx(np.zeros(3), abs=0.002)
        assert there.current.scatter_dof == POLICY.noise.scatter_dof + 3
        assert diagnose(data, few("friction_wear", "torque_bias")).verdict == "none", seed
