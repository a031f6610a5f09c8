"""The shaft between its sensors: where the physics leaves no freedom, and where it does."""

import numpy as np
import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Trial
from needle_rig.service.api.documents import Rig
from needle_rig.service.tick.report import rig_document
from needle_rig.units import deg, rad
from needle_rig.web.estimate import shaft_estimate


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_document(load_rig_config(None), simulated=True)


def test_what_the_rod_model_does_lies_within_the_stated_uncertainty(rig: Rig) -> None:
    model = load_parameters("rig_rigid")
    base = rad(np.r_[np.linspace(0.0, 60.0, 60), np.linspace(60.0, 20.0, 40)])
    trial = Trial(np.linspace(0.0, 3.0, 100), base)
    truth = model.truth(trial, shaft=True)
    assert truth.shaft_rad is not None
    estimate = shaft_estimate(rig)
    readings = np.r_[base[-1], truth.torque_nm[-1], truth.sensor_rad[-1]]
    true = np.interp(estimate.position_m, model.rod(trial).position_m, truth.shaft_rad[-1])
    off = np.abs(estimate.gain @ readings - true)
    assert off.max() < rad(2.0)
    assert np.all(off < 3 * estimate.deviation_rad + rad(0.1))


def test_it_is_surest_at_the_sensors_and_least_sure_in_the_tissue_between(rig: Rig) -> None:
    estimate = shaft_estimate(rig)
    at = [int(np.abs(estimate.position_m - p / 1e3).argmin()) for p in rig["hall_positions_mm"]]
    between = int(np.abs(estimate.position_m - 0.2525).argmin())
    assert estimate.deviation_rad[0] < rad(0.03)
    assert max(estimate.deviation_rad[at[:3]]) < rad(0.26)
    assert estimate.deviation_rad[between] > max(estimate.deviation_rad[at[:2]])


def test_a_shaft_that_turns_as_a_whole_is_estimated_as_one(rig: Rig) -> None:
    estimate = shaft_estimate(rig)
    readings = np.r_[1.0, 0.0, np.ones(len(rig["hall_positions_mm"]))]
    assert deg(np.abs(estimate.gain @ readings - 1.0)).max() < 1e-3
