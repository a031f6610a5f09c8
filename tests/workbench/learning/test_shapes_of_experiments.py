"""Any subset of channels, at rates of their own, is compared, explained and saved."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from needle_rig.dataset import Dataset, read_dataset, write_dataset
from needle_rig.model.files import model_mapping
from needle_rig.workbench.learning.adopt import adopt
from needle_rig.workbench.learning.observations import Traces
from tests.workbench.hidden import dataset, effect, few

STIFFNESS = 0.45
ELASTIC = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=STIFFNESS)


def seen(data: Dataset, torque: bool = True, halls: Sequence[int] = (0, 1, 2, 3), every: int = 1) -> Dataset:
    """The dataset with the torque or without, of the angles those named, each `every` samples."""
    trials = []
    for trial in data.trials:
        hall = np.full_like(trial.hall_rad, np.nan)
        hall[::every, list(halls)] = trial.hall_rad[::every, list(halls)]
        moment = trial.torque_nm if torque else np.full_like(trial.torque_nm, np.nan)
        trials.append(dataclasses.replace(trial, torque_nm=moment, hall_rad=hall))
    return dataclasses.replace(data, trials=tuple(trials))


SHAPES: dict[str, dict[str, Any]] = {
    "torque alone": {"halls": ()},
    "tip alone": {"torque": False, "halls": (3,)},
    "a slow camera": {"halls": (3,), "every": 5},
}


@pytest.mark.parametrize("shape", SHAPES)
def test_any_subset_of_channels_is_compared_and_its_effect_adopted(shape: str) -> None:
    given = Traces(seen(dataset(ELASTIC), **SHAPES[shape]))
    found = given.compare(few(), None)
    assert found.held_out_error > 5.0
    assert "NaN" not in json.dumps(found.as_json())
    saved = adopt(given, "tissue_elasticity", few())
    fitted = saved.model.values()["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"]
    ratio = fitted / saved.model.values()["friction_nmm_per_100mm"]
    # angles alone tell no torque: stiffness over friction is what they have in common
    assert ratio == pytest.approx(STIFFNESS / 0.1, rel=0.06)
    errors = saved.history[-1].errors
    assert all(np.isfinite(v) for e in errors.values() for v in e.model_dump().values() if v is not None)
    json.dumps(model_mapping(saved), allow_nan=False)


def test_an_unknown_rigidity_is_learnt_from_torque_over_twist(tmp_path: Path) -> None:
    folder = write_dataset(dataset(seed=3), tmp_path / "data")
    described = folder / "dataset.yaml"
    told = yaml.safe_load(described.read_text())
    told["rig"]["needle"] = {"torsional_rigidity_nmm2": "unknown"}
    described.write_text(yaml.safe_dump(told))
    data = read_dataset(folder)
    note = next(n for n in data.notes if "rigidity is unknown" in n)
    assert "cannot be told apart" in note
    found = Traces(data).compare(few(), None)
    assert found.free_parameters["torsional_rigidity_nmm2"]["value"] == pytest.approx(62.56, rel=0.02)
    assert found.held_out_error < 1.2
    again = read_dataset(write_dataset(data, tmp_path / "again"))
    assert not again.needle.rigidity_is_known
