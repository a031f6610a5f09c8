"""Laws that the library does not hold, to be hidden in datasets: by hand, without the workbench's code.

Each has the place and variable that a search should name, and the formula. At size 1 it is of medium
strength.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from needle_rig.model import load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, Trial, parameter
from needle_rig.physics.rod import Rod


@dataclass(frozen=True)
class HiddenLaw:
    """A law with what a search should say of it."""

    name: str
    hook: str
    place: str
    variables: tuple[str, ...]
    """Any of these is right: two that these trials give alike."""
    forms: tuple[str, ...]
    """Names of formulas that are right."""
    effect: type[Effect]
    curve: Callable[[float, Array], Any]
    """The true curve (n,) at a size, at values (n,) of the variable, in the units of a law's axes."""
    held_by: str = ""
    """The effect of the library that can be this law, too: to name it is no error."""

    def at(self, size: float) -> Effect:
        """The effect at a size."""
        made: Any = self.effect
        return made(size=size)  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Hidden(Effect):
    """What all have: a size."""

    size: float = parameter(
        off=0.0, lower=-100.0, upper=100.0, typical=1.0, smallest=0.01, literature=(-100.0, 100.0), unit="1"
    )

    @classmethod
    def name(cls) -> str:
        return cls.__name__.lower()


def _observed(name: str, change: Callable[[float, Reading, Array, Array], None]) -> type[Effect]:
    def observe(self: Hidden, reading: Reading) -> Reading:
        torque_nm, hall_rad = reading.torque_nm.copy(), reading.hall_rad.copy()
        change(self.size, reading, torque_nm, hall_rad)
        return dataclasses.replace(reading, torque_nm=torque_nm, hall_rad=hall_rad)

    return _made(name, observe=observe)


def _driven(name: str, error_rad: Callable[[Trial], Array]) -> type[Effect]:
    def drive(self: Hidden, trial: Trial) -> Array:
        return trial.base_angle_rad + self.size * error_rad(trial)

    return _made(name, drive=drive)


def _limited(name: str, share: Callable[[Array, Trial], Any]) -> type[Effect]:
    def shape(self: Hidden, rod: Rod, trial: Trial) -> Rod:
        factor = 1.0 + self.size * share(rod.position_m * 1e3, trial)
        return dataclasses.replace(
            rod, slip_plus_nm=rod.slip_plus_nm * factor, slip_minus_nm=rod.slip_minus_nm * factor
        )

    return _made(name, shape=shape)


def _made(name: str, **hooks: Any) -> type[Effect]:
    return dataclass(frozen=True)(type(name, (Hidden,), {"__doc__": name, **hooks}))


def _base_rate(trial: Trial) -> Array:
    return np.asarray(np.gradient(trial.base_angle_rad, trial.time_s))


def _turned(trial: Trial) -> Array:
    return np.asarray(np.abs(np.diff(trial.base_angle_rad, prepend=0.0)).cumsum())


def _stood(trial: Trial) -> Array:
    since, out = 0.0, []
    for t, w in zip(trial.time_s, _base_rate(trial), strict=True):
        since = t if abs(w) > 0.01 else since
        out.append(t - since)
    return np.array(out)


def _way(trial: Trial) -> Array:
    last, out = 0.0, []
    for w in _base_rate(trial):
        last = math.copysign(1.0, w) if abs(w) > 0.01 else last
        out.append(last)
    return np.array(out)


def _hall_2_third(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    hall_rad[:, 1] += size * 0.03 * np.sin(3.0 * hall_rad[:, 1])


def _cell_cube(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm += size * 1e-5 * (reading.torque_nm / 1e-4) ** 3


def _bearing(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm += size * 5e-6 * _base_rate(reading.trial) / 0.785


def _cross_talk(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    hall_rad[:, 3] += size * 0.03 * (reading.torque_nm / 1e-4) ** 2


def _hall_3_warms(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    clock_s = reading.trial.start_s + reading.trial.time_s
    hall_rad[:, 2] += size * 0.05 * (1.0 - np.exp(-clock_s / 100.0))


def _cable(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm += size * 8e-6 * np.sin(reading.trial.base_angle_rad + 0.6)


def _lag(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    hall_rad[:, 0] -= size * 0.04 * _base_rate(reading.trial)


def _dead_cell(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm -= size * np.clip(reading.torque_nm, -1.5e-5, 1.5e-5)


def _cell_relaxes(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm += size * 1e-5 * np.exp(-_stood(reading.trial) / 0.8)


def _cell_sticks(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    torque_nm += size * 6e-6 * _way(reading.trial)


def _magnet_turns(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    hall_rad[:, 1] += size * 0.015 * _turned(reading.trial)


def _two_poles(size: float, reading: Reading, torque_nm: Array, hall_rad: Array) -> None:
    hall_rad += size * 0.02 * np.cos(2.0 * hall_rad)


class Slit(Hidden):
    """Twice a turn in the third section."""

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        if position_m < 0.305 or position_m > 0.330:
            return 0.0
        return -self.size * 1.2e-3 * math.sin(2.0 * angle_rad)


class Stop(Hidden):
    """A spring beyond 35°."""

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        return -self.size * 1e-3 * max(angle_rad - 0.61, 0.0)


class Detent(Hidden):
    """Four times a turn."""

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        return -self.size * 3e-4 * math.sin(4.0 * angle_rad)


class Pull(Hidden):
    """A constant torque in the second section."""

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        if position_m < 0.240 or position_m > 0.265:
            return 0.0
        return self.size * 4e-4


class Notch(Hidden):
    """A push near 30° in the first section."""

    def torque(self, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float) -> float:
        if position_m > 0.201:
            return 0.0
        return self.size * 1e-3 * math.exp(-(((angle_rad - 0.52) / 0.25) ** 2))


class SoftSection(Hidden):
    """The third section gives before it slips."""

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        added = np.zeros_like(rod.position_m)
        soft = (rod.tissue_length_m > 0) & (rod.position_m > 0.3) & (rod.position_m < 0.335)
        added[soft] = self.size * 150.0 / rod.tissue_length_m[soft]
        return dataclasses.replace(rod, compliance_rad_per_nm=rod.compliance_rad_per_nm + added)


class Kink(Hidden):
    """The needle is weaker near 150 mm."""

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        middle_mm = 500.0 * (rod.position_m[1:] + rod.position_m[:-1])
        factor = 1.0 / (1.0 + self.size * 0.8 * np.exp(-(((middle_mm - 280.0) / 40.0) ** 2)))
        return dataclasses.replace(rod, stiffness_nm_per_rad=rod.stiffness_nm_per_rad * factor)


def _as_dataclass(effect: type[Effect]) -> type[Effect]:
    return dataclass(frozen=True)(effect)


_ANGLES = ("angle", "base_angle")
_SERIES = ("clock", "trial", "travel")
_DEG = 180.0 / math.pi
_FRICTION_N = load_parameters("rig_rigid").friction_n
LAWS: tuple[HiddenLaw, ...] = (
    HiddenLaw(
        "hall_2_third",
        "observe",
        "hall_2",
        ("angle",),
        ("sine",),
        _observed("A", _hall_2_third),
        lambda s, v: _DEG * s * 0.03 * np.sin(3.0 * v / _DEG),
    ),
    HiddenLaw(
        "cell_cube",
        "observe",
        "torque",
        ("torque",),
        ("cube",),
        _observed("B", _cell_cube),
        lambda s, v: s * 0.01 * (v / 0.1) ** 3,
        held_by="torque_nonlinearity",
    ),
    HiddenLaw(
        "bearing",
        "observe",
        "torque",
        ("rate",),
        ("line",),
        _observed("C", _bearing),
        lambda s, v: s * 0.005 * v / _DEG / 0.785,
        held_by="bearing_drag",
    ),
    HiddenLaw(
        "cross_talk",
        "observe",
        "hall_4",
        ("torque",),
        ("square",),
        _observed("D", _cross_talk),
        lambda s, v: _DEG * s * 0.03 * (v / 0.1) ** 2,
    ),
    HiddenLaw(
        "hall_3_warms",
        "observe",
        "hall_3",
        ("clock",),
        ("exponential",),
        _observed("E", _hall_3_warms),
        lambda s, v: _DEG * s * 0.05 * (1.0 - np.exp(-v / 100.0)),
    ),
    HiddenLaw(
        "cable",
        "observe",
        "torque",
        ("base_angle",),
        ("sine",),
        _observed("F", _cable),
        lambda s, v: s * 0.008 * np.sin(v / _DEG + 0.6),
        held_by="torque_ripple",
    ),
    HiddenLaw(
        "lag", "observe", "hall_1", ("rate",), ("line",), _observed("G", _lag), lambda s, v: -s * 0.04 * v
    ),
    HiddenLaw(
        "dead_cell",
        "observe",
        "torque",
        ("torque",),
        ("limited line",),
        _observed("H", _dead_cell),
        lambda s, v: -s * np.clip(v, -0.015, 0.015),
    ),
    HiddenLaw(
        "cell_relaxes",
        "observe",
        "torque",
        ("stop_time",),
        ("exponential",),
        _observed("I", _cell_relaxes),
        lambda s, v: s * 0.01 * np.exp(-v / 0.8),
    ),
    HiddenLaw(
        "cell_sticks",
        "observe",
        "torque",
        ("direction",),
        ("line", "step"),
        _observed("J", _cell_sticks),
        lambda s, v: s * 0.006 * v,
    ),
    HiddenLaw(
        "magnet_turns",
        "observe",
        "hall_2",
        ("travel",),
        ("line",),
        _observed("K", _magnet_turns),
        lambda s, v: s * 0.015 * v,
    ),
    HiddenLaw(
        "two_poles",
        "observe",
        "halls",
        ("angle",),
        ("sine",),
        _observed("L", _two_poles),
        lambda s, v: _DEG * s * 0.02 * np.cos(2.0 * v / _DEG),
        held_by="hall_harmonics",
    ),
    HiddenLaw(
        "encoder",
        "drive",
        "base",
        ("base_angle",),
        ("sine",),
        _driven("M", lambda t: 0.035 * (np.sin(t.base_angle_rad + 0.5) - math.sin(0.5))),
        lambda s, v: _DEG * s * 0.035 * np.sin(v / _DEG + 0.5),
        held_by="encoder_eccentricity",
    ),
    HiddenLaw(
        "gear",
        "drive",
        "base",
        ("base_angle",),
        ("sine",),
        _driven("N", lambda t: 0.02 * np.sin(3.0 * t.base_angle_rad)),
        lambda s, v: _DEG * s * 0.02 * np.sin(3.0 * v / _DEG),
        held_by="transmission_error",
    ),
    HiddenLaw(
        "chuck_creeps",
        "drive",
        "base",
        ("travel",),
        ("line",),
        _driven("O", lambda t: -0.01 * _turned(t)),
        lambda s, v: -s * 0.01 * v,
    ),
    HiddenLaw(
        "index_runs",
        "drive",
        "base",
        ("clock",),
        ("line",),
        _driven("P", lambda t: 0.001 * t.time_s),
        lambda s, v: _DEG * s * 0.001 * v,
    ),
    HiddenLaw(
        "slit",
        "torque",
        "section_3",
        _ANGLES[:1],
        ("sine",),
        _as_dataclass(Slit),
        lambda s, v: -s * 0.12 * np.sin(2.0 * v / _DEG),
    ),
    HiddenLaw(
        "stop",
        "torque",
        "tissue",
        _ANGLES[:1],
        ("line beyond",),
        _as_dataclass(Stop),
        lambda s, v: -s * 0.1 * np.maximum(v / _DEG - 0.61, 0.0),
    ),
    HiddenLaw(
        "detent",
        "torque",
        "tissue",
        _ANGLES[:1],
        ("sine",),
        _as_dataclass(Detent),
        lambda s, v: -s * 0.03 * np.sin(4.0 * v / _DEG),
    ),
    HiddenLaw(
        "pull",
        "torque",
        "tissue",
        ("x",),
        ("bump", "step"),
        _as_dataclass(Pull),
        lambda s, v: s * 0.04 * ((v >= 240.0) & (v <= 265.0)),
    ),
    HiddenLaw(
        "notch",
        "torque",
        "section_1",
        _ANGLES[:1],
        ("bump",),
        _as_dataclass(Notch),
        lambda s, v: s * 0.1 * np.exp(-(((v / _DEG - 0.52) / 0.25) ** 2)),
    ),
    HiddenLaw(
        "scar",
        "shape",
        "slip_limit",
        ("x",),
        ("bump",),
        _limited("Q", lambda x_mm, t: 2.0 * np.exp(-(((x_mm - 253.0) / 7.0) ** 2))),
        lambda s, v: s * 2.0 * np.exp(-(((v - 253.0) / 7.0) ** 2)),
        held_by="layered_friction",
    ),
    HiddenLaw(
        "soft_section",
        "shape",
        "stiffness",
        ("x",),
        ("bump", "step"),
        _as_dataclass(SoftSection),
        lambda s, v: _DEG * s * 150.0 * _FRICTION_N * ((v > 300.0) & (v < 335.0)),
    ),
    HiddenLaw(
        "kink",
        "shape",
        "rigidity",
        ("x",),
        ("bump",),
        _as_dataclass(Kink),
        lambda s, v: 1.0 / (1.0 + s * 0.8 * np.exp(-(((v - 280.0) / 40.0) ** 2))) - 1.0,
    ),
)
BY_NAME = {law.name: law for law in LAWS}
