"""The brain: one step a tick from measurement to command, through compensation, position loop and limits."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from needle_rig.config.schema import RigConfig
from needle_rig.control.compensation import ACTIVE, Event, Sequence, Think, after, think_at_once
from needle_rig.control.limits import Fault, Limits, find_fault, gate, heard_age_s, tick_fault
from needle_rig.control.pid import PositionLoop
from needle_rig.control.reports import BrainState, Outcome, Request, SettledMotion, Status
from needle_rig.control.strategy import Strategy, Task, Trust, make_strategy
from needle_rig.control.verdict import judge, outcome
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.physics.rod import Layout
from needle_rig.records import STOP, Command, DriveState, Measurement, Phase, Sample
from needle_rig.units import deg, m, nm, rad

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel

CLEAR_S = 1.0
"""How long a clear is repeated to the drive before its faults count again."""
CLEAR_EVERY = 4
"""Ticks from one clear to the next: the drive takes only one that follows a command without."""
LISTENING_PERIODS = 2.0
"""Of a longer tick only so much counts as time in which the links were listened to."""


class Brain:
    """Runs sequences; pure, so that the same brain serves the daemon's tick and virtual time."""

    def __init__(
        self,
        config: RigConfig,
        model: NeedleModel | None = None,
        think: Think = think_at_once,
        trust: Trust | None = None,
    ) -> None:
        """`model` is for strategies that plan with one; the others know layout and needle constants only.
        `trust` is what its file says of its uncertainties and errors.

        `think` asks a strategy for its next motion and gives a Future; a daemon asks in another process, and
        the base holds still until the answer is there.
        """
        self._think = think
        self._sequence_config = config.sequence
        self._model = model
        self._trust = trust or Trust()
        self._layout = layout_of(config)
        self._torsional_rigidity_nm2 = torsional_rigidity_nm2(config)
        self._limits = limits_of(config)
        self._listening_s = LISTENING_PERIODS / config.tick_hz
        self._heard_age_s: tuple[float, ...] = (math.inf, math.inf, math.inf)
        self._loop = PositionLoop(
            config.pid.kp_per_s, config.pid.ki_per_s2, config.pid.kd, self._limits.acceleration_rad_s2
        )
        self._phase = Phase.IDLE
        self._sequence: Sequence | None = None
        self._request: Request | None = None
        self._outcome: Outcome | None = None
        self._fault: Fault | None = None
        self._clear_s = 0.0
        self._tick = 0
        self._measurement: Measurement | None = None
        self._velocity_rad_s = 0.0
        self._limited = False

    def compensate(self, request: Request) -> None:
        """Start a sequence at the next step.

        Raises BadInput when the request cannot be run, RigFault while a fault holds the drive.
        """
        if self._phase in ACTIVE:
            raise BadInput("a sequence is running; stop it first: needle-rig stop")
        if self._phase is Phase.FAULT and self._fault is not None:
            raise RigFault(self._fault.text)
        task = self._task(request)
        strategy = request.strategy
        if not isinstance(strategy, Strategy):
            strategy = make_strategy(strategy, request.options)
        strategy.check(task)
        config = self._sequence_config
        self._sequence = Sequence(
            task,
            strategy,
            rad(config.still_deg),
            config.torque_window_s,
            config.motion_timeout_s,
            self._think,
        )
        self._request, self._outcome = request, None
        self._phase = after(self._phase, Event.START)
        self._clear_s = CLEAR_S
        self._loop.reset()

    def stop(self, reason: str) -> Command:
        """Abort; the command returned, and every one from the next step on, stops the drive."""
        if self._phase in ACTIVE:
            self._end("aborted", f"aborted: {reason}")
        self._phase = after(self._phase, Event.ABORT)
        self._velocity_rad_s, self._limited = 0.0, False
        return STOP

    def clear(self) -> None:
        """Leave a fault, an abort or a finished run; the drive is told to clear its own faults too.

        Raises BadInput while a sequence runs. A cause that is still there brings its fault back.
        """
        if self._phase in ACTIVE:
            raise BadInput("a sequence is running; stop it first: needle-rig stop")
        self._phase = after(self._phase, Event.CLEAR)
        self._fault = None
        self._clear_s = CLEAR_S

    def step(self, measurement: Measurement, dt_s: float) -> tuple[Command, Sample]:
        """One tick, `dt_s` after the last: what the drive is told, and the row for the record."""
        self._measurement = measurement
        self._tick += 1
        judged = self._as_heard(measurement, dt_s)
        fault = self._look(judged, dt_s)
        if fault is not None:
            self._fail(fault)
        elif self._phase is Phase.FAULT and self._fault is not None and not self._fault.latching:
            self._phase, self._fault = after(self._phase, Event.CLEAR), None
        command = self._act(judged, dt_s)
        self._velocity_rad_s = command.velocity_rad_s
        return command, self._sample(measurement, dt_s, command)

    @property
    def state(self) -> BrainState:
        """A snapshot; see BrainState."""
        sequence, measurement = self._sequence, self._measurement
        waypoint = sequence.waypoint if sequence else None
        waiting, remaining = sequence.waiting(self._phase) if sequence else ("", None)
        if self._phase is Phase.FAULT and self._fault is not None:
            waiting = "a clear" if self._fault.latching else f"the {self._fault.link} link"
        return BrainState(
            time_s=measurement.time_s if measurement else 0.0,
            phase=self._phase,
            motion=waypoint.name if waypoint else ("rest" if self._phase is Phase.REST else ""),
            motion_index=len(self.settled) + (self._phase in ACTIVE and waypoint is not None),
            motions_expected=self._expected(),
            waiting_for=waiting,
            remaining_s=remaining,
            progress=sequence.progress(self._phase) if sequence else 0.0,
            target_rad=sequence.task.target_rad if sequence else None,
            strategy=sequence.strategy.name if sequence else None,
            waypoint_rad=waypoint.angle_rad if waypoint else None,
            velocity_rad_s=self._velocity_rad_s,
            limited=self._limited,
            measurement=measurement,
            settled=self.settled,
            outcome=self._outcome,
            fault=self._fault.text if self._fault else None,
            latched=self._fault is not None and self._fault.latching,
        )

    @property
    def settled(self) -> tuple[SettledMotion, ...]:
        """Settled motions of the present or last sequence, without the rest before the first."""
        return self._sequence.history[1:] if self._sequence else ()

    def _expected(self) -> int:
        if self._sequence is None:
            return 0
        return max(self._sequence.strategy.expected_motions(self._sequence.task), len(self.settled))

    def _task(self, request: Request) -> Task:
        limit = self._limits.angle_rad
        if not math.isfinite(request.target_rad):
            raise BadInput(
                f"the target is {request.target_rad}, not an angle; give degrees, as in --target 45"
            )
        if abs(request.target_rad) > limit:
            raise BadInput(
                f"the target {deg(request.target_rad):g}° is outside ±{deg(limit):g}° (drive.angle_limit_deg)"
            )
        config = self._sequence_config
        settle_s = config.settle_s if request.settle_s is None else request.settle_s
        if not 0.1 <= settle_s <= 600.0:
            raise BadInput(f"the settling time {settle_s} s is outside 0.1 to 600 s")
        speed = rad(config.speed_deg_s) if request.speed_rad_s is None else request.speed_rad_s
        if not 0.0 < speed <= self._limits.velocity_rad_s:
            raise BadInput(
                f"the speed {deg(speed):g}°/s is outside 0 to {deg(self._limits.velocity_rad_s):g}°/s"
                " (drive.velocity_limit_deg_s)"
            )
        before = (
            self._sequence if self._outcome and self._outcome.status in ("aligned", "not_aligned") else None
        )
        lag_left = request.lag_left_rad
        extra_before_deg = 0.0
        if lag_left is None and before is not None:
            lag_left = before.task.target_rad - before.history[-1].hall_rad[-1]
            lag_left *= math.copysign(1.0, before.task.target_rad)
            extra_before_deg = before.strategy.extra_used_deg(before.task)
        return Task(
            target_rad=request.target_rad,
            layout=self._layout,
            torsional_rigidity_nm2=self._torsional_rigidity_nm2,
            speed_rad_s=speed,
            settle_s=settle_s,
            angle_limit_rad=limit,
            velocity_limit_rad_s=self._limits.velocity_rad_s,
            acceleration_limit_rad_s2=self._limits.acceleration_rad_s2,
            model=self._model,
            trust=self._trust,
            lag_left_rad=lag_left,
            extra_before_deg=extra_before_deg,
        )

    def _as_heard(self, measurement: Measurement, dt_s: float) -> Measurement:
        """`measurement` with the ages that may be held against its links; see `heard_age_s`."""
        ages_s = (measurement.torque_age_s, measurement.hall_age_s, measurement.drive_age_s)
        torque_s, hall_s, drive_s = self._heard_age_s = tuple(
            heard_age_s(before_s, age_s, dt_s, self._listening_s)
            for before_s, age_s in zip(self._heard_age_s, ages_s, strict=True)
        )
        if self._heard_age_s == ages_s:
            return measurement
        return replace(measurement, torque_age_s=torque_s, hall_age_s=hall_s, drive_age_s=drive_s)

    def _look(self, measurement: Measurement, dt_s: float) -> Fault | None:
        """What forbids motion now. While a clear goes out, the drive's own faults are not news."""
        fault = find_fault(measurement, self._limits) or tick_fault(dt_s)
        awake = measurement.drive_state in (DriveState.READY, DriveState.RUNNING)
        if self._clear_s > 0.0:
            drive_says = measurement.drive_state is DriveState.FAULT or bool(measurement.drive_faults)
            self._clear_s = 0.0 if awake and not drive_says else self._clear_s - dt_s
            if fault is not None and fault.link == "drive" and drive_says:
                return None
        elif fault is None and self._phase in ACTIVE and not awake:
            return Fault("drive", "the drive restarted by itself; check its supply", latching=False)
        return fault

    def _fail(self, fault: Fault) -> None:
        if self._phase in ACTIVE:
            self._end("fault", fault.text)
        if self._fault is None or not self._fault.latching:
            self._fault = fault
        self._phase = after(self._phase, Event.FAULT)

    def _act(self, measurement: Measurement, dt_s: float) -> Command:
        self._limited = False
        awake = measurement.drive_state in (DriveState.READY, DriveState.RUNNING)
        passing = self._fault is not None and not self._fault.latching
        clearing = self._clear_s > 0.0 or (passing and measurement.drive_state is DriveState.FAULT)
        if clearing and not awake:
            return Command(clear=self._tick % CLEAR_EVERY == 0)
        sequence = self._sequence
        if sequence is None or self._phase not in ACTIVE:
            return STOP
        self._advance(sequence, measurement, dt_s)
        if self._phase not in ACTIVE or sequence.setpoint_rad is None:
            return STOP
        wish = self._loop.step(
            measurement.base_angle_rad,
            sequence.setpoint_rad,
            sequence.speed_rad_s,
            dt_s,
            sequence.feedforward_rad_s,
        )
        gated = gate(wish, measurement, self._velocity_rad_s, dt_s, self._limits)
        self._limited = gated.limited
        if gated.fault is not None:
            self._fail(gated.fault)
        return gated.command

    def _advance(self, sequence: Sequence, measurement: Measurement, dt_s: float) -> None:
        try:
            event = sequence.step(self._phase, measurement, dt_s)
        except NeedleRigError as refusal:
            self._fail(Fault("control", str(refusal), latching=False))
            return
        late = sequence.overdue()
        if event is not None:
            self._phase = after(self._phase, event)
        elif late is not None:
            self._fail(Fault("drive", late, latching=False))
        if self._phase is Phase.DONE and self._request is not None:
            config = self._sequence_config
            self._outcome = judge(
                sequence.task,
                sequence.strategy,
                self.settled or sequence.history,
                rad(config.aligned_deg),
                nm(config.aligned_torque_nmm),
                self._request.run,
            )

    def _end(self, status: Status, text: str) -> None:
        if self._sequence is not None:
            sequence = self._sequence
            self._outcome = outcome(status, text, sequence.task, sequence.strategy, self.settled)

    def _sample(self, measurement: Measurement, dt_s: float, command: Command) -> Sample:
        waypoint = self._sequence.waypoint if self._sequence else None
        return Sample(
            time_s=measurement.time_s,
            dt_s=dt_s,
            phase=self._phase,
            motion=waypoint.name if waypoint else "rest",
            base_angle_rad=measurement.base_angle_rad,
            torque_nm=measurement.torque_nm,
            hall_rad=measurement.hall_rad,
            waypoint_rad=waypoint.angle_rad if waypoint else math.nan,
            velocity_rad_s=command.velocity_rad_s,
            enable=command.enable,
            limited=self._limited,
            drive_state=measurement.drive_state,
            drive_faults=measurement.drive_faults,
            torque_age_s=measurement.torque_age_s,
            hall_age_s=measurement.hall_age_s,
            drive_age_s=measurement.drive_age_s,
        )


def layout_of(config: RigConfig) -> Layout:
    """The layout of a rig file in metres."""
    return Layout(
        needle_length_m=m(config.needle.length_mm),
        tissue_sections_m=tuple((m(a), m(b)) for a, b in config.layout.tissue_sections_mm),
        sensor_positions_m=tuple(m(sensor.position_mm) for sensor in config.layout.hall_sensors),
    )


def torsional_rigidity_nm2(config: RigConfig) -> float:
    """JG of the needle in N·m²: as stated, or shear modulus times π d⁴/32."""
    if config.needle.torsional_rigidity_nmm2 is not None:
        return config.needle.torsional_rigidity_nmm2 * 1e-6
    diameter = m(config.needle.diameter_mm)
    return config.needle.shear_modulus_gpa * 1e9 * math.pi * diameter**4 / 32.0


def limits_of(config: RigConfig) -> Limits:
    """The gate's limits of a rig file in SI."""
    return Limits(
        angle_rad=rad(config.drive.angle_limit_deg),
        velocity_rad_s=rad(config.drive.velocity_limit_deg_s),
        acceleration_rad_s2=rad(config.drive.acceleration_limit_deg_s2),
        torque_nm=nm(config.drive.torque_limit_nmm),
        torque_age_s=config.links.torque_age_limit_ms * 1e-3,
        hall_age_s=config.links.hall_age_limit_ms * 1e-3,
        drive_age_s=config.links.drive_age_limit_ms * 1e-3,
    )
