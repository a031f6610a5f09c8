"""A model held as it stands: each wrong value is told as what it is, and a right model as right."""

from __future__ import annotations

import dataclasses
import json
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import needle_rig as nr
from needle_rig.cli.compare import command
from needle_rig.cli.diagnose import command as diagnose_command
from needle_rig.dataset import write_dataset
from needle_rig.errors import BadInput
from needle_rig.figures.comparison import residual_map, traces
from needle_rig.model import HistoryEntry, SavedModel, load_parameters, save_model
from needle_rig.physics.needle_model import FRICTION, TORSIONAL_RIGIDITY
from needle_rig.questions.question import Question
from needle_rig.workbench.learning.compare import LEARNT_HERE, Held, TraceComparison, compare, compared
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS, errors_by_channel
from needle_rig.workbench.selection.values import with_uncertainty
from tests.values import known
from tests.workbench.hidden import dataset, effect, few

STIFFNESS = "tissue_elasticity.stiffness_nmm_per_rad_per_100mm"
ELASTIC = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.35)
TRUE = load_parameters("rig_rigid").with_effects(ELASTIC)
SIZES = {FRICTION: 1e-3, TORSIONAL_RIGIDITY: 0.03, STIFFNESS: 2e-4}


def model(name: str = FRICTION, factor: float = 1.0) -> SavedModel:
    return SavedModel(TRUE.replaced({name: factor * TRUE.values()[name]}), "null", SIZES)


@lru_cache
def held(name: str = FRICTION, factor: float = 1.0, seed: int = 1) -> TraceComparison:
    return compare(dataset(ELASTIC, seed=seed), few(), model(name, factor))


@pytest.mark.parametrize(
    ("name", "factor", "error", "sigmas"),
    [(STIFFNESS, 0.5, 15.0, 300.0), (FRICTION, 1.2, 10.0, 10.0), (TORSIONAL_RIGIDITY, 1.05, 2.0, 30.0)],
)
def test_a_wrong_value_is_told_with_its_size_and_its_distance(
    name: str, factor: float, error: float, sigmas: float
) -> None:
    found = held(name, factor)
    assert found.held is not None
    assert found.held.error > error
    assert found.held.worst
    assert found.refit.error < 1.1
    assert found.values.contradict
    worst = found.values.worst()
    assert worst is not None
    assert worst.name == name
    assert worst.refit == pytest.approx(TRUE.values()[name], rel=0.03)
    assert worst.model == pytest.approx(factor * TRUE.values()[name])
    assert np.sign(worst.sigmas or 0.0) == np.sign(1.0 - factor)
    assert abs(worst.sigmas or 0.0) > sigmas
    others = [abs(v.sigmas or 0.0) for v in found.values.each if v.name != name]
    assert max(others) < 3.0
    said = "\n".join(found.sentences())
    assert f"the model's values contradict these data (p < 1e-09, limit 0.001): {name} is off by" in said
    assert "its values as they stand: " in found.headline()[1]


@pytest.mark.whole
def test_a_right_model_is_told_as_right() -> None:
    seeds = [held(seed=seed) for seed in range(1, 7)]
    errors = [f.held.error for f in seeds if f.held is not None]
    # the mean of five trials' friction is one draw: a set has one chance of a third to be above 1
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5
    assert max(errors) < 2.5
    for found in seeds:
        assert found.held is not None
        assert not found.values.contradict
        assert 0.7 < found.refit.error < 1.1
        assert not [p for p in found.held.worst if p.sigmas > 5.0]
        assert "the model's values hold on these data" in found.sentences()[1]


def test_error_and_noise_of_each_column_divide_to_its_ratio() -> None:
    for column in (held().held, held().refit):
        assert column is not None
        for of in column.channels.values():
            assert of["noise"] is not None
            assert of["rmse"] / of["noise"] == pytest.approx(of["in_noise_units"], rel=1e-9)


def test_a_shift_of_all_trials_friction_is_not_their_own() -> None:
    found = held(FRICTION, 1.2)
    assert found.held is not None
    assert abs(found.held.fit.vector.trial_friction.mean()) < 1e-3
    assert found.held.fit.vector.trial_friction == pytest.approx(
        found.refit.fit.vector.trial_friction, abs=0.01
    )


def test_a_fixed_value_stands_in_both_columns() -> None:
    fixed = Held(fixed={FRICTION: 0.12})
    found = compare(dataset(ELASTIC), few(), model(), fixed)
    assert np.exp(found.refit.fit.vector.log_friction) == pytest.approx(1.2e-3)
    assert found.refit.error > 2.0
    assert found.values.each[0].sentence() == "fixed: friction_nmm_per_100mm = 0.12 N·mm per 100 mm"
    assert found.held_out_error > held().held_out_error + 0.05


def test_a_free_value_is_fitted_where_the_others_stand() -> None:
    found = compare(dataset(ELASTIC), few(), model(FRICTION, 1.2), Held(free=(FRICTION,)))
    assert found.held is not None
    assert found.held.error < 1.1
    assert f"as they stand but for {FRICTION}, fitted" in found.headline()[1]


def test_the_null_models_constants_may_be_fixed_one_by_one() -> None:
    found = compare(dataset(), few(), None, Held(fixed={TORSIONAL_RIGIDITY: 65.7}))
    assert found.held is None
    assert np.exp(found.refit.fit.vector.log_rigidity) == pytest.approx(65.7e-6)
    assert found.refit.error > 1.1
    assert f"(its two constants are fitted but for {TORSIONAL_RIGIDITY})" in found.headline()[1]


@pytest.mark.parametrize(
    ("values", "saved", "sentence"),
    [
        (Held(fixed={"stiffness": 1.0}), True, "stiffness: no value of the model rig_rigid; it has friction"),
        (Held(fixed={FRICTION: 0.1}, free=(FRICTION,)), True, "is both fixed and free"),
        (Held(free=(FRICTION,)), False, "it is fitted already"),
        (Held(fixed={FRICTION: -1.0}), True, "friction_nmm_per_100mm"),
    ],
)
def test_what_cannot_be_held_is_a_sentence(values: Held, saved: bool, sentence: str) -> None:
    with pytest.raises(BadInput, match=sentence):
        compare(dataset(ELASTIC), few(), model() if saved else None, values)


@pytest.mark.whole
def test_the_command_takes_a_file_or_a_set_and_prints_both_columns(tmp_path: Path) -> None:
    folder = str(write_dataset(dataset(ELASTIC), tmp_path / "data"))
    save_model(tmp_path / "half.yaml", model(STIFFNESS, 0.5))
    half = [folder, "--model", str(tmp_path / "half.yaml")]
    told = json.loads(CliRunner().invoke(command, [*half, "--json"]).stdout)
    assert told["held"]["error"] > 15.0 > 1.1 > told["refit"]["error"]
    assert told["channels"] == told["held"]["channels"]
    off = {p["name"]: p for p in told["parameters"]}[STIFFNESS]
    assert off["model"] == 0.175
    assert off["model_uncertainty"] == pytest.approx(2e-4, rel=1e-3)
    assert off["refit"] == pytest.approx(0.35, rel=0.01)
    assert off["sigmas"] > 300.0
    assert told["contradiction_p"] == 0.0
    assert told["free_parameters"][STIFFNESS]["uncertainty"] > 0.0
    refit = CliRunner().invoke(command, [*half, "--refit"]).stdout
    assert "(its values are fitted)" in refit
    assert "as it stands" not in refit
    words = [folder, "--model", "rig_elastic", "--fixed", "torsional_rigidity_nmm2=62.56"]
    said = " ".join(CliRunner().invoke(command, words).stdout.split())
    assert "against the model rig_elastic, its values as they stand" in said
    assert "fixed: torsional_rigidity_nmm2 = 62.56 N·mm²" in said
    assert "; the model says " in said


def test_the_command_says_what_fixed_takes(tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tmp_path), "--fixed", "friction"])
    assert isinstance(result.exception, BadInput)
    assert "--fixed friction: give NAME=VALUE" in str(result.exception)


def test_python_holds_a_set_by_its_name() -> None:
    found = nr.compare(dataset(ELASTIC), "rig_rigid", free=[FRICTION])
    rows = found.parameters()
    assert rows["parameter"].tolist() == [FRICTION, TORSIONAL_RIGIDITY]
    assert np.isnan(rows["model_sigma"]).all()
    assert rows["model"].tolist() == pytest.approx([0.0996, 62.56], rel=0.01)
    assert found.table()["rmse"] / found.table()["noise"] == pytest.approx(
        found.table()["in_noise_units"], rel=1e-9
    )


def test_data_that_the_model_was_fitted_to_are_no_test_of_it() -> None:
    known = dataclasses.replace(model(), history=(HistoryEntry(dataset="hidden", date="2026-11-27"),))
    assert LEARNT_HERE in compared(held().baseline, known).notes
    assert LEARNT_HERE not in held().notes


def test_the_trial_with_the_worst_place_is_drawn_first_and_those_left_out_are_counted() -> None:
    found = held(STIFFNESS, 0.5)
    assert found.held is not None
    figure = traces(found)
    assert figure.axes[0].get_title().startswith(Path(found.held.worst[0].trial).name)
    told = [float(axis.get_title().split("worst place ")[1].split(" σ")[0]) for axis in figure.axes[:2]]
    assert told[0] == round(found.held.worst[0].sigmas) >= told[1]
    assert figure.get_suptitle().endswith("4 of 5 trials, those of the worst places first; 1 left out")


def test_the_scale_of_the_map_is_the_same_for_all_data() -> None:
    scales = [residual_map(held(STIFFNESS, factor)).axes[0].images[0].get_clim() for factor in (0.5, 1.0)]
    assert scales[0] == scales[1] == (0.5, 100.0)


@pytest.mark.parametrize(("motions", "names"), [(3, 3), (22, 22), (300, 34)])
def test_the_names_below_the_map_stand_apart_and_each_motion_has_one(motions: int, names: int) -> None:
    one = held(STIFFNESS, 0.5)
    assert one.held is not None
    place = one.held.places[0]
    many = [
        dataclasses.replace(place, motion=f"overshoot_{k}", state=state)
        for k in range(motions)
        for state in ("moving", "settled")
    ]
    figure = residual_map(dataclasses.replace(one, held=dataclasses.replace(one.held, places=tuple(many))))
    figure.draw_without_rendering()
    labels = figure.axes[0].get_xticklabels()
    assert len({label.get_text() for label in labels}) == len(labels) == names
    boxes = [label.get_window_extent() for label in labels]
    assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
    assert figure.axes[0].images[0].get_size() == (1, 2 * motions)


@pytest.mark.whole
def test_a_diagnosis_says_whether_values_fail_before_it_speaks_of_the_structure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Question, "library", lambda *_: few("tissue_elasticity", "torque_bias"))
    folder = str(write_dataset(dataset(ELASTIC), tmp_path / "data"))
    half, right = tmp_path / "half.yaml", tmp_path / "right.yaml"
    save_model(half, model(STIFFNESS, 0.5))
    save_model(right, model())
    words = [folder, "--quick", "--jobs", "1", "--model"]
    lines = CliRunner().invoke(diagnose_command, [*words, str(half)]).stdout
    said = " ".join(lines.split())
    values = said.index("its values as they stand leave")
    off = said.index(f"contradict these data (p < 1e-09, limit 0.001): {STIFFNESS} is off by")
    assert values < off < said.index("structure: nothing is missing")
    assert f"needle-rig identify {folder} --model {half} --out MODEL.yaml" in lines
    result = CliRunner().invoke(diagnose_command, [*words, str(right), "--json"])
    told = json.loads(result.stdout)["model_values"]
    assert not told["contradict"]
    assert "the model's values hold on these data" in told["sentences"][0]


def test_what_the_structure_lacks_may_be_what_moves_the_values() -> None:
    found = compare(dataset(ELASTIC), few(), SavedModel(load_parameters("rig_rigid"), "null"))
    *_, last = found.verdict_on_values(structure_holds=False)
    assert last == "what the structure lacks may be what moves these values: see to that first"
    assert last not in found.verdict_on_values(structure_holds=True)


def test_each_error_of_the_ladder_has_a_floor_of_its_kind() -> None:
    baseline = held().baseline
    errors = errors_by_channel(baseline, baseline.current, baseline.validation)
    for name, of in errors.items():
        told = [of.training_after, of.training_floor, of.held_out_after, of.floor]
        training, training_floor, left_out, floor = (known(value) for value in told)
        assert 0.6 < training / training_floor < 1.1, name
        assert 0.6 < left_out / floor < 1.4, name
        assert training_floor < 0.8 * floor or name == IN_NOISE_UNITS, name


@pytest.mark.parametrize(
    ("value", "uncertainty", "text"),
    [
        (62.5531, 0.0297, "62.553 ± 0.030"),
        (0.35027, 0.00021, "0.35027 ± 0.00021"),
        (123.4, 56.0, "123 ± 56"),
        (0.1, None, "0.1"),
        (np.inf, 0.1, "inf ± 0.1"),
    ],
)
def test_a_value_has_the_digits_of_its_uncertainty(
    value: float, uncertainty: float | None, text: str
) -> None:
    assert with_uncertainty(value, uncertainty) == text
