"""The brain: one step a tick from measurement to command, through compensation, position loop and limits."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

from needle_rig.config.schema import RigConfig
from needle_rig.control.checked import Checked
from needle_rig.control.clearing import ClearHandshake, awake
from needle_rig.control.compensation import ACTIVE, Event, Sequence, Think, after, think_at_once
from needle_rig.control.faults import REFERENCE_SETTLES, Fault, FaultName
from needle_rig.control.in_si import limits_of, supervision_of
from needle_rig.control.limits import drive_faults, find_faults, gate, tick_fault
from needle_rig.control.listening import Listening
from needle_rig.control.manual import SEARCH_RAD_S, SETTLE_S, WINDOW_S, Turn
from needle_rig.control.pid import PositionLoop
from needle_rig.control.reports import BrainState, Outcome, Request, Status
from needle_rig.control.standing import StandingFaults
from needle_rig.control.strategy import SettledMotion, Strategy, Task, Trust, make_strategy
from needle_rig.control.tasks import Before, Tasks
from needle_rig.control.verdict import judge, outcome
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.records import (
    RELEASE,
    STOP,
    Command,
    DriveFault,
    DriveState,
    Measurement,
    Phase,
    Sample,
)
from needle_rig.units import deg, nm, rad

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel


STOPS_WITHIN_S = 0.1
"""A drive that was told to stop and runs on after so long obeys somebody else: it hears nothing any more."""


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
        self._tasks = Tasks(config, model, trust)
        self._limits = limits_of(config)
        self._supervision = supervision_of(config)
        self._index_rad = rad(config.drive.index_deg)
        self._listening = Listening(config.tick_hz)
        self._clearing = ClearHandshake()
        self._loop = PositionLoop(
            config.pid.kp_per_s, config.pid.ki_per_s2, config.pid.kd, self._limits.acceleration_rad_s2
        )
        self._phase = Phase.IDLE
        self._sequence: Sequence | None = None
        self._request: Request | None = None
        self._outcome: Outcome | None = None
        self._standing = StandingFaults()
        self._released = False
        self._letting_go_s = 0.0
        self._hold_rad: float | None = None
        self._command = STOP
        self._measurement: Measurement | None = None
        self._limited = False

    def compensate(self, request: Request) -> None:
        """Start a sequence at the next step; raises what `check` raises."""
        task, strategy = self._judged(request)
        config = self._sequence_config
        self._begin(task, strategy, config.torque_window_s)
        self._request = request

    def check(self, request: Request) -> None:
        """Judge a request without starting anything.

        Raises BadInput when it cannot be run, RigFault while a fault holds the drive.
        """
        self._judged(request)

    def jog(
        self, by_rad: float | None = None, to_rad: float | None = None, speed_rad_s: float | None = None
    ) -> None:
        """Turn the base by or to an angle, at the next step; raises BadInput or RigFault."""
        if (by_rad is None) == (to_rad is None):
            raise BadInput("give either how far to turn or where to, as in: needle-rig jog --by 5")
        self._refuse_unless_free()
        target_rad = to_rad if to_rad is not None else self._seen().base_angle_rad + (by_rad or 0.0)
        self._turn("jog", target_rad, speed_rad_s)

    def home(self, by: str = "angle", angle_rad: float = 0.0, speed_rad_s: float | None = None) -> None:
        """Bring the base to `angle_rad` (`by` angle), or find a zero that was lost.

        `by` hall takes what torque and first Hall angle say, index turns the base slowly until the index mark
        passes, here takes `angle_rad` as where the base stands. Raises BadInput or RigFault.
        """
        if by == "angle":
            self._refuse_unless_free()
            self._turn("home", angle_rad, speed_rad_s)
            return
        settled = self._settled_by(by)
        now = self._free_to_refer(by, settled)
        reference = self._supervision.reference
        if by == "hall":
            reference.tell(reference.by_hall_rad(now))
        elif by == "here":
            if not abs(angle_rad) <= self._limits.angle_rad:
                raise BadInput(
                    f"the base cannot stand at {deg(angle_rad):g}°, outside ±{deg(self._limits.angle_rad):g}°"
                    " (drive.angle_limit_deg)"
                )
            reference.tell(angle_rad)
        elif by == "index" and math.isnan(now.index_rad):
            self._search(now, speed_rad_s)
            return
        elif by == "index":
            reference.tell(reference.by_index_rad(now, self._index_rad))
        else:
            raise BadInput(f"home by {by!r} is unknown; there are angle, hall, index, here")
        self._standing.settle(settled)
        if not self._standing:
            self._phase = after(self._phase, Event.CLEAR)
        self._released = False

    def hold(self) -> None:
        """Keep the base where it stands, against the needle, until a release or a stop.

        Raises BadInput while something else goes on, RigFault while a fault holds the drive.
        """
        self._refuse_unless_free()
        self._phase = after(self._phase, Event.HOLD)
        self._sequence, self._request, self._outcome, self._hold_rad = None, None, None, None
        self._start_drive()

    def release(self) -> None:
        """Let go of the base: nothing is sent to the drive, its supply opens, and a hand may turn it.

        Raises BadInput while a sequence runs.
        """
        if self._phase in ACTIVE and self._phase is not Phase.HOLDING:
            raise BadInput("a sequence is running; stop it first: needle-rig stop")
        self._phase = after(self._phase, Event.RELEASE)
        self._released = True

    def stop(self, reason: str) -> Command:
        """Abort; the command returned, and every one from the next step on, stops the drive."""
        if self._phase in ACTIVE:
            self._end("aborted", f"aborted: {reason}")
        self._phase = after(self._phase, Event.ABORT)
        self._clearing.cancel()
        self._supervision.reference.searching = False
        self._command, self._limited = STOP, False
        return STOP

    def clear(self) -> None:
        """Leave a fault, an abort or a finished run; the drive is ordered to clear its own faults too.

        Raises BadInput while a sequence runs. A cause that is still there brings its fault back.
        """
        if self._phase in ACTIVE:
            raise BadInput("a sequence is running; stop it first: needle-rig stop")
        self._phase = after(self._phase, Event.CLEAR)
        self._standing.clear()
        self._released = False
        self._supervision.clear(self._measurement)
        seen = self._measurement
        faults, age_s = (seen.drive_faults, seen.drive_age_s) if seen else (DriveFault.NONE, math.inf)
        self._clearing.acknowledge(faults, age_s)

    def step(self, measurement: Measurement, dt_s: float) -> tuple[Command, Sample]:
        """One tick, `dt_s` after the last: what the drive is sent, and the row for the record."""
        self._measurement = measurement
        judged = self._listening.judged(measurement, dt_s)
        heard, found = self._look(measurement, judged, dt_s)
        self._fail(*found)
        if self._phase is Phase.FAULT and not self._standing:
            self._phase = after(self._phase, Event.CLEAR)
        self._command = self._act(judged, heard, dt_s)
        return self._command, self._sample(measurement, dt_s, self._command)

    @property
    def busy(self) -> bool:
        """Whether something goes on that wants ticks: a motion, a clear, a reference on its way."""
        wanted_rad = self._supervision.reference.wanted_rad
        return self._phase in ACTIVE or self._clearing.asked or wanted_rad is not None

    @property
    def state(self) -> BrainState:
        """A snapshot; see BrainState."""
        sequence, measurement = self._sequence, self._measurement
        waypoint = sequence.waypoint if sequence else None
        waiting, remaining = sequence.waiting(self._phase) if sequence else ("", None)
        if self._phase is Phase.HOLDING:
            waiting = "a release or a stop"
        fault = self._standing.first
        if fault is not None:
            waiting = "a clear" if fault.latching else f"the {fault.link} link"
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
            model=sequence.task.model.name if sequence and sequence.task.model else None,
            waypoint_rad=waypoint.angle_rad if waypoint else None,
            velocity_rad_s=self._command.velocity_rad_s,
            limited=self._limited,
            released=self._released,
            measurement=measurement,
            settled=self.settled,
            outcome=self._outcome,
            fault=self._standing.text or None,
            fault_name=fault.name.value if fault else None,
            latched=self._standing.latched,
        )

    @property
    def settled(self) -> tuple[SettledMotion, ...]:
        """Settled motions of the present or last sequence, without the rest before the first."""
        return self._sequence.history[1:] if self._sequence else ()

    def _expected(self) -> int:
        if self._sequence is None:
            return 0
        return max(self._sequence.expected, len(self.settled))

    def _judged(self, request: Request) -> tuple[Task, Strategy]:
        """What `request` means; raises BadInput or RigFault when it cannot be run."""
        self._refuse_unless_free()
        task = self._task(request)
        strategy = request.strategy
        if not isinstance(strategy, Strategy):
            strategy = make_strategy(strategy, request.options)
        strategy = Checked.of(strategy)
        strategy.check(task)
        return task, strategy

    def _refuse_unless_free(self, but: Collection[Fault] = ()) -> None:
        """Raise what a person must end first; the faults `but` may stand."""
        if self._phase is Phase.HOLDING:
            raise BadInput("the base is held; release it first: needle-rig release")
        if self._phase in ACTIVE:
            raise BadInput("a sequence is running; stop it first: needle-rig stop")
        others = self._standing.beside(but)
        if others:
            raise RigFault(others)

    def _settled_by(self, by: str) -> frozenset[Fault]:
        """Of the faults that stand, those that a new zero ends.

        A search turns the base: it serves a lost zero alone. A person's word also serves Hall sensors that
        lost their turns.
        """
        faults = frozenset(self._standing.all)
        if by == "index":
            return frozenset(fault for fault in faults if fault.name is FaultName.REFERENCE_LOST)
        if by == "here" and all(fault.link == "hall" for fault in faults):
            return faults
        return frozenset(fault for fault in faults if fault.name in REFERENCE_SETTLES)

    def _free_to_refer(self, by: str, settled: Collection[Fault]) -> Measurement:
        """The newest measurement, when the zero may be set now: at rest, with no fault that is in its way.

        A search needs a drive that turns; whoever sets the zero by hand may do so before a clear.
        """
        faults = self._standing.all
        asleep = [] if by == "index" else [fault for fault in faults if fault.link == "drive"]
        self._refuse_unless_free({*settled, *asleep})
        lost_turns = bool(settled) and all(fault.link == "hall" for fault in settled)
        if by == "here" and lost_turns and self._measurement is not None:
            return self._measurement
        return self._seen()

    def _seen(self) -> Measurement:
        """The newest measurement; RigFault when there is none that may be used."""
        if self._measurement is None:
            raise RigFault("no reading came yet; wait for the first one")
        _, found = find_faults(self._measurement, self._limits)
        for fault in found:
            if fault.name in (FaultName.LINK_DEAD, FaultName.NOT_A_NUMBER):
                raise RigFault(fault.text)
        return self._measurement

    def _begin(self, task: Task, strategy: Strategy, window_s: float) -> None:
        config = self._sequence_config
        self._sequence = Sequence(
            task, strategy, rad(config.still_deg), window_s, config.motion_timeout_s, self._think
        )
        self._request, self._outcome = None, None
        self._phase = after(self._phase, Event.START)
        self._start_drive()

    def _start_drive(self) -> None:
        self._released = False
        self._clearing.wake()
        self._loop.reset()
        self._supervision.begin()

    def _turn(self, motion: str, target_rad: float, speed_rad_s: float | None) -> None:
        request = Request(target_rad, Turn(motion), settle_s=SETTLE_S, speed_rad_s=speed_rad_s)
        self._begin(self._task(request), Turn(motion), WINDOW_S)

    def _search(self, now: Measurement, speed_rad_s: float | None) -> None:
        """Turn up to one turn, towards zero as far as is known, until the index mark passes."""
        reference = self._supervision.reference
        believed_rad = now.base_angle_rad if not now.hall_rad else reference.by_hall_rad(now)
        reach_rad = math.copysign(math.tau + rad(5.0), -believed_rad or 1.0)
        speed_rad_s = min(speed_rad_s or SEARCH_RAD_S, SEARCH_RAD_S)
        request = Request(
            now.base_angle_rad + reach_rad, Turn("index"), settle_s=SETTLE_S, speed_rad_s=speed_rad_s
        )
        task = self._task(request)
        self._standing.clear()
        if self._phase is Phase.FAULT:
            self._phase = after(self._phase, Event.CLEAR)
        self._begin(task, Turn("index"), WINDOW_S)
        reference.searching = True

    def _task(self, request: Request) -> Task:
        last, ended = self._sequence, self._outcome
        to_its_end = ended is not None and ended.status in ("aligned", "not_aligned")
        before = Before(last.task, last.strategy, last.history) if last and to_its_end else None
        return self._tasks.task(request, before)

    def _look(
        self, seen: Measurement, measurement: Measurement, dt_s: float
    ) -> tuple[frozenset[str], list[Fault]]:
        """The links that are heard, and everything that forbids motion.

        `measurement` is what was `seen`, with the ages that may be held against its links.
        """
        heard, found = find_faults(measurement, self._limits)
        wrong_tick = tick_fault(dt_s)
        if wrong_tick is not None:
            return heard, [*found, wrong_tick]
        found += filter(None, [self._listening.fault(seen, dt_s, self._limits)])
        self._clearing.step(measurement, dt_s)
        found += self._supervision.step(
            seen,
            heard,
            self._command,
            dt_s,
            unseen_s=measurement.drive_age_s,
            in_time=measurement is seen,
        )
        own = drive_faults(measurement.drive_state, measurement.drive_faults, measurement.drive_complaint)
        active = self._phase in ACTIVE
        if own and not self._clearing.covers(measurement):
            # one that passes is no fault at rest: the next order wakes the drive
            found += [fault for fault in own if fault.latching or active]
        elif active and not self._clearing.asked and not awake(measurement):
            text = "the drive fell silent by itself; check its supply"
            found.append(Fault(FaultName.DRIVE_RESTARTED, "drive", text, latching=False))
        return heard, found

    def _fail(self, *found: Fault) -> None:
        """Take what was found in this tick; a fault ends what goes on, a clear on its way too."""
        self._standing.take(found)
        first = self._standing.first if found else None
        if first is None:
            return
        self._clearing.cancel()
        self._supervision.reference.searching = False
        if self._phase in ACTIVE:
            self._end("fault", first.text, first.name.value)
        self._phase = after(self._phase, Event.FAULT)

    def _act(self, measurement: Measurement, heard: frozenset[str], dt_s: float) -> Command:
        self._limited = False
        if self._supervision.reference.wanted_rad is not None:
            return Command(reference_rad=self._supervision.reference.wanted_rad)
        if self._released or self._standing:
            # silence opens the supply; in mid-motion it is a fault to the drive, so a stop goes first
            self._letting_go_s += dt_s
            moving = measurement.drive_state is DriveState.RUNNING and "drive" in heard
            in_time = self._letting_go_s < STOPS_WITHIN_S
            return STOP if self._command.enable or (moving and in_time) else RELEASE
        self._letting_go_s = 0.0
        clear = self._clearing.command(measurement)
        if clear is not None:
            return clear
        if self._phase not in ACTIVE:
            return STOP
        wish = self._held(measurement, dt_s) if self._sequence is None else self._moved(measurement, dt_s)
        if wish is None:
            return STOP
        gated = gate(wish, measurement, self._command.velocity_rad_s, dt_s, self._limits)
        self._limited = gated.limited
        if gated.fault is not None:
            self._fail(gated.fault)
        return gated.command

    def _held(self, measurement: Measurement, dt_s: float) -> float:
        """The velocity that keeps the base where it stood when the drive woke up."""
        if self._hold_rad is None:
            self._hold_rad = measurement.base_angle_rad
        speed_rad_s = rad(self._sequence_config.speed_deg_s)
        return self._loop.step(measurement.base_angle_rad, self._hold_rad, speed_rad_s, dt_s)

    def _moved(self, measurement: Measurement, dt_s: float) -> float | None:
        """The velocity that the sequence asks for; None when it asks for none."""
        sequence = self._sequence
        assert sequence is not None
        if self._found_index(measurement):
            return None
        self._advance(sequence, measurement, dt_s)
        if self._phase not in ACTIVE or sequence.setpoint_rad is None:
            return None
        return self._loop.step(
            measurement.base_angle_rad,
            sequence.setpoint_rad,
            sequence.speed_rad_s,
            dt_s,
            sequence.feedforward_rad_s,
        )

    def _found_index(self, measurement: Measurement) -> bool:
        """Whether the index mark that was looked for has passed; the search is over then."""
        reference = self._supervision.reference
        if not reference.searching or math.isnan(measurement.index_rad):
            return False
        self._phase = after(self._phase, Event.FINISHED)
        reference.tell(reference.by_index_rad(measurement, self._index_rad))
        return True

    def _advance(self, sequence: Sequence, measurement: Measurement, dt_s: float) -> None:
        try:
            event = sequence.step(self._phase, measurement, dt_s)
        except NeedleRigError as refusal:
            self._fail(Fault(FaultName.CONTROL, "control", str(refusal), latching=False))
            return
        late = sequence.overdue()
        if event is not None:
            self._phase = after(self._phase, event)
            if event is Event.NEXT:
                self._supervision.motion()
        elif late is not None:
            self._fail(Fault(FaultName.NOT_TURNING, "drive", late, latching=True))
        if self._phase is Phase.DONE:
            self._supervision.reference.searching = False
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

    def _end(self, status: Status, text: str, fault_name: str | None = None) -> None:
        if self._sequence is not None:
            sequence = self._sequence
            ended = outcome(status, text, sequence.task, sequence.strategy, self.settled)
            self._outcome = replace(ended, fault_name=fault_name)

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
