"""dataset.yaml: what a dataset says of its rig and its trials, checked where it is written."""

from __future__ import annotations

import difflib
import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from needle_rig.config.check import validate
from needle_rig.config.hints import meant_key
from needle_rig.config.places import DataPath, Places, read_yaml
from needle_rig.dataset.records import UNKNOWN_SIGMA, Needle, Start, TrialCommand
from needle_rig.errors import BadInput
from needle_rig.physics.machine import MachineName
from needle_rig.physics.rod import Layout

FORMAT = "needle-rig-dataset/1"
MODULUS_GPA = (0.5, 500.0)
"""Shear moduli of what shafts are made of, rubber to tungsten carbide."""
UNTOLD_NM2 = 62.56e-6
"""Stands for a rigidity that neither a file nor torque and angles tell: that of the shipped needle."""


KINDS = ("compensate", "staircase", "unknown")
"""Of trials: the two that protocols have, and what nobody told; a run's is its strategy."""
MOST_TURNS = 1000
"""Turning points before a trial: friction remembers a few, each of which takes the model six steps."""


class _Part(BaseModel):
    """Keys of other programs are kept and named, never refused."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)


class NeedlePart(_Part):
    """The needle's stated constants: diameter and shear modulus, or torsional rigidity, or that unknown."""

    diameter_mm: Annotated[float, Field(gt=0.02, le=200)] | None = None
    shear_modulus_gpa: Annotated[float, Field(gt=MODULUS_GPA[0], le=MODULUS_GPA[1])] | None = None
    torsional_rigidity_nmm2: Annotated[float, Field(gt=0)] | Literal["unknown"] | None = None
    density_g_cm3: Annotated[float, Field(gt=0.5, le=25)] = 6.45
    uncertainty_percent: Annotated[float, Field(ge=0, le=100)] | None = None


class SegmentPart(_Part):
    """A stretch that is not like the needle: another diameter, a tube, or a rigidity of its own."""

    from_mm: Annotated[float, Field(ge=0)]
    to_mm: Annotated[float, Field(gt=0)]
    diameter_mm: Annotated[float, Field(gt=0.02, le=200)] | None = None
    inner_diameter_mm: Annotated[float, Field(ge=0, le=200)] = 0.0
    shear_modulus_gpa: Annotated[float, Field(gt=MODULUS_GPA[0], le=MODULUS_GPA[1])] | None = None
    torsional_rigidity_nmm2: Annotated[float, Field(gt=0)] | None = None


class SensorPart(_Part):
    """One Hall sensor."""

    name: str
    position_mm: Annotated[float, Field(ge=0)]


class RigPart(_Part):
    """The rig: its needle, or the line of another machine, and what lies where along it."""

    machine: MachineName = "needle"
    needle: NeedlePart
    tissue_sections_mm: tuple[tuple[float, float], ...]
    needle_length_mm: Annotated[float, Field(gt=0)]
    segments: tuple[SegmentPart, ...] = ()
    hall_sensors: tuple[SensorPart, ...] = ()
    tip: Literal["free", "clamped"] = "free"
    lever_mm: Annotated[float, Field(gt=0)] | None = None
    """Of a linear axis, the radius that makes its mm and N angles and torques."""


class TrialPart(_Part):
    """One trial: its file and its command."""

    file: str
    start_s: float | None = None
    start: Start = "relaxed"
    turns_before_deg: Annotated[tuple[float, ...], Field(max_length=MOST_TURNS)] = ()
    turns_before_s: tuple[Annotated[float, Field(gt=0)], ...] = ()
    kind: str = "unknown"
    target_deg: float | None = None
    speed_deg_s: Annotated[float, Field(gt=0)] | None = None
    settle_s: Annotated[float, Field(ge=0)] | None = None
    steps_deg: tuple[float, ...] = ()

    def command(self) -> TrialCommand:
        """The command, without what is this trial's own."""
        other = tuple(sorted((k, repr(v)) for k, v in (self.model_extra or {}).items()))
        return TrialCommand(
            self.kind, self.target_deg, self.speed_deg_s, self.settle_s, self.steps_deg, other
        )


class Description(_Part):
    """A whole dataset.yaml."""

    format: Literal["needle-rig-dataset/1"]
    name: str
    simulated: bool = False
    rig: RigPart
    trials: tuple[TrialPart, ...]


def read_description(folder: Path) -> tuple[Description, Places]:
    """dataset.yaml of `folder`, and where its parts stand. Raises BadInput."""
    data, places = read_yaml(folder / "dataset.yaml", inside=folder)
    description = validate(Description, data, places)
    if not description.trials:
        raise places.error(("trials",), "no trial is listed; add at least one with its `file`")
    files: dict[str, int] = {}
    for place, part in enumerate(description.trials):
        if part.file in files:
            raise places.error(
                ("trials", place, "file"),
                f"{part.file} is listed twice, first as trial {files[part.file] + 1}; keep one",
            )
        files[part.file] = place
    names = [s.name for s in description.rig.hall_sensors]
    for name in names:
        if names.count(name) > 1:
            raise places.error(("rig", "hall_sensors"), f"two sensors are called {name}; rename one")
    return description, places


def layout_of(rig: RigPart, places: Places) -> Layout:
    """The layout in metres; sections and sensors must lie on the needle, in order. Raises BadInput."""
    length = rig.needle_length_mm
    last = 0.0
    for k, (start, stop) in enumerate(rig.tissue_sections_mm):
        path: tuple[str | int, ...] = ("rig", "tissue_sections_mm", k)
        if not start < stop:
            raise places.error(path, f"the section ends at {stop:g} mm, not after its start {start:g} mm")
        if start < last:
            raise places.error(path, f"starts at {start:g} mm, before {last:g} mm where the last one ends")
        if stop > length:
            raise places.error(path, f"ends at {stop:g} mm, beyond the needle's {length:g} mm")
        last = stop
    for k, sensor in enumerate(rig.hall_sensors):
        if sensor.position_mm > length:
            raise places.error(
                ("rig", "hall_sensors", k, "position_mm"),
                f"{sensor.position_mm:g} mm lies beyond the needle's {length:g} mm",
            )
    _check_needle(rig.needle, places)
    try:
        return Layout(
            needle_length_m=length / 1e3,
            tissue_sections_m=tuple((a / 1e3, b / 1e3) for a, b in rig.tissue_sections_mm),
            sensor_positions_m=tuple(s.position_mm / 1e3 for s in rig.hall_sensors),
            segments=tuple(_segment(rig, k, places) for k in range(len(rig.segments))),
            tip_clamped=rig.tip == "clamped",
        )
    except BadInput as error:
        raise places.error(("rig",), str(error)) from None


def lever_of(rig: RigPart) -> float | None:
    """The lever in metres; None where there is none."""
    return None if rig.lever_mm is None else rig.lever_mm * 1e-3


def _check_needle(part: NeedlePart, places: Places) -> None:
    """Raises BadInput where a rigidity is given twice, or only by half."""
    constants = [part.diameter_mm, part.shear_modulus_gpa]
    told = sum(x is not None for x in constants)
    if part.torsional_rigidity_nmm2 is None and told < 2:
        missing = "shear_modulus_gpa" if part.diameter_mm is not None else "diameter_mm"
        raise places.error(
            ("rig", "needle"),
            f"{missing} is missing; add it, or write torsional_rigidity_nmm2, a number or unknown",
        )
    if part.torsional_rigidity_nmm2 is not None and told:
        raise places.error(
            ("rig", "needle", "torsional_rigidity_nmm2"),
            "stands beside diameter_mm and shear_modulus_gpa, which tell the same; keep one",
        )


def _segment(rig: RigPart, number: int, places: Places) -> tuple[float, float, float]:
    """Start and end in metres, and rigidity over the needle's. Raises BadInput."""
    part, needle = rig.segments[number], rig.needle
    path = ("rig", "segments", number)
    modulus_gpa = part.shear_modulus_gpa or needle.shear_modulus_gpa
    if part.torsional_rigidity_nmm2 is not None and part.diameter_mm is None:
        rigidity_nmm2 = part.torsional_rigidity_nmm2
    elif part.diameter_mm is not None and part.torsional_rigidity_nmm2 is None and modulus_gpa is not None:
        if part.inner_diameter_mm >= part.diameter_mm:
            raise places.error(
                (*path, "inner_diameter_mm"),
                f"{part.inner_diameter_mm:g} mm is not below the outer diameter, {part.diameter_mm:g} mm",
            )
        polar_mm4 = math.pi / 32.0 * (part.diameter_mm**4 - part.inner_diameter_mm**4)
        rigidity_nmm2 = polar_mm4 * modulus_gpa * 1e3
    else:
        raise places.error(
            path,
            "its rigidity is not told once: write diameter_mm (with shear_modulus_gpa if the needle has none)"
            " or torsional_rigidity_nmm2",
        )
    if needle.torsional_rigidity_nmm2 == "unknown":
        raise places.error(
            path,
            "its rigidity is given and the needle's is unknown: write a rough one, with uncertainty_percent",
        )
    relative = rigidity_nmm2 * 1e-6 / needle_of(needle).torsional_rigidity_nm2
    return part.from_mm / 1e3, part.to_mm / 1e3, relative


def needle_of(part: NeedlePart) -> Needle:
    """The needle in SI; its rigidity is known to 2 % unless the file says otherwise.

    One that is unknown is that of the shipped needle until torque and angles tell it.
    """
    sigma = 0.02 if part.uncertainty_percent is None else part.uncertainty_percent / 100.0
    if part.torsional_rigidity_nmm2 == "unknown":
        return Needle.of_rigidity(UNTOLD_NM2, UNKNOWN_SIGMA)
    if part.torsional_rigidity_nmm2 is not None:
        return Needle.of_rigidity(part.torsional_rigidity_nmm2 * 1e-6, sigma)
    assert part.diameter_mm is not None
    assert part.shear_modulus_gpa is not None
    return Needle(
        diameter_m=part.diameter_mm * 1e-3,
        shear_modulus_pa=part.shear_modulus_gpa * 1e9,
        density_kg_m3=part.density_g_cm3 * 1e3,
        rigidity_sigma=sigma,
    )


def unknown_keys(description: Description, places: Places) -> list[str]:
    """A sentence for every key, and every kind of trial, that this program does not know."""
    rig = description.rig
    notes = _unknown(description, (), places)
    notes += _unknown(rig, ("rig",), places)
    notes += _unknown(rig.needle, ("rig", "needle"), places)
    for k, segment in enumerate(rig.segments):
        notes += _unknown(segment, ("rig", "segments", k), places)
    for k, sensor in enumerate(rig.hall_sensors):
        notes += _unknown(sensor, ("rig", "hall_sensors", k), places)
    for k, trial in enumerate(description.trials):
        notes += _unknown(trial, ("trials", k), places, "only tells its command from others")
        near = difflib.get_close_matches(trial.kind, KINDS, n=1)
        if near and near[0] != trial.kind:
            notes.append(
                f"{places.of(('trials', k, 'kind'))}: kind {trial.kind} makes another command than"
                f" {', '.join(KINDS)}; did you mean {near[0]}?"
            )
    return notes


def _unknown(part: _Part, path: DataPath, places: Places, used: str = "not used") -> list[str]:
    """A sentence for every key of a part that is not known, with the one that was meant."""
    found = []
    for key, value in (part.model_extra or {}).items():
        meant = meant_key(key, value, type(part).model_fields, part.model_fields_set)
        hint = f"; {meant[1]}" if meant else ""
        found.append(f"{places.of((*path, key), key=True)}: {key}: {used}, this key is not known here{hint}")
    return found
