"""What an effect is: one frozen dataclass in one file, whose fields are its parameters.

Fields hold the values that files, commands and pages show (degrees, N·mm, mm; the unit is in the name);
hooks convert to SI. An effect has one or more of the hooks `shape`, `torque`, `drive`, `observe`. An effect
whose parameters are all at their off value leaves the model bit for bit as it was.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType
from typing import Any, ClassVar, Literal, Self, TypeAlias

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.rod import Indices, Rod
from needle_rig.physics.torque_scale import torque_power

PerItem: TypeAlias = float | tuple[float, ...]
"""Value of a field that has one number for each sensor or section; a single one serves for all."""


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter, in the unit of its field."""

    off: float
    """Value at which the effect vanishes; may be infinite."""
    lower: float
    upper: float
    typical: float
    smallest: float
    """Smallest size that matters: below it an effect is called negligible.

    Built-in ones move an angle by 0.5° or the torque by 0.002 N·mm (`SizePolicy`) in the 45° sequence on the
    experiment's layout with a friction of 0.1 N·mm per 100 mm: in its settled states, or, for effects that
    leave no trace there, on the way.
    """
    literature: tuple[float, float]
    """Plausible range; a fitted value outside it counts against the effect."""
    unit: str
    scale: Literal["linear", "log", "reciprocal"] = "linear"
    """How strengths between off and typical are spaced: reciprocal for stiffnesses that are off at ∞."""
    per: Literal["one", "sensor", "section"] = "one"
    """`sensor` and `section`: a tuple with one value for each; a single number serves for all."""
    shapes: bool = False
    """A second parameter that only gives form (a relaxation time): it has no off value of its own."""

    places: Callable[[Sequence[Trial]], Sequence[Sequence[float]]] | None = None
    """Values to try of a form that no slope finds (an instant, an integer order), from the trials of a series
    in their order: rows of neighbours that look alike. A fit holds the one that it is given."""

    relative: bool = False
    """Factors against their mean, which a fit holds at off: what all items share is held by a parameter that
    the effect is `redundant_with`."""

    prior: float | None = None
    """Relative standard deviation to which it is known before any measurement; None: not known."""

    def scaled(self, torque_scale: float) -> ParameterInfo:
        """The same of a shaft whose torques are so many times the needle's."""
        factor = torque_scale ** torque_power(self.unit)
        if factor == 1.0:
            return self
        low, high = self.literature
        return dataclasses.replace(
            self,
            off=self.off * factor,
            lower=self.lower * factor,
            upper=self.upper * factor,
            typical=self.typical * factor,
            smallest=self.smallest * factor,
            literature=(low * factor, high * factor),
        )

    def at_strength(self, strength: float) -> float:
        """Value `strength` times as far from off as the typical size (forms stay typical)."""
        if self.shapes:
            return self.typical
        if self.scale == "reciprocal":
            return self.typical / strength if strength else self.off
        return self.off + strength * (self.typical - self.off)

    def to_scale(self, value: float) -> float:
        """`value` on the axis on which fits and steps are made: itself, its logarithm or its reciprocal."""
        if self.scale == "log":
            return math.log(value)
        return (1.0 / value if value else math.inf) if self.scale == "reciprocal" else value

    def from_scale(self, scaled: float) -> float:
        """Inverse of `to_scale`."""
        if self.scale == "log":
            return math.exp(scaled)
        return (1.0 / scaled if scaled else math.inf) if self.scale == "reciprocal" else scaled

    def check(self, value: object, place: str, bounded: bool = True) -> None:
        """Raises BadInput, naming `place`, when `value` is no number or out of bounds (off is inside)."""
        if isinstance(value, bool) or not isinstance(value, int | float | np.number):
            raise BadInput(f"{place}: {value!r} is not a number (unit {self.unit})")
        inside = self.lower <= float(value) <= self.upper if bounded else not math.isnan(value)
        if not (value == self.off or inside):
            side, limit = ("below", self.lower) if float(value) < self.lower else ("above", self.upper)
            if math.isnan(float(value)):
                raise BadInput(f"{place}: nan is not a number; allowed are {self.lower:g} to {self.upper:g}")
            raise BadInput(
                f"{place}: {value:g} {self.unit} is {side} {limit:g}; allowed are {self.lower:g} to"
                f" {self.upper:g}, and {self.off:g} for none"
            )


def parameter(*, default: float | None = None, **info: Any) -> Any:
    """A dataclass field that carries a ParameterInfo; its default is off (of a form, the typical size)."""
    described = ParameterInfo(**info)
    if default is None:
        default = described.typical if described.shapes else described.off
    return dataclasses.field(default=default, metadata={"info": described})


@dataclass(frozen=True)
class Trial:
    """One trial as the model is driven: the measured base angle over time, and the tip's torque if one acts.

    `start_s` is its start on the clock of the series, `index` its place in it, `travel_before_rad` the sum of
    |base motion| in the trials before it. Arrays have shape (samples,). `held_rad` is where the effect that
    is asked left the needle's held end, when the trial continues an earlier piece; None at a relaxed start.
    """

    time_s: Array
    base_angle_rad: Array
    start_s: float = 0.0
    index: int = 0
    travel_before_rad: float = 0.0
    held_rad: float | None = None
    tip_torque_nm: Array | None = None
    """Measured torque on the tip (samples,), positive where it turns the needle counter-clockwise; None where
    nothing acts."""


@dataclass(frozen=True)
class Reading:
    """What the sensors show: torque (samples,), Hall angles (samples, sensors), with their trial.

    `state` is what an effect with memory (a filter) takes along, a single number: given, at the first sample,
    None at a relaxed start; returned, at the last sample. Every effect has its own.
    """

    trial: Trial
    torque_nm: Array
    hall_rad: Array
    state: float | None = None


class Effect:
    """Base of all effects; see the module's text. Hooks that a subclass does not define are not called.

    Raises BadInput when it is made with a value outside its bounds; those of torques belong to a shaft: the
    model knows them, and asks `check_for`.
    """

    part: ClassVar[str] = ""
    """Part of a machine that it acts in (`machine.MACHINES`); empty for one that every machine has."""
    relatives: ClassVar[tuple[str, ...]] = ()
    """Effects that look alike."""
    limits: ClassVar[dict[str, dict[str, float]]] = {}
    """Effect that this one becomes, and the parameter values (extremes) at which it does."""
    redundant_with: ClassVar[tuple[str, ...]] = ()
    """Base parameters (friction_nmm_per_100mm, torsional_rigidity_nmm2) that this effect's can replace."""
    resistive: ClassVar[bool] = False
    """Never adds energy to the needle."""
    stage: ClassVar[int] = 0
    """Effects with the same hook act in the order of stage, then name: what there is before the sensor (-2),
    gains (-1), what is added."""

    def __post_init__(self) -> None:
        for name, info in self.parameters().items():
            given = getattr(self, name)
            values = tuple(given) if isinstance(given, tuple | list) else (given,)
            for value in values:
                info.check(value, f"{self.name()}.{name}", bounded=not torque_power(info.unit))
            if isinstance(given, tuple | list):
                if info.per == "one":
                    raise BadInput(f"{self.name()}.{name}: takes one number, got {len(values)}")
                object.__setattr__(self, name, tuple(float(v) for v in values))
            else:
                object.__setattr__(self, name, float(given))

    def check_for(self, torque_scale: float) -> None:
        """Raises BadInput for a torque out of its bounds on a shaft of that torque scale."""
        for name, info in self.parameters().items():
            if torque_power(info.unit):
                given, known = getattr(self, name), info.scaled(torque_scale)
                for value in given if isinstance(given, tuple) else (given,):
                    known.check(value, f"{self.name()}.{name}")

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """The rod with this effect in its coefficients.

        `trial` tells its place in the series; its path is not given (the arrays are empty).
        """
        raise NotImplementedError

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        """Extra torque on the needle, N·m per metre of tissue. Compiled: plain arithmetic and `math` only."""
        raise NotImplementedError

    def drive(self, trial: Trial) -> Array:
        """Angle of the needle's held end, shape (samples,), from the base encoder's path in `trial`."""
        raise NotImplementedError

    def observe(self, reading: Reading) -> Reading:
        """The reading that the sensors give for the truth in `reading`."""
        raise NotImplementedError

    @classmethod
    def name(cls) -> str:
        """Name of the effect: the name of its file."""
        return cls.__module__.rpartition(".")[2]

    @classmethod
    def parameters(cls) -> Mapping[str, ParameterInfo]:
        """The parameters by field name."""
        return _parameters(cls)  # type: ignore[arg-type]  # mypy takes the hash of instances for that of classes

    @classmethod
    def at_strength(cls, strength: float) -> Self:
        """The effect `strength` times as far from off as its typical size."""
        return cls(**{name: info.at_strength(strength) for name, info in cls.parameters().items()})

    @classmethod
    def has(cls, hook: str) -> bool:
        """Whether this effect defines `hook` itself."""
        return getattr(cls, hook) is not getattr(Effect, hook)

    @classmethod
    def hooks(cls) -> list[str]:
        """The hooks that this effect defines itself."""
        return [hook for hook in ("drive", "shape", "torque", "observe") if cls.has(hook)]

    @classmethod
    def is_placed(cls) -> bool:
        """Whether one of its parameters is a place that is looked for (`ParameterInfo.places`)."""
        return any(info.places is not None for info in cls.parameters().values())

    def is_off(self) -> bool:
        """Whether every parameter stands at its off value (forms, as relaxation times, do not count)."""
        for name, info in self.parameters().items():
            value = getattr(self, name)
            values = value if isinstance(value, tuple) else (value,)
            if not info.shapes and any(v != info.off for v in values):
                return False
        return True

    def each(self, field: str, count: int) -> Array:
        """A per-sensor or per-section field, shape (count,). Raises BadInput on another count."""
        values = np.atleast_1d(np.asarray(getattr(self, field), dtype=float))
        if values.size not in (1, count):
            info = self.parameters()[field]
            raise BadInput(
                f"{self.name()}.{field}: {values.size} values for {count} {info.per}s;"
                f" give one for each {info.per}, or one for all"
            )
        return np.broadcast_to(values, (count,))


@cache
def _parameters(effect: type[Effect]) -> Mapping[str, ParameterInfo]:
    fields = dataclasses.fields(effect)  # type: ignore[arg-type]
    return MappingProxyType({f.name: f.metadata["info"] for f in fields})


def with_lumped_friction(rod: Rod, nodes: int | Indices, friction_nm: float | Array) -> Rod:
    """The rod with Coulomb friction (N·m) added at single nodes, in both directions."""
    added = np.zeros_like(rod.position_m)
    added[nodes] = friction_nm
    return dataclasses.replace(
        rod, slip_plus_nm=rod.slip_plus_nm + added, slip_minus_nm=rod.slip_minus_nm + added
    )
