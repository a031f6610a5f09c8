import json
import math

import pytest
from scipy.optimize import brentq

from needle_rig.cli.main import run
from needle_rig.config.schema import SimulationSection
from needle_rig.errors import BadInput
from needle_rig.model import MODEL_LAYOUT, load_parameters
from needle_rig.physics.needle_model import FRICTION
from needle_rig.workbench.paper.experiments import (
    held_tip_torque_nm,
    identify_damping,
    identify_friction,
    identify_jg,
    settling_time_s,
    with_effect,
)


def noisy(seed: int) -> SimulationSection:
    return SimulationSection(seed=seed)


@pytest.mark.parametrize(("parameters", "seed"), [("rig_rigid", 1), ("rig_elastic", 2), ("stiff_needle", 3)])
def test_rigidity_is_found_within_two_percent(parameters: str, seed: int) -> None:
    found = identify_jg(load_parameters(parameters), noisy(seed))
    assert abs(found.error_percent) < 2.0
    assert found.uncertainty > 0


@pytest.mark.parametrize("friction_nmm", [0.0996, 0.3])
def test_friction_is_found_within_two_percent(friction_nmm: float) -> None:
    model = load_parameters("rig_elastic").replaced({FRICTION: friction_nmm})
    found = identify_friction(model, noisy(4))
    assert found.plant_value == pytest.approx(friction_nmm)
    assert abs(found.error_percent) < 2.0


def test_friction_is_found_although_the_slip_is_damped() -> None:
    model = with_effect(load_parameters("rig_rigid"), "viscous_slip=0.2")
    assert abs(identify_friction(model, noisy(5)).error_percent) < 2.0


@pytest.mark.parametrize("damping", [0.3, pytest.param(2.8, marks=pytest.mark.whole)])
def test_damping_is_found_within_two_percent(damping: float) -> None:
    model = with_effect(load_parameters("rig_rigid"), f"viscous_slip={damping}")
    found = identify_damping(model, noisy(6))
    assert found.plant_value == pytest.approx(damping)
    assert abs(found.error_percent) < 2.0
    assert len(found.readings) == 3
    assert found.readings[1]["rate_rad_s"] == pytest.approx(0.08, rel=0.1)


def test_no_damping_to_find() -> None:
    with pytest.raises(BadInput, match="has no damping to find"):
        identify_damping(load_parameters("rig_rigid"), noisy(1))


def test_noise_is_on() -> None:
    model = load_parameters("rig_rigid")
    values = {identify_jg(model, noisy(seed)).value for seed in (1, 2)}
    assert len(values) == 2


def test_the_papers_turn_and_settling() -> None:
    assert held_tip_torque_nm(62.56e-6, 0.410) == pytest.approx(0.24e-3, rel=0.01)
    model = load_parameters("figure_3", layout=MODEL_LAYOUT)
    mu = brentq(lambda x: x * math.tan(x) - 0.100 / 0.175, 0.1, 1.5)
    expected = 0.100**2 * 2.8e-2 / model.torsional_rigidity_nm2 / mu**2
    assert settling_time_s(model, 2.8) == pytest.approx(expected, rel=0.02)


def test_the_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["identify", "jg", "--json", "--seed", "3"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["within"] is True
    assert document["plant_value"] == pytest.approx(62.56)
    assert run(["identify", "friction", "--effect", "torque_gain=1.2"]) == 1
    assert "off by" in capsys.readouterr().out
