"""dataset.yaml: what a dataset says of its rig and its trials, checked where it is written."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from needle_rig.config.check import validate
from needle_rig.config.places import Places, read_yaml
from needle_rig.dataset.records import Needle, Start, TrialCommand
from needle_rig.errors import BadInput
from needle_rig.physics.rod import Layout

FORMAT = "needle-rig-dataset/1"


class _Part(BaseModel):
    """Keys of other programs are kept and named, never refused."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)


class NeedlePart(_Part):
    """The needle's stated constants."""

    diameter_mm: Annotated[float, Field(gt=0.02, le=10)]
    shear_modulus_gpa: Annotated[float, Field(gt=0.5, le=500)]
    density_g_cm3: Annotated[float, Field(gt=0.5, le=25)] = 6.45
    uncertainty_percent: Annotated[float, Field(ge=0, le=100)] | None = None


class SensorPart(_Part):
    """One Hall sensor."""

    name: str
    position_mm: Annotated[float, Field(ge=0)]


class RigPart(_Part):
    """The rig: its needle and what lies where along it."""

    needle: NeedlePart
    tissue_sections_mm: tuple[tuple[float, float], ...]
    needle_length_mm: Annotated[float, Field(gt=0)]
    hall_sensors: tuple[SensorPart, ...]


class TrialPart(_Part):
    """One trial: its file and what the rig was told."""

    file: str
    start_s: float | None = None
    start: Start = "relaxed"
    kind: str = "unknown"
    target_deg: float | None = None
    speed_deg_s: Annotated[float, Field(gt=0)] | None = None
    settle_s: Annotated[float, Field(ge=0)] | None = None
    steps_deg: tuple[float, ...] = ()

    def command(self) -> TrialCommand:
        """What the rig was told, without what is this trial's own."""
        other = tuple(sorted((k, repr(v)) for k, v in (self.model_extra or {}).items()))
        return TrialCommand(
            self.kind, self.target_deg, self.speed_deg_s, self.settle_s, self.steps_deg, other
        )


class Description(_Part):
    """A whole dataset.yaml."""

    format: str
    name: str
    rig: RigPart
    trials: tuple[TrialPart, ...]


def read_description(folder: Path) -> tuple[Description, Places]:
    """dataset.yaml of `folder`, and where its parts stand. Raises BadInput."""
    data, places = read_yaml(folder / "dataset.yaml", inside=folder)
    if data.get("format") != FORMAT:
        raise places.error(("format",), f"{data.get('format')!r} is not {FORMAT}; convert the dataset to it")
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
    try:
        return Layout(
            needle_length_m=length / 1e3,
            tissue_sections_m=tuple((a / 1e3, b / 1e3) for a, b in rig.tissue_sections_mm),
            sensor_positions_m=tuple(s.position_mm / 1e3 for s in rig.hall_sensors),
        )
    except BadInput as error:
        raise places.error(("rig",), str(error)) from None


def needle_of(part: NeedlePart) -> Needle:
    """The needle in SI; its rigidity is known to 2 % unless the file says otherwise."""
    given = part.uncertainty_percent
    return Needle(
        diameter_m=part.diameter_mm * 1e-3,
        shear_modulus_pa=part.shear_modulus_gpa * 1e9,
        density_kg_m3=part.density_g_cm3 * 1e3,
        rigidity_sigma=0.02 if given is None else given / 100.0,
    )


def unknown_keys(description: Description, places: Places) -> list[str]:
    """A sentence for every key that this program does not know, outside of the trials."""
    notes: list[str] = []
    parts: list[tuple[tuple[str | int, ...], Any]] = [
        ((), description),
        (("rig",), description.rig),
        (("rig", "needle"), description.rig.needle),
    ]
    for path, part in parts:
        notes.extend(
            f"{places.of((*path, key), key=True)}: {key}: not used, this key is not known here"
            for key in part.model_extra or {}
        )
    return notes
