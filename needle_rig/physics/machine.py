"""The kinds of machine that turn a line against friction, and which effects fit each.

An effect names the part that it acts in (`Effect.part`), a machine the parts that it has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.physics.effect import Effect

Kind = TypeVar("Kind", bound="type[Effect]")


@dataclass(frozen=True)
class Machine:
    """One kind: its parts, and how fast and far its base may turn in a trial; wrong units exceed one."""

    text: str
    parts: frozenset[str]
    fastest_deg_s: float
    largest_deg: float


MachineName: TypeAlias = Literal["needle", "joint", "cable", "shaft", "linear"]
NEEDLE: MachineName = "needle"
NEEDLE_DEG_S, NEEDLE_DEG = 1500.0, 3600.0
"""250 rpm, ten times what needle drives do."""
MOTOR_DEG_S, MOTOR_DEG = 60_000.0, 3.6e6
"""10 000 rpm, of small servo motors; ten thousand turns."""
MACHINES: Mapping[MachineName, Machine] = {
    NEEDLE: Machine(
        "a needle or wire in tissue", frozenset({"needle", "chuck", "end"}), NEEDLE_DEG_S, NEEDLE_DEG
    ),
    "joint": Machine("a joint or motor that turns stiffly", frozenset({"drive"}), MOTOR_DEG_S, MOTOR_DEG),
    "cable": Machine(
        "a cable that turns or bends a far end", frozenset({"drive", "end"}), MOTOR_DEG_S, MOTOR_DEG
    ),
    "shaft": Machine(
        "a shaft with gears or couplings between two machines",
        frozenset({"drive", "end"}),
        MOTOR_DEG_S,
        MOTOR_DEG,
    ),
    "linear": Machine("an axis that slides, over a lever", frozenset({"drive"}), MOTOR_DEG_S, MOTOR_DEG),
}
"""By the name that a layout states."""


def machine_called(name: str) -> MachineName:
    """The machine of that name. Raises BadInput."""
    for known in MACHINES:
        if known == name:
            return known
    raise BadInput(f"{name}: is no machine known here; name one of {', '.join(MACHINES)}")


def fitting(library: Mapping[str, Kind], machine: MachineName) -> dict[str, Kind]:
    """The effects of a library that act in a part that the machine has."""
    parts = MACHINES[machine].parts
    return {name: e for name, e in library.items() if not e.part or e.part in parts}


def check_fits(effect: type[Effect], machine: MachineName) -> None:
    """Raises BadInput for an effect that acts in a part that the machine lacks."""
    if not fitting({effect.name(): effect}, machine):
        raise BadInput(
            f"{effect.name()}: acts in a part ({effect.part}) that a {machine} lacks; `needle-rig effects"
            f" --machine {machine}` lists what fits"
        )
