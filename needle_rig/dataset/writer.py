"""Datasets to disk, in the format that `read_dataset` reads."""

from __future__ import annotations

import ast
import math
import os
from pathlib import Path

import numpy as np

from needle_rig.config.places import show_path, write_yaml
from needle_rig.dataset.description import FORMAT, MODULUS_GPA
from needle_rig.dataset.records import Dataset, DatasetTrial, Needle
from needle_rig.errors import BadInput
from needle_rig.physics.machine import NEEDLE
from needle_rig.records import JsonObject


def vacant(folder: str | os.PathLike[str]) -> Path:
    """`folder`, which holds no dataset yet. Raises BadInput."""
    target = Path(folder)
    if os.path.lexists(target / "dataset.yaml"):
        raise BadInput(
            f"{show_path(target)}: holds a dataset already; name another folder or remove it first"
        )
    return target


def write_dataset(dataset: Dataset, folder: str | os.PathLike[str]) -> Path:
    """Write `dataset.yaml` and one CSV a trial below `folder`, which must not hold a dataset yet.

    Angles are written to 0.0001°, torques to 1e-6 N·mm; missing samples are empty fields. Raises BadInput.
    """
    target = vacant(folder)
    (target / "trials").mkdir(parents=True, exist_ok=True)
    layout, needle = dataset.layout, dataset.needle
    trials: list[JsonObject] = []
    for number, trial in enumerate(dataset.trials, start=1):
        file = f"trials/{number:02d}.csv"
        (target / file).write_text(_csv(trial, dataset.sensor_names), encoding="utf-8")
        told: JsonObject = {"file": file, "start_s": round(trial.trial.start_s, 3)}
        if trial.start != "relaxed":
            told["start"] = trial.start
        if trial.turns_before_rad:
            told["turns_before_deg"] = [round(math.degrees(turn), 4) for turn in trial.turns_before_rad]
        if trial.turns_before_s:
            told["turns_before_s"] = [round(came_s, 6) for came_s in trial.turns_before_s]
        trials.append(told | trial.command.file_keys() | _other_keys(trial))
    rigidity_nmm2 = _tidy(needle.torsional_rigidity_nm2 * 1e6)
    segments = [
        {
            "from_mm": _tidy(a * 1e3),
            "to_mm": _tidy(b * 1e3),
            "torsional_rigidity_nmm2": rigidity_nmm2 * relative,
        }
        for a, b, relative in layout.segments
    ]
    described = {
        "format": FORMAT,
        "name": dataset.name,
        **({"simulated": True} if dataset.simulated else {}),
        "rig": {
            **({} if dataset.machine == NEEDLE else {"machine": dataset.machine}),
            **({} if dataset.lever_m is None else {"lever_mm": _tidy(dataset.lever_m * 1e3)}),
            "needle": _constants(needle),
            "tissue_sections_mm": [[_tidy(a * 1e3), _tidy(b * 1e3)] for a, b in layout.tissue_sections_m],
            "needle_length_mm": _tidy(layout.needle_length_m * 1e3),
            **({"segments": segments} if segments else {}),
            **({"tip": "clamped"} if layout.tip_clamped else {}),
            "hall_sensors": [
                {"name": name, "position_mm": _tidy(at * 1e3)}
                for name, at in zip(dataset.sensor_names, layout.sensor_positions_m, strict=True)
            ],
        },
        "trials": trials,
    }
    (target / "dataset.yaml").write_text(write_yaml(described), encoding="utf-8")
    return target


def _other_keys(trial: DatasetTrial) -> JsonObject:
    """Further keys of the command, from how they were written."""
    keys: JsonObject = {}
    for name, written in trial.command.other:
        try:
            keys[name] = ast.literal_eval(written)
        except (ValueError, SyntaxError):
            keys[name] = written
    return keys


def _constants(needle: Needle) -> JsonObject:
    """The needle as files state it: a rigidity that no wire of its diameter has stands as it is."""
    if not needle.rigidity_is_known:
        return {"torsional_rigidity_nmm2": "unknown"}
    modulus_gpa = _tidy(needle.shear_modulus_pa * 1e-9)
    constants: JsonObject = {
        "diameter_mm": _tidy(needle.diameter_m * 1e3),
        "shear_modulus_gpa": modulus_gpa,
        "density_g_cm3": _tidy(needle.density_kg_m3 * 1e-3),
    }
    if not MODULUS_GPA[0] < modulus_gpa <= MODULUS_GPA[1]:
        constants = {"torsional_rigidity_nmm2": _tidy(needle.torsional_rigidity_nm2 * 1e6)}
    if needle.rigidity_sigma != 0.02:
        constants["uncertainty_percent"] = _tidy(needle.rigidity_sigma * 100.0)
    return constants


def _csv(trial: DatasetTrial, sensors: tuple[str, ...]) -> str:
    tip_nm = trial.trial.tip_torque_nm
    loaded = [] if tip_nm is None else ["tip_torque_nmm"]
    header = ",".join(
        ["time_s", "base_angle_deg", "base_torque_nmm", *(f"{s}_deg" for s in sensors), *loaded, "phase"]
    )
    columns = [_texts(trial.trial.time_s, 5), _texts(np.degrees(trial.base_measured_rad), 4)]
    columns.append(_texts(trial.torque_nm * 1e3, 6))
    columns.extend(_texts(np.degrees(trial.hall_rad[:, k]), 4) for k in range(len(sensors)))
    if tip_nm is not None:
        columns.append(_texts(tip_nm * 1e3, 6))
    columns.append(trial.phase.tolist())
    return "\n".join([header, *map(",".join, zip(*columns, strict=True)), ""])


def _texts(values: np.ndarray, decimals: int) -> list[str]:
    return ["" if v != v else f"{v:.{decimals}f}" for v in values.tolist()]


def _tidy(value: float) -> float:
    return float(f"{value:.10g}")
