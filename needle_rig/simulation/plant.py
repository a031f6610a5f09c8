"""The plant: a rig made of the physics, in virtual time. Answers only through the needle model."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from needle_rig.config.schema import SimulationSection
from needle_rig.numerics import Array
from needle_rig.physics.effect import Reading, Trial
from needle_rig.physics.needle_model import NeedleModel, shown
from needle_rig.physics.rod import Rod
from needle_rig.physics.solution import RodState
from needle_rig.records import Command, DriveState, Firmware, Measurement
from needle_rig.rig import RawReadings
from needle_rig.simulation.drive.drive_guard import DriveGuard, GuardSettings
from needle_rig.simulation.drive.motor import Motor, MotorSettings
from needle_rig.simulation.drive.velocity_loop import VelocityLoop
from needle_rig.simulation.faults import Faults, Links, over_index
from needle_rig.units import nm, rad

REMEMBERED = 64
"""Readings kept for effects on the sensors that look back (a stream that is late)."""
_LINKS = {
    "torque": ("torque_nm",),
    "hall": ("hall_rad",),
    "drive": ("base_angle_rad", "drive_state", "drive_faults", "referenced", "supply_on", "emergency_stop"),
}
_NOISE_BLOCK = 256
"""Samples whose noise is drawn at once: a draw of its own costs as much as the block."""
UNNOTICED_RAD = rad(0.001)
"""A needle that depends on no rate is solved again when its base has moved this far: 1e-5 N·mm."""


class Plant:
    """Needle, motor, drive guard and sensors; implements Rig. Deterministic under `settings.seed`.

    Time passes only in `advance`. `start_s`, `index` and `travel_before_rad` place the run in a series, for
    effects that depend on it; `load_nm` is an extra torque on the motor alone.
    """

    def __init__(
        self,
        model: NeedleModel,
        settings: SimulationSection,
        *,
        raw: RawReadings | None = None,
        guard: GuardSettings | None = None,
        load_nm: float = 0.0,
        start_s: float = 0.0,
        index: int = 0,
        travel_before_rad: float = 0.0,
    ) -> None:
        self.model = model
        self.settings = settings
        self.motor = Motor(
            MotorSettings(
                gain=settings.drive_gain,
                delay_s=settings.drive_delay_ms * 1e-3,
                time_constant_s=settings.drive_time_constant_ms * 1e-3,
                droop_rad_s_per_nm=rad(settings.drive_droop_deg_s_per_nmm) / nm(1.0),
                load_nm=load_nm,
            )
        )
        self.faults = Faults()
        self.links = Links()
        """Between this plant and a host without nodes."""
        self.supply_on = True
        """Whether the motor has its supply: decided by the guard in `advance`, by nodes before `turn`."""
        self._resolution = (
            nm(settings.torque_noise_nmm),
            nm(settings.torque_step_nmm),
            rad(settings.hall_noise_deg),
            rad(settings.hall_step_deg),
            rad(settings.encoder_step_deg),
        )
        self._guard_settings = guard
        self._commands = 0
        self._index_rad = math.nan
        self.time_s = 0.0
        self._raw = raw
        self._place = (start_s, index, travel_before_rad)
        self._observers = model.acting("observe")
        self._random = np.random.default_rng(settings.seed)
        self._noise: Iterator[list[float]] = iter(())
        self._state: RodState | None = None
        self._timeless = _timeless(model.rod(self._trial([(0.0, 0.0)])))
        self._path: list[tuple[float, float]] = [(0.0, 0.0)]
        self._encoder_rad = 0.0
        self._sampled_s = {"torque": 0.0, "hall": 0.0, "drive": 0.0}
        self._counter = 0
        self._recent: deque[_Instant] = deque(maxlen=REMEMBERED)
        self._torque_nm = self._torque_read_nm = 0.0
        self._hall_rad: Array = np.zeros(len(model.layout.sensor_positions_m))
        self._hall_told: list[float] = []
        self._solve()
        self.reset_drive()
        self._sense()

    async def open(self) -> None:
        """Nothing to connect."""

    def firmware(self) -> dict[str, Firmware]:
        """It has no nodes."""
        return {}

    async def close(self) -> None:
        """Nothing to release; the motor is braked."""
        self.motor.turn(0.0, powered=False)

    def write(self, command: Command) -> None:
        """Hand a command to the drive; it acts from the next `advance` on."""
        if command.release:
            return
        self._commands += 1
        if self.links.command.fault:
            return
        self.guard.receive(self._now_us, command, self._commands, self._commands)
        angle_rad = command.reference_rad
        if angle_rad is not None and self.guard.reference(self._now_us, self._commands, angle_rad):
            self._index_rad += angle_rad - self._base_rad()
            self._zero_rad = self._encoder_rad - angle_rad

    def reset_drive(self) -> None:
        """The drive restarts: it is silent and takes the place where it stands for zero."""
        self.guard = DriveGuard(self._guard_settings)
        self._loop = VelocityLoop(self.guard.motion)
        self._zero_rad = self._encoder_rad
        self._index_rad = math.nan

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass: drive guard, motor, needle, then one reading of every sensor."""
        guard, angle_rad = self.guard, self._base_rad()
        if self.links.torque.fault != "silence":
            guard.torque(self._now_us, self._torque_read_nm)
        stop = self.faults.emergency_stop
        permitted_rad_s = guard.step(self._now_us, angle_rad, self._loop.asked, emergency_stop=stop)
        self.supply_on = guard.supply
        if guard.state is DriveState.RUNNING:
            velocity_rad_s = self._loop.step(permitted_rad_s, angle_rad, guard.torque_nm, dt_s)
        else:
            velocity_rad_s = 0.0
            self._loop.reset()
        self.turn(velocity_rad_s, dt_s, powered=velocity_rad_s != 0.0)

    def turn(self, velocity_rad_s: float, dt_s: float, *, powered: bool = True) -> None:
        """Like `advance`, with the motor's command given from outside: for nodes that guard it themselves."""
        faults = self.faults
        if not self.supply_on and not faults.supply_welded:
            self.motor.turn_now(0.0, powered=False)
        elif faults.shorted_rad_s is not None:
            self.motor.turn(faults.shorted_rad_s)
        else:
            self.motor.turn(velocity_rad_s * faults.motor_gain, powered=powered)
        self._pass(dt_s)

    def turn_by_hand(self, velocity_rad_s: float, dt_s: float) -> None:
        """Like `turn`, by a person: the motor, which is off, gives way."""
        self.motor.turn_now(velocity_rad_s, powered=True)
        self._pass(dt_s)

    def _pass(self, dt_s: float) -> None:
        shaft_rad, needle_rad = self.motor.angle_rad, self._path[-1][1]
        was_over = over_index(shaft_rad)
        grip = 1.0 - self.faults.coupling_slip
        moves = self.motor.advance(dt_s, self._torque_nm)
        self._path += [(self.time_s + t, needle_rad + grip * (angle - shaft_rad)) for t, angle in moves]
        self.time_s += dt_s
        start = self._path[0][1]
        if not self._timeless or any(abs(angle - start) > UNNOTICED_RAD for _, angle in self._path):
            self._solve()
        else:
            del self._path[1:-1]
        self._sense()
        if over_index(self.motor.angle_rad) and not was_over:
            self._index_rad = self._base_rad()

    def read(self) -> Measurement:
        """What the sensors showed at the end of the last `advance`."""
        return self._measurement

    @property
    def true_base_rad(self) -> float:
        """True angle of the motor's shaft."""
        return self.motor.angle_rad

    @property
    def torque_nm(self) -> float:
        """True base torque."""
        return self._torque_nm

    @property
    def hall_rad(self) -> Array:
        """True needle angles at the sensors, shape (sensors,)."""
        return self._hall_rad

    def shaft_rad(self) -> Array:
        """True angle of every node, shape (nodes,); places are `model.rod(...).position_m`."""
        assert self._state is not None
        return self._state.angle_rad

    @property
    def _now_us(self) -> int:
        return round(self.time_s * 1e6)

    def _base_rad(self) -> float:
        """The base's angle as the drive counts it."""
        return self._encoder_rad - self._zero_rad

    def _trial(self, path: list[tuple[float, float]]) -> Trial:
        times, angles = np.array(path).T
        start_s, index, travel = self._place
        return Trial(np.ascontiguousarray(times), np.ascontiguousarray(angles), start_s, index, travel)

    def _solve(self) -> None:
        solution = self.model.truth(self._trial(self._path), self._state)
        self._path = [(self.time_s, self._path[-1][1])]
        self._state = solution.state
        self._torque_nm = float(solution.torque_nm[-1])
        self._hall_rad = solution.sensor_rad[-1]
        self._hall_told = self._hall_rad.tolist()

    def _drawn(self) -> list[float]:
        """Standard normal noise of one sample: of the torque, then of every Hall sensor."""
        if (noise := next(self._noise, None)) is None:
            block = self._random.standard_normal((_NOISE_BLOCK, 1 + len(self._hall_rad)))
            self._noise = iter(block.tolist())
            noise = next(self._noise)
        return noise

    def _sense(self) -> None:
        spread_nm, step_nm, spread_rad, step_rad, base_step_rad = self._resolution
        torque_noise, *hall_noise = self._drawn()
        torque, hall = self._torque_nm, self._hall_told
        if self._observers:
            torque, hall = self._observed()
        torque += spread_nm * torque_noise
        faults = self.faults
        torque = faults.torque.of(_quantised(torque, step_nm))
        angles = tuple(
            [
                _quantised(angle + spread_rad * noise, step_rad)
                for angle, noise in zip(hall, hall_noise, strict=True)
            ]
        )
        if faults.hall:
            angles = tuple(
                faults.hall[i].of(angle) if i in faults.hall else angle for i, angle in enumerate(angles)
            )
        self._encoder_rad = faults.encoder.of(self.motor.angle_rad)
        self._torque_read_nm = torque
        base = _quantised(self._base_rad(), base_step_rad)
        self._measurement = self._arrived(
            Measurement(
                time_s=self.time_s,
                base_angle_rad=base,
                torque_nm=torque,
                hall_rad=angles,
                drive_state=self.guard.state,
                drive_faults=self.guard.faults,
                torque_age_s=0.0,
                hall_age_s=0.0,
                drive_age_s=0.0,
                referenced=self.guard.referenced,
                supply_on=self.guard.supply,
                emergency_stop=faults.emergency_stop,
                index_rad=self._index_rad,
            )
        )
        if self._raw is not None:
            stamp = (self.time_s, self.time_s, float(self._counter))
            self._raw("torque", (*stamp, torque))
            self._raw("hall", (*stamp, *angles))
            self._raw("drive", (*stamp, base, float(self.guard.state), float(self.guard.faults)))
            self._counter += 1

    def _arrived(self, now: Measurement) -> Measurement:
        """`now` with what links that fail keep back: their values stay, and grow old."""
        links = self.links
        if not (links.torque.fault or links.hall.fault or links.drive.fault or links.hall_faded):
            self._sampled_s = dict.fromkeys(_LINKS, self.time_s)
            return now
        kept: dict[str, object] = {}
        for link, fields in _LINKS.items():
            if getattr(self.links, link).fault or (link == "hall" and self.links.hall_faded):
                kept |= {name: getattr(self._measurement, name) for name in fields}
                kept[f"{link}_age_s"] = self.time_s - self._sampled_s[link]
            else:
                self._sampled_s[link] = self.time_s
        return replace(now, **kept) if kept else now  # type: ignore[arg-type]

    def _observed(self) -> tuple[float, list[float]]:
        now = _Instant(self.time_s, self._path[-1][1], self._torque_nm, self._hall_rad)
        recent = [*self._recent, now]
        truth = Reading(
            self._trial([(instant.time_s, instant.base_rad) for instant in recent]),
            np.array([instant.torque_nm for instant in recent]),
            np.array([instant.hall_rad for instant in recent]),
        )
        reading, states = shown(self._observers, truth, recent[0].states)
        self._recent.append(now._replace(states=states))
        return float(reading.torque_nm[-1]), reading.hall_rad[-1].tolist()


class _Instant(NamedTuple):
    """The truth at one reading, and the states there of the effects on the sensors."""

    time_s: float
    base_rad: float
    torque_nm: float
    hall_rad: Array
    states: tuple[float | None, ...] = ()


def _timeless(rod: Rod) -> bool:
    """Whether the needle does nothing while its base stands still."""
    creeps = np.isfinite(rod.creep_viscosity_nms_per_rad).any()
    ages = rod.static_excess.any() or rod.ageing_per_decade.any()
    return not (creeps or ages or rod.viscous_nms_per_rad.any() or rod.laws)


def _quantised(value: float, step: float) -> float:
    return round(value / step) * step
