"""Published numbers as data: what sensors showed when the motions of a sequence had settled; no traces.

format: needle-rig-settled/1
name: mine
source: where the numbers are published
zeroed_at_rest: true
rig: as in dataset.yaml
sequences:
  - strategy: reed2008
    target_deg: 45
    standard_errors: {tip_lag_deg: 2.2}
    settled:
      - {motion: final, tip_lag_deg: 12, hall_deg: [37.1, null, null, 33]}

Any number may be missing. One whose quantity has no standard error is shown beside the model and not weighed.
`hall_deg` stands for each sensor's angle, `tip_lag_deg` for base minus last sensor. Where a motion has
`base_deg`, the recorded base angle, the model is driven there; elsewhere to where the strategy takes it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from needle_rig.config.check import validate
from needle_rig.config.directories import config_directories
from needle_rig.config.places import Places, read_yaml, show_path
from needle_rig.config.schema import Section
from needle_rig.dataset.description import RigPart, layout_of, needle_of
from needle_rig.dataset.records import Needle
from needle_rig.errors import BadInput
from needle_rig.physics.rod import Layout

FORMAT = "needle-rig-settled/1"
FILE = "settled.yaml"

Angle = Annotated[float, Field(ge=-3600, le=3600)]
Torque = Annotated[float, Field(ge=-50, le=50)]
Quantity = Literal["torque_nmm", "hall_deg", "tip_lag_deg", "hall_mean_deg", "hall_range_deg"]


class _Motion(Section):
    motion: str
    base_deg: Angle | None = None
    torque_nmm: Torque | None = None
    hall_deg: tuple[Angle | None, ...] = ()
    tip_lag_deg: Angle | None = None
    hall_mean_deg: Angle | None = None
    hall_range_deg: Angle | None = None


class _Sequence(Section):
    strategy: str
    options: dict[str, float | tuple[float, ...]] = Field(default_factory=dict)
    target_deg: Angle
    speed_deg_s: Annotated[float, Field(gt=0, le=360)] = 45.0
    settle_s: Annotated[float, Field(ge=0, le=3600)] = 3.0
    standard_errors: dict[Quantity, Annotated[float, Field(gt=0, le=3600)]] = Field(default_factory=dict)
    settled: tuple[_Motion, ...]


class _File(Section):
    format: Literal["needle-rig-settled/1"]
    name: str
    source: str
    zeroed_at_rest: bool = False
    rig: RigPart
    sequences: tuple[_Sequence, ...]


@dataclass(frozen=True)
class Seen:
    """What a number is of: a quantity of one motion of one sequence; `sensor` counts from 0, for hall_deg."""

    sequence: int
    motion: str
    quantity: str
    sensor: int | None = None

    @property
    def unit(self) -> str:
        """As shown to a person."""
        return "N·mm" if self.quantity.endswith("_nmm") else "°"


@dataclass(frozen=True)
class SettledValue:
    """A reported number in the unit of its quantity; without a standard error it is not weighed."""

    of: Seen
    value: float
    standard_error: float | None


@dataclass(frozen=True)
class SettledSequence:
    """The command, and the standard errors of what it showed, in the unit of each quantity."""

    strategy: str
    options: Mapping[str, float | tuple[float, ...]]
    target_deg: float
    speed_deg_s: float
    settle_s: float
    standard_errors: Mapping[str, float]
    base_deg: Mapping[str, float]
    """Recorded base angles by motion."""
    place: str
    """File and line, for errors."""

    @property
    def title(self) -> str:
        """In words."""
        options = ", ".join(
            f"{k}={v:g}" if isinstance(v, float) else f"{k}={', '.join(f'{x:g}' for x in v)}"
            for k, v in self.options.items()
        )
        return self.strategy + (f" ({options})" if options else "")


@dataclass(frozen=True)
class SettledData:
    """Settled values of sequences on one rig."""

    name: str
    source: str
    layout: Layout
    sensor_names: tuple[str, ...]
    needle: Needle
    zeroed_at_rest: bool
    """Torque and Hall angles are read from where they stood before the first motion."""
    sequences: tuple[SettledSequence, ...]
    values: tuple[SettledValue, ...]

    @property
    def weighed(self) -> tuple[SettledValue, ...]:
        """Values with a standard error."""
        return tuple(v for v in self.values if v.standard_error is not None)

    def words(self, of: Seen) -> str:
        """What a number is of, in words."""
        names = {"torque_nmm": "torque", "tip_lag_deg": "tip lag"}
        names |= {"hall_mean_deg": "mean of the sensors", "hall_range_deg": "max − min of the sensors"}
        what = names[of.quantity] if of.sensor is None else self.sensor_names[of.sensor]
        return f"{self.sequences[of.sequence].title}, {of.motion}: {what}"


def is_settled(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a folder with settled values, or their file."""
    given = Path(path)
    return os.path.lexists(given / FILE) or (given.name == FILE and os.path.isfile(given))


def shipped_datasets() -> dict[str, Path]:
    """Datasets by name, the working folder's config/datasets before the shipped ones."""
    found: dict[str, Path] = {}
    for folder in config_directories():
        for path in sorted((folder / "datasets").glob("*/*.yaml")):
            found.setdefault(path.parent.name, path.parent)
    return found


def read_settled(path: str | os.PathLike[str]) -> SettledData:
    """The settled values in a folder. Raises BadInput with file and line."""
    given = Path(path)
    file = given if given.name == FILE else given / FILE
    if not os.path.lexists(file):
        raise BadInput(f"{show_path(given)}: has no {FILE}")
    data, places = read_yaml(file, inside=file.parent)
    read = validate(_File, data, places)
    for section, path_of in ((read.rig, ("rig",)), (read.rig.needle, ("rig", "needle"))):
        for key in section.model_extra or {}:
            raise places.error((*path_of, key), "unknown key; remove it")
    sensors = len(read.rig.hall_sensors)
    if not sensors:
        raise places.error(("rig", "hall_sensors"), "no sensor is listed; settled values need at least one")
    sequences, values = [], []
    for s, part in enumerate(read.sequences):
        sequences.append(
            SettledSequence(
                part.strategy,
                dict(part.options),
                part.target_deg,
                part.speed_deg_s,
                part.settle_s,
                {str(k): v for k, v in part.standard_errors.items()},
                {row.motion: row.base_deg for row in part.settled if row.base_deg is not None},
                places.of(("sequences", s, "strategy")),
            )
        )
        for m, row in enumerate(part.settled):
            values += _values(row, s, part.standard_errors, sensors, places, ("sequences", s, "settled", m))
    if not any(v.standard_error is not None for v in values):
        raise places.error(
            ("sequences",), "no number has a standard error; add standard_errors to a sequence"
        )
    twice = [v.of for i, v in enumerate(values) if v.of in [w.of for w in values[:i]]]
    if twice:
        raise places.error(
            ("sequences", twice[0].sequence, "settled"),
            f"{twice[0].quantity} of motion {twice[0].motion} is given twice; keep one",
        )
    return SettledData(
        read.name,
        read.source,
        layout_of(read.rig, places),
        tuple(x.name for x in read.rig.hall_sensors),
        needle_of(read.rig.needle),
        read.zeroed_at_rest,
        tuple(sequences),
        tuple(values),
    )


def _values(
    row: _Motion,
    sequence: int,
    errors: Mapping[Any, float],
    sensors: int,
    places: Places,
    path: tuple[str | int, ...],
) -> list[SettledValue]:
    found = []
    for quantity, value in row.model_dump(exclude={"motion", "base_deg", "hall_deg"}).items():
        if value is not None:
            of = Seen(sequence, row.motion, quantity)
            found.append(SettledValue(of, value, errors.get(quantity)))
    if row.hall_deg and len(row.hall_deg) != sensors:
        raise places.error(
            (*path, "hall_deg"),
            f"{len(row.hall_deg)} angles for {sensors} sensors; write null for a missing one",
        )
    for k, value in enumerate(row.hall_deg):
        if value is not None:
            of = Seen(sequence, row.motion, "hall_deg", k)
            found.append(SettledValue(of, value, errors.get("hall_deg")))
    return found
