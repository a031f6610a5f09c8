"""The plant: a rig made of the physics, in virtual time. Answers only through the needle model."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from needle_rig.config.schema import SimulationSection
from needle_rig.physics.effect import Reading, Trial
from needle_rig.physics.rod import Rod
from needle_rig.physics.solver import RodState
from needle_rig.records import Command, Measurement
from needle_rig.rig import RawReadings
from needle_rig.simulation.drive_guard import DriveGuard, GuardSettings
from needle_rig.simulation.motor import Motor, MotorSettings
from needle_rig.units import nm, rad

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel

Array = npt.NDArray[np.float64]
REMEMBERED = 64
"""Readings kept for effects on the sensors that look back (a stream that is late)."""
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
        self.guard = DriveGuard(guard)
        self.time_s = 0.0
        self._raw = raw
        self._place = (start_s, index, travel_before_rad)
        self._observers = model.acting("observe")
        self._random = np.random.default_rng(settings.seed)
        self._state: RodState | None = None
        self._timeless = _timeless(model.rod(self._trial([(0.0, 0.0)])))
        self._path: list[tuple[float, float]] = [(0.0, 0.0)]
        self._counter = 0
        self._recent: deque[tuple[float, float, float, Array]] = deque(maxlen=REMEMBERED)
        self._torque_nm = 0.0
        self._hall_rad: Array = np.zeros(len(model.layout.sensor_positions_m))
        self._solve()
        self._sense()

    async def open(self) -> None:
        """Nothing to connect."""

    async def close(self) -> None:
        """Nothing to release; the motor is braked."""
        self.motor.turn(0.0, powered=False)

    def write(self, command: Command) -> None:
        """Hand a command to the drive; it acts from the next `advance` on."""
        self.guard.receive(self._now_us, command)

    def advance(self, dt_s: float) -> None:
        """Let `dt_s` pass: drive guard, motor, needle, then one reading of every sensor."""
        self.guard.torque(self._now_us, self._torque_nm)
        velocity_rad_s = self.guard.step(self._now_us, self.motor.angle_rad)
        self.turn(velocity_rad_s, dt_s, powered=self.guard.powered)

    def turn(self, velocity_rad_s: float, dt_s: float, *, powered: bool = True) -> None:
        """Like `advance`, with the motor's command given from outside: for nodes that guard it themselves."""
        self.motor.turn(velocity_rad_s, powered=powered)
        moves = self.motor.advance(dt_s, self._torque_nm)
        self._path += [(self.time_s + t, angle) for t, angle in moves]
        self.time_s += dt_s
        start = self._path[0][1]
        if not self._timeless or any(abs(angle - start) > UNNOTICED_RAD for _, angle in self._path):
            self._solve()
        else:
            del self._path[1:]
        self._sense()

    def read(self) -> Measurement:
        """What the sensors showed at the end of the last `advance`."""
        return self._measurement

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

    def _sense(self) -> None:
        settings, random = self.settings, self._random
        torque, hall = self._torque_nm, self._hall_rad
        if self._observers:
            torque, hall = self._observed()
        torque += nm(settings.torque_noise_nmm) * random.standard_normal()
        hall = hall + rad(settings.hall_noise_deg) * random.standard_normal(len(hall))
        torque = _quantised(torque, nm(settings.torque_step_nmm))
        angles = tuple((np.rint(hall / rad(settings.hall_step_deg)) * rad(settings.hall_step_deg)).tolist())
        base = _quantised(self.motor.angle_rad, rad(settings.encoder_step_deg))
        self._measurement = Measurement(
            time_s=self.time_s,
            base_angle_rad=base,
            torque_nm=torque,
            hall_rad=angles,
            drive_state=self.guard.state,
            drive_faults=self.guard.faults,
            torque_age_s=0.0,
            hall_age_s=0.0,
            drive_age_s=0.0,
        )
        if self._raw is not None:
            stamp = (self.time_s, self.time_s, float(self._counter))
            self._raw("torque", (*stamp, torque))
            self._raw("hall", (*stamp, *angles))
            self._raw("drive", (*stamp, base, float(self.guard.state), float(self.guard.faults)))
            self._counter += 1

    def _observed(self) -> tuple[float, Array]:
        self._recent.append((self.time_s, self.motor.angle_rad, self._torque_nm, self._hall_rad))
        trial = self._trial([(time, angle) for time, angle, _, _ in self._recent])
        reading = Reading(
            trial,
            np.array([torque for _, _, torque, _ in self._recent]),
            np.array([hall for _, _, _, hall in self._recent]),
        )
        for effect in self._observers:
            reading = effect.observe(reading)
        return float(reading.torque_nm[-1]), reading.hall_rad[-1]


def _timeless(rod: Rod) -> bool:
    """Whether the needle does nothing while its base stands still."""
    creeps = np.isfinite(rod.creep_viscosity_nms_per_rad).any()
    ages = rod.static_excess.any() or rod.ageing_per_decade.any()
    return not (creeps or ages or rod.viscous_nms_per_rad.any() or rod.laws)


def _quantised(value: float, step: float) -> float:
    return round(value / step) * step
