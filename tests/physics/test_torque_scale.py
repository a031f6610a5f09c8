"""What is decided by the size of a shaft's torques."""

import dataclasses
import math
from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, SavedModel, load_model, save_model
from needle_rig.physics.effects.tip_friction import TipFriction
from needle_rig.physics.effects.torque_nonlinearity import TorqueNonlinearity
from needle_rig.physics.library import built_in_effects
from needle_rig.physics.needle_model import BASE_PARAMETERS, NeedleModel
from needle_rig.physics.torque_scale import AS_THE_NEEDLE, RIGIDITY_NM2, torque_power, torque_scale


@pytest.mark.parametrize(
    ("unit", "power"),
    [
        ("N·mm", 1), ("N·mm per 100 mm", 1), ("N·mm/rad per 100 mm", 1), ("N·mm·s/rad", 1), ("N·mm²", 1),
        ("N·mm/min", 1), ("g·cm²", 1), ("1/N·mm", -1), ("1/(N·mm)²", -2), ("°/N·mm", -1),
        ("°", 0), ("1", 0), ("ms", 0), ("1 per 100 mm", 0), ("1/decade", 0), ("mm", 0),
    ],
)  # fmt: skip
def test_torque_enters_a_unit_with_a_power(unit: str, power: int) -> None:
    assert torque_power(unit) == power


def test_every_unit_of_the_library_with_a_torque_is_seen() -> None:
    infos = [i for e in built_in_effects().values() for i in e.parameters().values()]
    for info in (*infos, *BASE_PARAMETERS.values()):
        assert bool(torque_power(info.unit)) == ("N·mm" in info.unit or info.unit == "g·cm²")


def test_a_needle_is_a_needle_and_a_machine_a_power_of_ten() -> None:
    assert torque_scale(2e-4, RIGIDITY_NM2) == 1.0
    assert torque_scale(0.99 * AS_THE_NEEDLE * 2e-4, None) == 1.0
    assert torque_scale(1.01 * AS_THE_NEEDLE * 2e-4, None) == 100.0
    assert torque_scale(0.12, 0.4) == 1000.0
    assert torque_scale(0.99 / AS_THE_NEEDLE * 2e-4, None) == 0.01
    assert torque_scale(0.0, 0.6) == 10000.0
    assert torque_scale(0.0, RIGIDITY_NM2) == 1.0
    assert torque_scale(0.0, None) == torque_scale(math.nan, math.nan) == 1.0


def test_the_rigidity_holds_the_scale_within_its_own_bounds() -> None:
    # a needle whose torque cell is noise, and a stiff shaft that bears little
    assert torque_scale(0.14, RIGIDITY_NM2) == 1.0
    for span_nm in (1e-7, 1e-4, 1e-1, 1e2):
        for rigidity_nm2 in (1e-8, 2e-6, 6e-5, 9e-3, 2e-2, 1.0, 50.0):
            scale = torque_scale(span_nm, rigidity_nm2)
            assert 1.0 * scale <= rigidity_nm2 * 1e6 <= 1e4 * scale or rigidity_nm2 < 2e-6


def test_bounds_go_with_the_scale_and_are_the_same_at_one() -> None:
    info = TipFriction.parameters()["torque_nmm"]
    assert info.scaled(1.0) is info
    scaled = info.scaled(1000.0)
    assert (scaled.upper, scaled.typical, scaled.smallest) == pytest.approx((1000.0, 30.0, 1.4))
    assert TorqueNonlinearity.parameters()["square_per_nmm"].scaled(10.0).typical == pytest.approx(
        TorqueNonlinearity.parameters()["square_per_nmm"].typical / 10.0
    )


def test_a_model_holds_its_effects_to_the_bounds_of_its_scale() -> None:
    needle = NeedleModel("m", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3)
    with pytest.raises(BadInput, match=r"tip_friction.torque_nmm: 30 N·mm is above 1"):
        needle.with_effects(TipFriction(torque_nmm=30.0))
    machine = NeedleModel("m", EXPERIMENT_LAYOUT, 62.56e-3, 1.0, torque_scale=1000.0)
    heavy = machine.with_effects(TipFriction(torque_nmm=30.0))
    assert heavy.info("tip_friction.torque_nmm").upper == 1000.0
    with pytest.raises(BadInput, match="is above 1000"):
        heavy.replaced({"tip_friction.torque_nmm": 1001.0})


def test_a_shaft_with_all_torques_larger_turns_alike() -> None:
    from tests.effects.common import SHORT

    one = NeedleModel("one", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3, (TipFriction(torque_nmm=0.03),), 4e-3)
    other = dataclasses.replace(
        one,
        torsional_rigidity_nm2=62.56e-3,
        friction_n=1.0,
        effects=(TipFriction(torque_nmm=30.0),),
        torque_scale=1000.0,
    )
    small, large = one.predict(SHORT), other.predict(SHORT)
    assert large.hall_rad == pytest.approx(small.hall_rad, abs=1e-9)
    assert large.torque_nm == pytest.approx(1000.0 * small.torque_nm, rel=1e-7, abs=1e-10)


def test_a_model_file_keeps_its_scale(tmp_path: Path) -> None:
    machine = NeedleModel(
        "m", EXPERIMENT_LAYOUT, 62.56e-3, 1.0, (TipFriction(torque_nmm=30.0),), torque_scale=1000.0
    )
    save_model(tmp_path / "machine.yaml", SavedModel(machine, "null"))
    assert load_model(tmp_path / "machine.yaml").model.torque_scale == 1000.0
    text = (tmp_path / "machine.yaml").read_text()
    (tmp_path / "machine.yaml").write_text(text.replace("value: 30.0", "value: 3000.0"))
    with pytest.raises(BadInput, match=r"machine\.yaml:\d+.*3000 N·mm is above 1000"):
        load_model(tmp_path / "machine.yaml")
    needle = NeedleModel("n", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3)
    save_model(tmp_path / "needle.yaml", SavedModel(needle, "null"))
    assert "torque_scale" not in (tmp_path / "needle.yaml").read_text()
