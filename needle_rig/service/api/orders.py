"""What may be asked of the daemon: every order with its strict types and ranges."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from needle_rig.control.ranges import (
    FASTEST_DEG_S,
    MOST_DEG,
    MOST_MOTIONS,
    SETTLE_S,
    SLOWEST_DEG_S,
    check_option,
)
from needle_rig.errors import BadInput

OPTIONS = 16
MODEL_LETTERS = 40_000
"""Of a model file in an order; one with five effects and ten steps of history has 12,000."""
_SHOWN_LETTERS = 60

Angle = Annotated[float, Field(ge=-MOST_DEG, le=MOST_DEG)]
Speed = Annotated[float, Field(ge=SLOWEST_DEG_S, le=FASTEST_DEG_S)]
Name = Annotated[str, Field(pattern=r"^[a-z0-9_]{1,64}$")]
Line = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f]*$")]
Number = Annotated[float, Field(ge=-MOST_DEG, le=MOST_DEG)]
Whole = Annotated[int, Field(ge=-MOST_DEG, le=MOST_DEG)]
Option = bool | Whole | Number | Name | Annotated[list[Number | None], Field(max_length=MOST_MOTIONS)] | None


class Model(BaseModel):
    """Refuses what it does not know, and `true` or `"45"` where a number stands."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Order(Model):
    """A sequence that aligns the needle. `options` are the strategy's own, by name.

    `model` is the text of a model file that this run plans with, in the place of the daemon's own.
    """

    target_deg: Angle
    strategy: Name = "reed2008"
    options: Annotated[dict[Name, Option], Field(max_length=OPTIONS)] = {}
    settle_s: Annotated[float, Field(ge=SETTLE_S[0], le=SETTLE_S[1])] | None = None
    speed_deg_s: Speed | None = None
    lag_left_deg: Angle | None = None
    model: Annotated[str, Field(min_length=1, max_length=MODEL_LETTERS)] | None = None

    @model_validator(mode="after")
    def _options_end(self) -> Self:
        """Speeds and times among the options must let the run end; their names carry the unit."""
        for name, value in self.options.items():
            if not isinstance(value, str):
                check_option(name, value)
        return self


class Jog(Model):
    """A turn of the base, by an angle or to one."""

    by_deg: Angle | None = None
    to_deg: Angle | None = None
    speed_deg_s: Speed | None = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Self:
        if (self.by_deg is None) == (self.to_deg is None):
            raise ValueError("give either by_deg or to_deg")
        return self


class Home(Model):
    """Finds the base's zero, or turns to it: `here` says what angle the base has now."""

    by: Literal["angle", "hall", "index", "here"] = "angle"
    angle_deg: Angle = 0.0
    speed_deg_s: Speed | None = None


class Reason(Model):
    """Why the drive is stopped, for the record."""

    reason: Line = "stopped by a person"


class Holder(Model):
    """Who wants to command the rig, in words for those who find it taken."""

    holder: Line


class Nothing(Model):
    """No content."""


MODELS: dict[str, type[Model]] = {
    "compensate": Order,
    "jog": Jog,
    "home": Home,
    "hold": Nothing,
    "release": Nothing,
    "stop": Reason,
    "clear": Nothing,
    "take_lease": Holder,
    "return_lease": Nothing,
    "state": Nothing,
}
"""What each order carries."""


def read_order(name: str, content: bytes | Mapping[str, Any]) -> Model:
    """The order from its JSON text (an empty one stands for `{}`) or its document; raises BadInput."""
    model = MODELS[name]
    try:
        if isinstance(content, bytes):
            return model.model_validate_json(content or b"{}")
        return model.model_validate(content)
    except ValidationError as error:
        raise BadInput(_complaint(error)) from None


def _complaint(error: ValidationError) -> str:
    first = error.errors(include_url=False)[0]
    if first["type"] == "value_error":
        return str(first["ctx"]["error"])
    shown = repr(first["input"])
    shown = shown if len(shown) <= _SHOWN_LETTERS else f"{shown[:_SHOWN_LETTERS]}…"
    if first["loc"][:1] == ("options",) and len(first["loc"]) > 1:
        option = str(first["loc"][1])[:_SHOWN_LETTERS]
        return (
            f"option {option!r}: is {shown}; give a number within ±{MOST_DEG:g}, true, false, null, a name"
            f" of small letters, or up to {MOST_MOTIONS} numbers"
        )
    place = ".".join(str(part) for part in first["loc"])[:_SHOWN_LETTERS] or "the request"
    limits = first.get("ctx", {})
    if "le" in limits:
        return f"{place}: {shown} is above {limits['le']:g}; give {limits['le']:g} at most"
    if "ge" in limits:
        return f"{place}: {shown} is below {limits['ge']:g}; give {limits['ge']:g} at least"
    return f"{place}: {first['msg'].lower()}, not {shown}"
