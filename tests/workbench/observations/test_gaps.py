"""Gaps in a channel: where the base begins to turn, or a motion ends, no value is made up across them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from needle_rig.dataset import DatasetTrial
from needle_rig.dataset.protocol import Protocol, compensation
from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.units import nm, rad
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import bin_trial, motions_of
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import NO_NOISE

MODEL = load_parameters("rig_rigid")
GAP = 15
SEEN = np.r_[nm(1.5e-4), np.full(4, rad(0.03))][:, None]
"""What the solver promises, N·m and rad."""


@pytest.fixture(scope="module")
def given() -> DatasetTrial:
    protocol = Protocol("one", (compensation(60.0),))
    return simulate_dataset(MODEL, protocol, 1, NO_NOISE).trials[0]


def with_gap(given: DatasetTrial, at: int, samples: int) -> DatasetTrial:
    """`given` without these samples of any channel."""
    torque_nm, hall_rad = given.torque_nm.copy(), given.hall_rad.copy()
    torque_nm[at : at + samples] = hall_rad[at : at + samples] = np.nan
    return dataclasses.replace(given, torque_nm=torque_nm, hall_rad=hall_rad)


def left(given: DatasetTrial) -> Array:
    """What the model that made the trial leaves of its bin means, (C, K)."""
    binned = bin_trial(given)
    (reading,) = Simulator().readings([MODEL], [binned])
    return np.asarray(binned.mean - reading)


def test_a_gap_at_either_end_of_a_motion_leaves_nothing(given: DatasetTrial) -> None:
    whole = np.abs(left(given)).max(axis=1, keepdims=True)
    begun, stopped, _ = motions_of(given.trial.base_angle_rad, np.asarray(given.phase))[1]
    for edge in (begun, stopped):
        for before in (2, GAP // 2, GAP - 2):
            wrong = np.abs(left(with_gap(given, edge - before, GAP)))
            assert np.nanmax(wrong / (whole + SEEN)) < 2.0, (edge, before)
