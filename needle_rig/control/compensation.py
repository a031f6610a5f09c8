"""The compensation sequence as a state machine: move, settle, measure, ask the strategy, and again."""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future

from needle_rig.control.checked import Checked
from needle_rig.control.reports import settled_motion
from needle_rig.control.strategy import History, SettledMotion, Strategy, Task, Waypoint
from needle_rig.records import Measurement, Phase
from needle_rig.units import deg

Think = Callable[[Strategy, Task, History], "Waypoint | Future[Waypoint | None] | None"]
"""Asks a strategy for its next motion, and has it at once or later; raises BadInput or RigFault.

Who has it later takes longer than a tick: a daemon asks in another process.
"""

DITHER_FADE_S = 0.5


class Event(enum.StrEnum):
    """What moves the machine on."""

    START = "start"
    NEXT = "next"  # the strategy gave a waypoint
    ARRIVED = "arrived"
    SETTLED = "settled"
    DISTURBED = "disturbed"  # the base moved while the torque was averaged
    FINISHED = "finished"  # the strategy has nothing more to do, or what was looked for is found
    ABORT = "abort"
    FAULT = "fault"
    CLEAR = "clear"
    HOLD = "hold"
    RELEASE = "release"


# A fault outlives an abort: only a clear leaves it.
TRANSITIONS: dict[Phase, dict[Event, Phase]] = {
    Phase.IDLE: {
        Event.START: Phase.REST,
        Event.HOLD: Phase.HOLDING,
        Event.RELEASE: Phase.IDLE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
        Event.CLEAR: Phase.IDLE,
    },
    Phase.REST: {
        Event.NEXT: Phase.MOVING,
        Event.FINISHED: Phase.DONE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
    },
    Phase.MOVING: {
        Event.ARRIVED: Phase.SETTLING,
        Event.FINISHED: Phase.DONE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
    },
    Phase.SETTLING: {
        Event.SETTLED: Phase.MEASURING,
        Event.FINISHED: Phase.DONE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
    },
    Phase.MEASURING: {
        Event.DISTURBED: Phase.SETTLING,
        Event.NEXT: Phase.MOVING,
        Event.FINISHED: Phase.DONE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
    },
    Phase.HOLDING: {
        Event.RELEASE: Phase.IDLE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
    },
    Phase.DONE: {
        Event.START: Phase.REST,
        Event.HOLD: Phase.HOLDING,
        Event.RELEASE: Phase.IDLE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
        Event.CLEAR: Phase.IDLE,
    },
    Phase.ABORTED: {
        Event.START: Phase.REST,
        Event.HOLD: Phase.HOLDING,
        Event.RELEASE: Phase.IDLE,
        Event.ABORT: Phase.ABORTED,
        Event.FAULT: Phase.FAULT,
        Event.CLEAR: Phase.IDLE,
    },
    Phase.FAULT: {
        Event.RELEASE: Phase.FAULT,
        Event.ABORT: Phase.FAULT,
        Event.FAULT: Phase.FAULT,
        Event.CLEAR: Phase.IDLE,
    },
}
ACTIVE = frozenset({Phase.REST, Phase.MOVING, Phase.SETTLING, Phase.MEASURING, Phase.HOLDING})
"""Phases in which the drive may be enabled."""


def after(phase: Phase, event: Event) -> Phase:
    """The phase that follows; ValueError when `event` does not belong to `phase`."""
    try:
        return TRANSITIONS[phase][event]
    except KeyError:
        raise ValueError(f"event {event} does not belong to phase {phase}") from None


def think_at_once(strategy: Strategy, task: Task, history: History) -> Waypoint | None:
    """Ask within the tick. Raises BadInput or RigFault."""
    return Checked.of(strategy).next(task, history)


class Sequence:
    """One run of the machine from its start to done; knows no drive, only where the base should be."""

    def __init__(
        self,
        task: Task,
        strategy: Strategy,
        still_rad: float,
        window_s: float,
        timeout_s: float,
        think: Think = think_at_once,
    ) -> None:
        """Raises BadInput or RigFault where the strategy does not say how many motions it expects."""
        self.task = task
        self.strategy = Checked.of(strategy)
        self.expected = self.strategy.expected_motions()
        """Asked once: no tick calls the strategy but for its next motion."""
        self.waypoint: Waypoint | None = None
        self.history: tuple[SettledMotion, ...] = ()
        self._still_rad = still_rad
        self._window_s = window_s
        self._timeout_s = timeout_s
        self._think = think
        self._answer: Future[Waypoint | None] | None = None
        self._in_phase_s = 0.0
        self._in_motion_s = 0.0
        self._travel_s = 0.0
        self._hold_rad: float | None = None
        self._moved_s = math.nan
        self._recent: deque[tuple[float, float]] = deque()
        self._recent_s = 0.0
        self._sums: list[float] = []
        self._weight_s = 0.0
        self._progress = 0.0

    @property
    def setpoint_rad(self) -> float | None:
        """Where the base should be now, dither included; None before the drive is awake."""
        return None if self._hold_rad is None else self._hold_rad + self._dither(self._in_motion_s)[0]

    @property
    def feedforward_rad_s(self) -> float:
        """Velocity of the dither."""
        return self._dither(self._in_motion_s)[1]

    @property
    def speed_rad_s(self) -> float:
        """Speed of the present motion."""
        return self.task.pace(self.waypoint)[0]

    @property
    def settle_s(self) -> float:
        """Time that the present motion settles."""
        return self.task.pace(self.waypoint)[1]

    def step(self, phase: Phase, measurement: Measurement, dt_s: float) -> Event | None:
        """Advance by one tick; the event that it brings, or None. The caller applies it with `after`."""
        self._in_phase_s += dt_s
        self._in_motion_s += dt_s
        if self._hold_rad is None:
            self._hold_rad = measurement.base_angle_rad
        self._remember(measurement, dt_s)
        event = {
            Phase.REST: self._rest,
            Phase.MOVING: self._moving,
            Phase.SETTLING: self._settling,
            Phase.MEASURING: self._measuring,
        }[phase](measurement, dt_s)
        if event is not None:
            self._in_phase_s = 0.0
            self._sums, self._weight_s = [], 0.0
        return event

    def overdue(self) -> str | None:
        """A sentence when the present motion takes too long to come to rest, else None."""
        allowed = self._travel_s + self.settle_s + self._timeout_s
        if self._in_motion_s <= allowed or self._answer is not None:
            return None
        moved = deg(self._spread_rad())
        return (
            f"the base does not come to rest: it still moves by {moved:.2f}° after {self._in_motion_s:.1f} s,"
            f" limit {deg(self._still_rad):g}° (sequence.still_deg); check the drive,"
            " or raise sequence.motion_timeout_s"
        )

    def waiting(self, phase: Phase) -> tuple[str, float | None]:
        """What the sequence waits for, and the seconds left as far as known."""
        if self._answer is not None and phase in ACTIVE:
            return f"strategy {self.strategy.name} to plan the next motion", None
        if phase is Phase.REST:
            return "the rig to be at rest", max(0.0, self._window_s - self._weight_s)
        if phase is Phase.MOVING and self.waypoint is not None:
            where = f"the base to reach {deg(self.waypoint.angle_rad):.1f}°"
            if self.waypoint.note:
                where += f" ({self.waypoint.note})"
            return where, max(0.0, self._travel_s - self._in_phase_s)
        if phase is Phase.SETTLING:
            return "the needle to settle", max(0.0, self.settle_s - self._in_phase_s)
        if phase is Phase.MEASURING:
            return "the torque to be averaged", max(0.0, self._window_s - self._weight_s)
        return "", None

    def progress(self, phase: Phase) -> float:
        """Part of the whole sequence that is over, 0..1; estimated, never falling."""
        if phase is Phase.DONE:
            self._progress = 1.0
        elif self.history:
            done = len(self.history) - 1
            expected = max(self.expected, done + 1)
            length_s = self._travel_s + self.settle_s + self._window_s
            part = min(self._in_motion_s / length_s, 1.0)
            self._progress = max(self._progress, min((done + part) / expected, 0.99))
        return self._progress

    def _rest(self, measurement: Measurement, dt_s: float) -> Event | None:
        if self._answer is not None:
            return self._answered(self._answer, measurement)
        if self._spread_rad() > self._still_rad:
            self._sums, self._weight_s = [], 0.0
        self._average(measurement, dt_s)
        return self._decide(measurement) if self._weight_s >= self._window_s else None

    def _moving(self, measurement: Measurement, _dt_s: float) -> Event | None:
        assert self.waypoint is not None
        if abs(self.waypoint.angle_rad - measurement.base_angle_rad) > self._still_rad:
            return None
        return None if self._dither_amplitude(self._in_motion_s) > self._still_rad else Event.ARRIVED

    def _settling(self, _measurement: Measurement, _dt_s: float) -> Event | None:
        still = self._recent_s >= self._window_s * 0.99 and self._spread_rad() <= self._still_rad
        return Event.SETTLED if still and self._in_phase_s >= self.settle_s else None

    def _measuring(self, measurement: Measurement, dt_s: float) -> Event | None:
        if self._answer is not None:
            return self._answered(self._answer, measurement)
        if self._spread_rad() > self._still_rad:
            return Event.DISTURBED
        self._average(measurement, dt_s)
        return self._decide(measurement) if self._weight_s >= self._window_s else None

    def _decide(self, measurement: Measurement) -> Event | None:
        self.history = (*self.history, self._settled(measurement))
        answer = self._think(self.strategy, self.task, self.history)
        if isinstance(answer, Future):
            # read at a later tick, however soon it comes: virtual time then takes as many ticks in every run
            self._answer = answer
            return None
        return self._go(answer, measurement)

    def _answered(self, answer: Future[Waypoint | None], measurement: Measurement) -> Event | None:
        if not answer.done():
            return None
        self._answer = None
        return self._go(answer.result(), measurement)

    def _go(self, waypoint: Waypoint | None, measurement: Measurement) -> Event:
        if waypoint is None:
            return Event.FINISHED
        self.waypoint = waypoint
        self._hold_rad = waypoint.angle_rad
        self._in_motion_s = 0.0
        self._travel_s = abs(waypoint.angle_rad - measurement.base_angle_rad) / self.speed_rad_s
        self._moved_s = measurement.time_s
        return Event.NEXT

    def _settled(self, measurement: Measurement) -> SettledMotion:
        base, torque, *halls = (value / self._weight_s for value in self._sums)
        return settled_motion(
            self.task,
            self.waypoint,
            index=len(self.history),
            moved_s=self._moved_s if self.waypoint else measurement.time_s - self._weight_s,
            time_s=measurement.time_s,
            base_angle_rad=base,
            torque_nm=torque,
            hall_rad=tuple(halls),
        )

    def _average(self, measurement: Measurement, dt_s: float) -> None:
        row = (measurement.base_angle_rad, measurement.torque_nm, *measurement.hall_rad)
        self._sums = [s + v * dt_s for s, v in zip(self._sums or [0.0] * len(row), row, strict=True)]
        self._weight_s += dt_s

    def _remember(self, measurement: Measurement, dt_s: float) -> None:
        self._recent.append((dt_s, measurement.base_angle_rad))
        self._recent_s += dt_s
        while self._recent_s - self._recent[0][0] >= self._window_s:
            self._recent_s -= self._recent.popleft()[0]

    def _spread_rad(self) -> float:
        angles = [angle for _, angle in self._recent]
        return max(angles) - min(angles)

    def _dither_amplitude(self, time_s: float) -> float:
        if self.waypoint is None or self.waypoint.dither is None:
            return 0.0
        late_s = max(0.0, time_s - self._travel_s)
        return self.waypoint.dither.amplitude_rad * math.exp(-late_s / DITHER_FADE_S)

    def _dither(self, time_s: float) -> tuple[float, float]:
        amplitude = self._dither_amplitude(time_s)
        if amplitude == 0.0 or self.waypoint is None or self.waypoint.dither is None:
            return 0.0, 0.0
        rate = 2.0 * math.pi * self.waypoint.dither.frequency_hz
        return amplitude * math.sin(rate * time_s), amplitude * rate * math.cos(rate * time_s)
