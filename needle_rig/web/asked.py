"""What the page asks, checked: each field has a type and a range, and each refusal is a sentence."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from needle_rig.control.ranges import MOST_DEG
from needle_rig.errors import BadInput

TARGETS = 8
SEEDS = 10
DATA = 50
"""Runs of one question."""
_SHOWN_LETTERS = 60

Key = Annotated[str, Field(max_length=400)]
Angle = Annotated[float, Field(ge=-MOST_DEG, le=MOST_DEG)]


class Asked(BaseModel):
    """Refuses what it does not know, and `true` or `"45"` where a number stands."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


Text = Annotated[str, Field(max_length=200)]
Number = Annotated[float, Field(ge=-1e12, le=1e12)]
Values = Annotated[list[Number | None], Field(max_length=20_000)]
Look = Literal["line", "dashed", "dots", "edge"]


class ChartSeries(Asked):
    """What a line of a chart is called, and how it looks."""

    label: Text
    look: Look


class Chart(Asked):
    """A chart as the page drew it: `shared` values along x or none, then y, or x and y, of `each` series."""

    title: Text
    x: Text
    y: Text
    series: Annotated[list[ChartSeries], Field(min_length=1, max_length=40)]
    bands: Annotated[list[tuple[int, int]], Field(max_length=40)] = []
    """Upper and lower edge, by number of the series from 1."""
    level: Number | None = None
    shared: Values | None
    each: list[Annotated[list[Values], Field(min_length=1, max_length=2)]]

    @model_validator(mode="after")
    def _whole(self) -> Self:
        """Every series has its values, as many along as up."""
        count = 1 if self.shared is not None else 2
        if [len(one) for one in self.each] != [count] * len(self.series):
            raise ValueError("the chart has not the values of its series")
        for one in self.each:
            along = one[0] if self.shared is None else self.shared
            if len(along) != len(one[-1]):
                raise ValueError("the chart has not as many values along as up")
        if any(not 1 <= edge <= len(self.series) for band in self.bands for edge in band):
            raise ValueError("the chart has a band without edges")
        return self


class Work(Asked):
    """A computation. Which of the fields count depends on its kind."""

    kind: Annotated[str, Field(max_length=40)]
    data: Annotated[list[Key], Field(max_length=DATA)] = []
    model: Key | None = None
    quick: bool = False
    refit: Any = None
    fixed: Any = None
    free: Any = None
    """These three are checked by the record of the comparison."""
    diagnosis: Key | None = None
    chosen: Annotated[list[Key], Field(max_length=DATA)] = []
    learnt: Key | None = None
    effect: Key | None = None
    compared: Key | None = None
    what: Key | None = None
    form: Key | None = None
    upload: Key | None = None
    mapping: dict[str, Any] | None = None
    layout: Annotated[str, Field(max_length=64 << 10)] | None = None
    layout_of: Key | None = None
    machine: Key | None = None
    targets_deg: Annotated[list[Angle], Field(min_length=1, max_length=TARGETS)] | None = None
    seeds: Annotated[int, Field(ge=1, le=SEEDS)] | None = None
    parameters: Key | None = None
    chart: Chart | None = None


class RigModel(Asked):
    """The model that orders plan with where they name none; None is that of the rig file."""

    model: Key | None


class Lesson(Asked):
    """An effect in the standard trial."""

    effect: Key
    values: dict[Annotated[str, Field(max_length=80)], Annotated[float, Field(ge=-1e12, le=1e12)]]
    data: Key | None = None


SENTENCES = {
    "kind": "this is no computation that the page knows",
    "data": "no data was chosen; choose a dataset, or runs",
    "targets_deg": f"targets: give 1 to {TARGETS} angles in degrees, up to {MOST_DEG:g}",
    "seeds": f"give 1 to {SEEDS} runs of each kind",
    "values": "values: give a number for each parameter",
}
"""What is said of a field where pydantic's own words would not help."""

Kind = TypeVar("Kind", bound=Asked)


def read(kind: type[Kind], content: bytes) -> Kind:
    """The JSON object of a request. Raises BadInput."""
    try:
        return kind.model_validate_json(content or b"{}")
    except (ValidationError, RecursionError, OverflowError) as error:
        first = error.errors(include_url=False)[0] if isinstance(error, ValidationError) else None
    if first is None or first["type"] == "json_invalid" or not first["loc"]:
        raise BadInput("the request is no JSON object")
    field = str(first["loc"][0])
    said = SENTENCES.get(field) or f"{field[:_SHOWN_LETTERS]}: {first['msg'].lower()}"
    raise BadInput(said)
