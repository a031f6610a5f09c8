"""Models: parameters by name, batches, and what cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.errors import BadInput
from needle_rig.physics.needle_model import BASE_PARAMETERS, NeedleModel, predict_batch
from tests.effects.common import LIBRARY, SHORT, make_effect


def test_values_lists_every_parameter_in_units_of_files(coarse: NeedleModel) -> None:
    model = coarse.with_effects(make_effect("hall_offset", 2.0), make_effect("stribeck", 0.3))
    values = model.values()
    assert list(values) == [
        "friction_nmm_per_100mm",
        "torsional_rigidity_nmm2",
        *(f"hall_offset.offset_deg[{i}]" for i in range(4)),
        "stribeck.static_excess",
        "stribeck.rate_deg_s",
        "stribeck.weakening_deg",
        "stribeck.exponent",
    ]
    assert values["friction_nmm_per_100mm"] == pytest.approx(0.1)
    assert values["torsional_rigidity_nmm2"] == pytest.approx(62.56)
    assert all(model.info(name).unit for name in values)


def test_replaced_sets_by_name_and_leaves_the_rest(coarse: NeedleModel) -> None:
    model = coarse.with_effects(make_effect("hall_offset", 2.0), make_effect("tip_friction", 0.03))
    other = model.replaced({"hall_offset.offset_deg[2]": -1.0, "friction_nmm_per_100mm": 0.12})
    assert other.values() == model.values() | {
        "hall_offset.offset_deg[2]": -1.0,
        "friction_nmm_per_100mm": pytest.approx(0.12),
    }
    assert model.replaced({}).predict(SHORT).torque_nm == pytest.approx(model.predict(SHORT).torque_nm)


@given(scaled=st.floats(-5, 5), name=st.sampled_from(sorted(LIBRARY)))
def test_scales_go_forth_and_back(scaled: float, name: str) -> None:
    for info in (*LIBRARY[name].parameters().values(), *BASE_PARAMETERS.values()):
        if info.scale == "linear" or scaled:
            assert info.to_scale(info.from_scale(scaled)) == pytest.approx(scaled)


def test_strength_counts_from_off_to_typical() -> None:
    for effect in LIBRARY.values():
        assert effect.at_strength(0.0).is_off()
        for name, info in effect.parameters().items():
            assert getattr(effect.at_strength(1.0), name) == pytest.approx(info.typical)
    stiffness = vars(LIBRARY["tissue_elasticity"].at_strength(0.5))["stiffness_nmm_per_rad_per_100mm"]
    assert stiffness == pytest.approx(0.7)  # half as strong is twice as stiff


def test_needle_constants_are_known_to_two_per_cent() -> None:
    assert BASE_PARAMETERS["torsional_rigidity_nmm2"].prior == 0.02
    assert BASE_PARAMETERS["friction_nmm_per_100mm"].prior is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"friction_nmm_per_100mm": -0.1}, r"friction_nmm_per_100mm: -0.1 N·mm per 100 mm is below 0"),
        ({"torsional_rigidity_nmm2": 0.0}, r"torsional_rigidity_nmm2: 0 N·mm² is below 1"),
        ({"torsional_rigidity_nmm2": float("nan")}, "nan is not a number"),
        ({"tip_friction.torque_nmm": 7.0}, "tip_friction.torque_nmm: 7 N·mm is above 1"),
        ({"tip_friction.size": 7.0}, "no parameter tip_friction.size; it has friction_nmm_per_100mm"),
        ({"hall_offset.offset_deg[0]": 1.0}, "no parameter hall_offset"),
    ],
)
def test_values_that_cannot_be(coarse: NeedleModel, change: dict[str, float], words: str) -> None:
    with pytest.raises(BadInput, match=words):
        coarse.with_effects(make_effect("tip_friction", 0.01)).replaced(change)


def test_an_effect_is_listed_once(coarse: NeedleModel) -> None:
    weak, strong = make_effect("tip_friction", 0.01), make_effect("tip_friction", 0.02)
    with pytest.raises(BadInput, match="effect tip_friction is listed twice"):
        replace(coarse, effects=(weak, strong))
    assert coarse.with_effects(weak).with_effects(strong).effects == (strong,)
    assert coarse.with_effects(weak).without("tip_friction") == coarse


def test_a_batch_is_its_single_predictions(coarse: NeedleModel) -> None:
    models = [coarse.with_effects(LIBRARY[name].at_strength(1.0)) for name in ("tip_friction", "hall_gain")]
    trials = [SHORT, replace(SHORT, base_angle_rad=-SHORT.base_angle_rad)]
    for reading, model, trial in zip(predict_batch(models, trials), models, trials, strict=True):
        alone = model.predict(trial)
        assert (reading.torque_nm == alone.torque_nm).all()
        assert (reading.hall_rad == alone.hall_rad).all()
        assert reading.trial is trial
    assert predict_batch([], []) == []
    with pytest.raises(BadInput, match="2 models for 1 trials"):
        predict_batch(models, trials[:1])


def test_the_rod_knows_its_place_in_the_series(coarse: NeedleModel) -> None:
    worn = coarse.with_effects(make_effect("friction_wear", 0.1))
    first, later = (worn.rod(replace(SHORT, travel_before_rad=t)) for t in (0.0, 50.0))
    assert later.slip_plus_nm.sum() < first.slip_plus_nm.sum()


def test_finer_has_more_nodes_and_the_same_answer(coarse: NeedleModel) -> None:
    fine = coarse.finer(4)
    assert fine.rod(SHORT).position_m.size > 3 * coarse.rod(SHORT).position_m.size
    difference = fine.predict(SHORT).hall_rad - coarse.predict(SHORT).hall_rad
    assert np.degrees(np.abs(difference)).max() < 0.05


def test_models_compare_by_value(coarse: NeedleModel) -> None:
    assert coarse == NeedleModel(
        "null", coarse.layout, 62.56e-6, 1e-3, element_length_m=coarse.element_length_m
    )
    assert hash(coarse.with_effects(make_effect("tip_friction", 0.01)))
