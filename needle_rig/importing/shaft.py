"""What the shaft looks like: ten lines of YAML, a dataset, a mapping or a rig file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from pathlib import Path

from needle_rig.config.check import validate
from needle_rig.config.file_kinds import as_read_here
from needle_rig.config.loader import load_rig_config
from needle_rig.config.places import read_yaml, show_path
from needle_rig.dataset.description import NeedlePart, RigPart, SensorPart, layout_of
from needle_rig.errors import BadInput
from needle_rig.physics.machine import MachineName

RIG_FORMATS = ("needle-rig/1", "needle-rig-dataset/1", "needle-rig-settled/1", "needle-rig-import/1")
"""A rig file, and those that tell the shaft below `rig`."""
LINE_MM = 100.0
"""Of a machine that is no needle. Only friction over rigidity shows, so any length serves; with this one
friction per 100 mm is that of the whole machine."""


def read_rig(path: Path) -> RigPart:
    """The shaft in a file with the keys of `rig` in dataset.yaml, alone or below `rig`. Raises BadInput."""
    file = path / "dataset.yaml" if os.path.isdir(path) else path
    if not os.path.lexists(file):
        raise BadInput(f"{show_path(file)}: there is no such layout; name a YAML file or a dataset")
    data, places = read_yaml(file)
    if "format" in data:
        data = as_read_here(data, places, *RIG_FORMATS)
        if data["format"] == RIG_FORMATS[0]:
            return _of_rig_file(file)
    if "rig" in data:
        inside, inner = data["rig"], ("rig",)
        if not isinstance(inside, dict):
            raise places.error(
                inner, "is no mapping; write needle, needle_length_mm, tissue_sections_mm, hall_sensors"
            )
        data = inside
    rig = validate(RigPart, data, places)
    for part in (rig, rig.needle, *rig.segments):
        for key in part.model_extra or {}:
            raise places.error((), f"{key}: unknown key of a layout; remove it")
    layout_of(rig, places)
    return rig


def line_of(name: MachineName, sensors: Sequence[str]) -> RigPart:
    """A layout that fits a machine: a line of unknown rigidity that rubs all along, angles at its far end."""
    return RigPart(
        machine=name,
        needle=NeedlePart(torsional_rigidity_nmm2="unknown"),
        tissue_sections_mm=((0.0, LINE_MM),),
        needle_length_mm=LINE_MM,
        hall_sensors=tuple(SensorPart(name=sensor, position_mm=LINE_MM) for sensor in sensors),
    )


def _of_rig_file(path: Path) -> RigPart:
    config = load_rig_config(path)
    needle, layout = config.needle, config.layout
    modulus_gpa = needle.shear_modulus_gpa
    if needle.torsional_rigidity_nmm2 is not None:
        modulus_gpa = needle.torsional_rigidity_nmm2 * 1e-3 / (math.pi * needle.diameter_mm**4 / 32.0)
    return RigPart(
        needle=NeedlePart(
            diameter_mm=needle.diameter_mm, shear_modulus_gpa=modulus_gpa, density_g_cm3=needle.density_g_cm3
        ),
        needle_length_mm=needle.length_mm,
        tissue_sections_mm=layout.tissue_sections_mm,
        hall_sensors=tuple(SensorPart(name=s.name, position_mm=s.position_mm) for s in layout.hall_sensors),
    )
