"""A law with a spline for its curve as an effect of the ordinary contract, evaluated inside the solver.

Its fields are the spline's standardised coefficients z. Curves of the tissue's torque are tables that one
compiled law per variable reads: other knots or coefficients compile nothing.
"""

from __future__ import annotations

import copyreg
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial, parameter
from needle_rig.physics.rod import Rod, TorqueLaw
from needle_rig.physics.trial_variables import (
    backward_travel_rad,
    clock_s,
    direction,
    forward_travel_rad,
    left_behind_rad,
    rate_rad_s,
    stop_time_s,
    travel_rad,
)
from needle_rig.units import rad
from needle_rig.workbench.laws.law import UNIT, Law
from needle_rig.workbench.laws.spline import Spline

LEAST_FACTOR = 0.02
"""Slip limits and rigidity are left at least this share, and grow to the inverse of it at most."""
FAR_SIGMAS = 60.0


@dataclass(frozen=True)
class SplineLaw:
    """A law and the curves that it may have."""

    law: Law
    spline: Spline
    name: str

    def effect(self) -> type[Effect]:
        """The effect; the same class for the same curves."""
        return _effect(self)

    def on(self, reading: Reading, sensor: int | None) -> Array:
        """Values of the spline's basis (samples, K) at a reading."""
        unit = UNIT[self.law.variable_unit][2]
        basis = self.spline.basis(of_reading(self.law, reading, sensor) / unit)
        return basis * own(reading, sensor)[:, np.newaxis] if self.law.kind == "gain" else basis

    def curve(self, coefficients: Array, at: Array) -> Array:
        """The curve (n,) at (n,), in the units of the law, of the spline's coefficients (K,)."""
        return self.linked(self.spline.values(coefficients, at))

    def linked(self, values: Array) -> Array:
        """The curve where the spline has these values: a factor is its exponential, give is not below 0."""
        if self.law.scales:
            return np.expm1(np.clip(values, np.log(LEAST_FACTOR), -np.log(LEAST_FACTOR)))
        return np.maximum(values, 0.0) if self.law.place == "stiffness" else values

    def unlinked(self, curve: Array) -> Array:
        """Values of the spline where the curve has these."""
        return np.log(np.maximum(1.0 + curve, LEAST_FACTOR)) if self.law.scales else curve

    def coefficients(self, scaled_values: Array) -> Array:
        """Of the spline (K,), from the effect's fields."""
        return np.asarray(self.spline.root @ scaled_values)

    def scaled_values(self, coefficients: Array) -> Array:
        """The effect's fields (K,) for coefficients of the spline."""
        return np.asarray(self.spline.inverse @ coefficients)


def of_trial(law: Law, trial: Trial) -> Array:
    """A law's variable of the base's path at each sample (samples,), SI."""
    told: dict[str, Callable[[Trial], Array]] = {
        "base_angle": lambda t: t.base_angle_rad,
        "rate": rate_rad_s,
        "travel": {"forward": forward_travel_rad, "backward": backward_travel_rad}.get(law.kind, travel_rad),
        "stop_time": stop_time_s,
        "clock": clock_s,
        "direction": direction,
    }
    return told[law.variable](trial)


def of_reading(law: Law, reading: Reading, sensor: int | None) -> Array:
    """A law's variable of a reading at each sample (samples,), SI; `sensor` is the one that is read."""
    if law.kind == "play":
        return left_behind_rad(own(reading, sensor), rad(law.play_deg), None)[0]
    if law.variable == "torque":
        return reading.torque_nm
    if law.variable == "angle":
        return own(reading, sensor)
    if law.variable == "twist":
        return np.asarray(own(reading, sensor) - reading.trial.base_angle_rad)
    return of_trial(law, reading.trial)


def own(reading: Reading, sensor: int | None) -> Array:
    """What a sensor reads (samples,), the torque cell where there is no number, SI."""
    return reading.torque_nm if sensor is None else np.asarray(reading.hall_rad[:, sensor])


def of_place(variable: str, trial: Trial) -> float:
    """A variable of a trial's place in its series, SI."""
    return {"clock": trial.start_s, "trial": float(trial.index), "travel": trial.travel_before_rad}[variable]


class _Remade(type):
    """Kind of the classes that are in no module: another process makes them from their law."""

    made: SplineLaw


def _remade(effect: _Remade) -> tuple[Any, ...]:
    return _effect, (effect.made,)


copyreg.pickle(_Remade, _remade)


@lru_cache(maxsize=512)
def _effect(made: SplineLaw) -> type[Effect]:
    hooks: dict[str, Callable[..., Any]] = {
        "observe": _observe,
        "drive": _drive,
        "shape": _shape,
        "torque": _torque,
    }
    # the tissue's torque joins the rod's laws itself, with the table that they read
    hook = "shape" if made.law.hook == "torque" else made.law.hook
    info = {"off": 0.0, "lower": -FAR_SIGMAS, "upper": FAR_SIGMAS, "typical": 1.0, "smallest": 1e-3}
    fields = [
        (
            f"z{k}",
            float,
            parameter(**info, literature=(-FAR_SIGMAS, FAR_SIGMAS), unit="1", prior=1.0),
        )
        for k in range(made.spline.count)
    ]
    namespace = {
        hook: hooks[made.law.hook](made),
        "made": made,
        "name": classmethod(lambda _: made.name),
        "__module__": __name__,
        "__doc__": f"A curve: {made.law.words()}.",
        "__annotations__": {name: float for name, _, _ in fields},
        **{name: default for name, _, default in fields},
    }
    made_class: Any = _Remade("SplineEffect", (Effect,), namespace)
    effect: type[Effect] = dataclasses.dataclass(frozen=True)(made_class)
    return effect


def _curve(made: SplineLaw) -> Callable[[Effect, Array], Array]:
    """SI to SI, beyond its ends constant."""
    given, gives = UNIT[made.law.variable_unit][2], UNIT[made.law.unit][2]

    def curve(effect: Effect, at: Array) -> Array:
        return made.curve(_coefficients(made, effect), np.asarray(at) / given) * gives

    return curve


def _coefficients(made: SplineLaw, effect: Effect) -> Array:
    return made.coefficients(np.array([getattr(effect, name) for name in effect.parameters()]))


def _observe(made: SplineLaw) -> Callable[[Effect, Reading], Reading]:
    curve, law = _curve(made), made.law

    def added(effect: Effect, reading: Reading, sensor: int | None) -> Array:
        values = curve(effect, of_reading(law, reading, sensor))
        return values * own(reading, sensor) if law.kind == "gain" else values

    def observe(self: Effect, reading: Reading) -> Reading:
        if law.place == "torque":
            return dataclasses.replace(reading, torque_nm=reading.torque_nm + added(self, reading, None))
        hall_rad = reading.hall_rad.copy()
        for k in range(hall_rad.shape[1]) if law.number is None else (law.number,):
            hall_rad[:, k] += added(self, reading, k)
        return dataclasses.replace(reading, hall_rad=hall_rad)

    return observe


def _drive(made: SplineLaw) -> Callable[[Effect, Trial], Array]:
    curve, law = _curve(made), made.law

    def drive(self: Effect, trial: Trial) -> Array:
        # a trial begins relaxed with the base at 0
        start = np.array([trial.start_s if law.variable == "clock" else 0.0])
        added = curve(self, of_trial(law, trial)) - curve(self, start)
        return np.asarray(trial.base_angle_rad + added)

    return drive


def _shape(made: SplineLaw) -> Callable[[Effect, Rod, Trial], Rod]:
    curve, law = _curve(made), made.law

    def shape(self: Effect, rod: Rod, trial: Trial) -> Rod:
        tissue = rod.tissue_length_m > 0
        if law.place == "rigidity":
            middle = 0.5 * (rod.position_m[1:] + rod.position_m[:-1])
            stiffness_nm_per_rad = rod.stiffness_nm_per_rad * (1.0 + curve(self, middle))
            return dataclasses.replace(rod, stiffness_nm_per_rad=stiffness_nm_per_rad)
        at = rod.position_m if law.variable == "x" else np.full(tissue.size, of_place(law.variable, trial))
        if law.place == "stiffness":
            given = curve(self, at)
            limit = np.where(tissue & (rod.slip_plus_nm > 0), rod.slip_plus_nm, np.inf)
            return dataclasses.replace(rod, compliance_rad_per_nm=rod.compliance_rad_per_nm + given / limit)
        factor = np.where(tissue, 1.0 + curve(self, at), 1.0)
        return dataclasses.replace(
            rod, slip_plus_nm=rod.slip_plus_nm * factor, slip_minus_nm=rod.slip_minus_nm * factor
        )

    return shape


def _torque(made: SplineLaw) -> Callable[[Effect, Rod, Trial], Rod]:
    law, spline = made.law, made.spline
    given, gives = UNIT[law.variable_unit][2], UNIT[law.unit][2]
    head = np.array([spline.low * given, 1.0 / (spline.spacing * given), spline.count - 3.0])

    def shape(self: Effect, rod: Rod, trial: Trial) -> Rod:  # noqa: ARG001 see Effect
        here = rod.section == law.number if law.number is not None else np.full(rod.section.size, True)
        joined = TorqueLaw(
            _table_laws()[law.variable],
            np.r_[head, gives * _coefficients(made, self)],
            np.where(here, rod.tissue_length_m, 0.0),
            steady=law.variable != "rate",
        )
        return dataclasses.replace(rod, laws=(*rod.laws, joined))

    return shape


def _at(parameters: Any, v: float) -> float:
    """The uniform cubic B-spline whose low end, knots a unit, pieces and coefficients are given."""
    pieces = parameters[2]
    u = min(max((v - parameters[0]) * parameters[1], 0.0), pieces)
    i = min(int(u), int(pieces) - 1)
    s = u - i
    a, b, c, d = parameters[3 + i], parameters[4 + i], parameters[5 + i], parameters[6 + i]
    left = (1.0 - s) ** 3 * a + (3.0 * s**3 - 6.0 * s**2 + 4.0) * b
    return float((left + (-3.0 * s**3 + 3.0 * s**2 + 3.0 * s + 1.0) * c + s**3 * d) / 6.0)


@cache
def _table_laws() -> dict[str, Callable[..., float]]:
    """Compiled laws by the variable that they read."""
    # numba takes longer to import than most laws need that have no torque
    import numba

    from needle_rig.physics.kernel.laws import LAW_SIGNATURE

    at: Any = numba.njit(_at, error_model="numpy")

    def of_angle(parameters: Any, angle: float, rate: float, time: float, position: float) -> Any:  # noqa: ARG001
        return at(parameters, angle)

    def of_rate(parameters: Any, angle: float, rate: float, time: float, position: float) -> Any:  # noqa: ARG001
        return at(parameters, rate)

    def of_x(parameters: Any, angle: float, rate: float, time: float, position: float) -> Any:  # noqa: ARG001
        return at(parameters, position)

    compiled: Any = numba.cfunc(LAW_SIGNATURE, error_model="numpy")
    return {"angle": compiled(of_angle), "rate": compiled(of_rate), "x": compiled(of_x)}
