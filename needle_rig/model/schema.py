"""What stands in a parameter set and in a model file; units are in the keys."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag

from needle_rig.config.schema import Section

MODEL_FORMAT = "needle-rig-model/1"
PARAMETERS_FORMAT = "needle-rig-parameters/1"

Number = Annotated[float, Field(allow_inf_nan=True)]
EffectValues = dict[str, dict[str, Number | tuple[Number, ...]]]


class KarnoppSection(Section):
    """Karnopp's friction as the paper states it: for the explicit reference scheme only."""

    static_nmm_per_100mm: Annotated[float, Field(ge=0)]
    damping_nmms_per_rad_per_100mm: Annotated[float, Field(ge=0)]


class ParameterSet(Section):
    """A published set of numbers."""

    format: Literal["needle-rig-parameters/1"]
    name: str
    title: str
    source: str
    reproduces: tuple[str, ...]
    does_not_reproduce: tuple[str, ...]
    solver: Literal["rod", "explicit_karnopp"] = "rod"
    torsional_rigidity_nmm2: Annotated[float, Field(gt=0)]
    friction_nmm_per_100mm: Annotated[float, Field(ge=0)] | None = None
    karnopp: KarnoppSection | None = None
    effects: EffectValues = Field(default_factory=dict)


class FittedValue(Section):
    """A value with its standard uncertainty, in the unit that its name ends in."""

    value: Number
    uncertainty: Annotated[float, Field(ge=0)] | None = None
    unit: str = ""


class FittedList(Section):
    """One value for each sensor or section, with their uncertainties."""

    value: tuple[Number, ...]
    uncertainty: tuple[Annotated[float, Field(ge=0)] | None, ...] | None = None
    unit: str = ""


def _one_or_several(entry: Any) -> str:
    value = entry.get("value") if isinstance(entry, dict) else getattr(entry, "value", None)
    return "several" if isinstance(value, list | tuple) else "one"


Fitted = Annotated[
    Annotated[FittedValue, Tag("one")] | Annotated[FittedList, Tag("several")], Discriminator(_one_or_several)
]


class LayoutOfModel(Section):
    """Where the needle runs through tissue and where it is seen."""

    needle_length_mm: Annotated[float, Field(gt=0)]
    tissue_sections_mm: tuple[tuple[float, float], ...]
    sensor_positions_mm: tuple[float, ...]
    segments: tuple[tuple[float, float, float], ...] = ()
    """Start and end in mm, torsional rigidity over the needle's."""
    tip_clamped: bool = False


class ChannelErrors(Section):
    """Root-mean-square error of one channel, in the unit of its name, and the floors that noise sets.

    A trial that is fitted has a friction of its own; of one that is left out the scatter of friction counts.
    """

    training_before: float | None = None
    training_after: float | None = None
    held_out_before: float | None = None
    held_out_after: float | None = None
    training_floor: float | None = None
    floor: float | None = None
    """Of `held_out`."""


class HistoryEntry(Section):
    """One step of learning: what was added (or taken away), from which dataset, and what it bought."""

    added: tuple[str, ...] = ()
    removed: tuple[str, ...] = ()
    dataset: str
    date: str
    errors: dict[str, ChannelErrors] = Field(default_factory=dict)
    values_before: dict[str, Number] = Field(default_factory=dict)
    """Every parameter before the step, by name: what taking the step back restores."""
    note: str = ""


class Correlation(Section):
    """What the uncertainties of two parameters have in common."""

    of: tuple[str, str]
    value: Annotated[float, Field(ge=-1, le=1)]


class ModelFile(Section):
    """A model file as it stands on disk."""

    format: Literal["needle-rig-model/1"]
    written_by: str = ""
    """Version of needle-rig."""
    name: str
    starts_from: str
    torque_scale: Annotated[float, Field(gt=0)] = 1.0
    layout: LayoutOfModel
    base: dict[str, FittedValue]
    effects: dict[str, dict[str, Fitted]] = Field(default_factory=dict)
    correlations: tuple[Correlation, ...] = ()
    history: tuple[HistoryEntry, ...] = ()
