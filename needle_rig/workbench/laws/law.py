"""A law: where something acts that the model lacks, and the one variable that it depends on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from needle_rig.units import M_PER_MM, N_PER_NMM_PER_100MM, NM_PER_NMM, RAD_PER_DEG

Hook = Literal["torque", "shape", "drive", "observe"]
Variable = Literal[
    "angle",
    "base_angle",
    "rate",
    "twist",
    "torque",
    "x",
    "travel",
    "stop_time",
    "clock",
    "trial",
    "direction",
]
Kind = Literal["plain", "gain", "play", "forward", "backward"]
"""A curve that is added; one that a reading is multiplied by, less 1; of how far a reading stands from where
its play lets it follow; of the distance turned in one direction alone."""
PLAYS_DEG = (1.0, 2.0, 4.0, 8.0)
"""Widths of play that are screened; a fit moves them."""

UNIT: dict[str, tuple[str, str, float]] = {
    "°": ("°", "_deg", RAD_PER_DEG),
    "°/s": ("°/s", "_deg_s", RAD_PER_DEG),
    "N·mm": ("N·mm", "_nmm", NM_PER_NMM),
    "N·mm per 100 mm": ("N·mm per 100 mm", "_nmm_per_100mm", N_PER_NMM_PER_100MM),
    "mm": ("mm", "_mm", M_PER_MM),
    "s": ("s", "_s", 1.0),
    "1": ("1", "", 1.0),
}
"""(name, end of a field's name, value in SI) of the units in which curves are given."""

_VARIABLE_UNIT: dict[str, str] = {
    "angle": "°",
    "base_angle": "°",
    "rate": "°/s",
    "twist": "°",
    "torque": "N·mm",
    "x": "mm",
    "travel": "°",
    "stop_time": "s",
    "clock": "s",
    "trial": "1",
    "direction": "1",
}
_VARIABLE_WORDS: dict[str, str] = {
    "angle": "its own angle",
    "base_angle": "the base angle",
    "rate": "the rate",
    "twist": "the twist",
    "torque": "the torque",
    "x": "the place along the needle",
    "travel": "the distance turned",
    "stop_time": "the time since the stop",
    "clock": "the clock",
    "trial": "the number of the trial",
    "direction": "the direction of the last motion",
}


@dataclass(frozen=True, order=True)
class Law:
    """A place in one of the four hooks of an effect, and a variable; its curve stands apart.

    In the JSON answer laws are given by hook, place and variable; the kind stands in words and formula.
    """

    hook: Hook
    place: str
    """tissue, section_1 …; slip_limit, stiffness, rigidity; base; torque, hall_1 …, halls."""
    variable: Variable
    kind: Kind = "plain"
    play_deg: float = 0.0
    """Width of a play where the fit starts."""

    @property
    def name(self) -> str:
        """As an effect may be called."""
        kind = "" if self.kind == "plain" else f"_{self.kind}"
        return (
            f"{self.hook}_{self.place}_{self.variable}{kind}{f'_{self.play_deg:g}' if self.play_deg else ''}"
        )

    @property
    def unit(self) -> str:
        """Of the curve: factors are given by what they differ from 1, stiffness by the angle to slip."""
        if self.kind == "gain":
            return "1"
        if self.hook == "torque":
            return "N·mm per 100 mm"
        if self.hook == "observe" and self.place == "torque":
            return "N·mm"
        return "1" if self.place in ("slip_limit", "rigidity") else "°"

    @property
    def scales(self) -> bool:
        """Whether it multiplies something positive: its spline is of the logarithm of the factor."""
        return self.place in ("slip_limit", "rigidity")

    @property
    def variable_unit(self) -> str:
        """Of the variable."""
        return _VARIABLE_UNIT[self.variable]

    @property
    def number(self) -> int | None:
        """Which section or sensor, from 0; None for all."""
        last = self.place.rpartition("_")[2]
        return int(last) - 1 if last.isdigit() else None

    def as_json(self) -> dict[str, str]:
        """As it stands in the JSON answer."""
        return {"hook": self.hook, "place": self.place, "variable": self.variable}

    def words(self) -> str:
        """In words."""
        where = {
            "tissue": "a torque along the tissue",
            "slip_limit": "the slip limit",
            "stiffness": "the angle that the tissue gives before it slips",
            "rigidity": "the torsional rigidity",
            "base": "the angle between encoder and needle",
        }
        error = "the gain" if self.kind == "gain" else "an error"
        if self.hook == "observe" and self.place == "torque":
            acts = f"{error} of the torque reading"
        elif self.place == "halls":
            acts = f"{error} of every Hall reading"
        elif self.hook == "observe":
            acts = f"{error} of the reading of {self.place}"
        else:
            acts = where.get(self.place, f"a torque in tissue {self.place.replace('_', ' ')}")
        on = "the reading itself" if self._own else _VARIABLE_WORDS[self.variable]
        if self.hook == "torque" and self.variable == "angle":
            on = "the angle of the needle there"
        if self.kind == "play":
            on = "where its own angle stands in a play"
        if self.kind in ("forward", "backward"):
            on = f"the distance turned {self.kind}"
        return f"{acts} depends on {on}"

    def same(self, other: Law) -> bool:
        """Whether the JSON answer tells them alike."""
        return self.as_json() == other.as_json()

    @property
    def _own(self) -> bool:
        return self.hook == "observe" and (
            (self.place == "torque") == (self.variable == "torque") and self.variable in ("torque", "angle")
        )


def every_law(sensors: int, sections: int) -> tuple[Law, ...]:
    """The laws that are tried, for so many sensors and tissue sections."""
    of_base: Sequence[Variable] = ("base_angle", "rate", "clock", "travel", "stop_time", "direction")
    of_sensor: Sequence[Variable] = ("angle", "torque", "twist", *of_base)
    found = [Law("observe", "torque", variable) for variable in ("torque", *of_base)]
    places = [f"hall_{k + 1}" for k in range(sensors)] + (["halls"] if sensors > 1 else [])
    found += [Law("observe", place, variable) for place in places for variable in of_sensor]
    found += [Law("observe", place, "clock", "gain") for place in ("torque", *places)]
    found += [
        Law("observe", f"hall_{k + 1}", "angle", "play", width) for k in range(sensors) for width in PLAYS_DEG
    ]
    found += [Law("drive", "base", variable) for variable in of_base]
    found += [Law("drive", "base", "travel", "forward"), Law("drive", "base", "travel", "backward")]
    if sections:
        along: Sequence[Variable] = ("x", "clock", "trial", "travel")
        found += [Law("shape", "slip_limit", variable) for variable in along]
        found += [Law("shape", "stiffness", "x"), Law("shape", "rigidity", "x")]
        of_tissue: Sequence[Variable] = ("angle", "rate", "x")
        found += [Law("torque", "tissue", variable) for variable in of_tissue]
        if sections > 1:
            found += [Law("torque", f"section_{k + 1}", "angle") for k in range(sections)]
    return tuple(found)
