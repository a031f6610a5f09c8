"""The daemon: owns the rig, runs the tick, and does what is asked over its socket."""

from __future__ import annotations

import asyncio
import dataclasses
import hashlib
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import structlog

from needle_rig.control.brain import Brain
from needle_rig.control.compensation import ACTIVE
from needle_rig.control.faults import FaultName
from needle_rig.control.reports import BrainState, Request
from needle_rig.control.strategy import Trust
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.numerics import rounded
from needle_rig.records import Phase, Sample
from needle_rig.service.api.api_link import ApiLink
from needle_rig.service.api.documents import Ended, Message, Moved, Node, Started, State, Ticks, Told, Whole
from needle_rig.service.api.lease import LEASE_S, Claim, Lease
from needle_rig.service.api.orders import Holder, Home, Jog, Model, Order, Reason, read_order
from needle_rig.service.installed.logbook import Logbook
from needle_rig.service.recorder.recorder import Recorder
from needle_rig.service.tick import report
from needle_rig.service.tick.loop import ControlLoop
from needle_rig.service.tick.rates import Rates
from needle_rig.service.tick.repeats import Repeats
from needle_rig.units import rad
from needle_rig.version import VERSION

if TYPE_CHECKING:
    import socket

    from needle_rig.config.schema import RigConfig
    from needle_rig.rig import RawReadings, Rig
    from needle_rig.service.tick.clock import Clock
    from needle_rig.service.tick.notify import Notify
    from needle_rig.service.tick.thinker import Thinker

log = structlog.get_logger("daemon")

_STATUS_EVERY_S = 5.0
_ASK_EVERY_S = 2.0
_MORE_TIME_S = 15.0
"""Asked for every two seconds: a machine that starves the daemon for ten still waits."""


@dataclasses.dataclass(frozen=True)
class Parts:
    """What a daemon is made of; `assembly` builds it. `make_rig` gets the receiver of raw readings."""

    config: RigConfig
    brain: Brain
    make_rig: Callable[[RawReadings], Rig]
    make_clock: Callable[[Rig], Clock]
    make_steady: Callable[[], list[str]]
    """Asks the system for a steady tick and returns what it refused."""
    simulated: bool
    """Whether no real needle is turned."""
    thinker: Thinker
    """Where the brain's strategies think."""


class Daemon:
    """Serves one rig until `end`. All methods belong to the event loop that runs `run`."""

    def __init__(self, parts: Parts, runs: Path, notify: Notify, logbook: Logbook) -> None:
        self._api = ApiLink(self._do)
        self._logbook = logbook
        self._faults = Repeats()
        self._end_reason = "it was told to end"
        self._lease = Lease(lambda: self._occupied)
        self._parts = parts
        self._brain = parts.brain
        self._runs = runs
        self._notify = notify
        self._recorder = Recorder(self._on_recorder_failure)
        self._rates = Rates(self._recorder.raw)
        self._rig_document = report.rig_document(parts.config, simulated=parts.simulated)
        self._rig: Rig | None = None
        self._loop: ControlLoop | None = None
        self._warnings: list[str] = []
        self._main: asyncio.Task[Any] | None = None
        self._told: tuple[Phase, str] = (Phase.IDLE, "")
        self._run: Path | None = None
        self._starting = False
        self._closed = asyncio.Event()
        self._closed.set()
        self._ending = False
        self._motions = 0
        self._moving = False
        self._finishing: asyncio.Task[None] | None = None
        self._failure: str | None = None
        self._last: Told | None = None
        self._model_sha256: str | None = None
        self._next_status_s = 0.0
        self._time_s = 0.0

    async def run(self, listener: socket.socket, on_ready: Callable[[], None]) -> None:
        """Open the rig, serve until `end`, then stop the drive and release everything."""
        self._main = asyncio.current_task()
        if self._ending:
            return
        self._logbook.begin()
        if self._logbook.before:
            log.info("before", text=self._logbook.before)
        asking = asyncio.create_task(self._ask_for_time(), name="ask for time")
        try:
            # both get ready while the rig is built
            self._api.start(listener)
            await self._recorder.start(self._runs)
            rig = self._rig = self._parts.make_rig(self._rates.raw)
            # before the links are open: what they bring meanwhile would be old at the first tick
            self._warnings = self._parts.make_steady()
            for warning in self._warnings:
                log.warning("not steady", reason=warning)
            self._api.serve()
            try:
                await rig.open()
                await self._serve(rig, listener, on_ready)
            finally:
                await rig.close()
        except NeedleRigError as error:
            self._end_reason = str(error)
            raise
        except Exception as error:
            self._end_reason = f"a defect: {error!r}"
            raise
        finally:
            await self._api.close()
            await self._recorder.close()
            self._parts.thinker.close()
            asking.cancel()
            await asyncio.gather(asking, return_exceptions=True)
            self._logbook.end(self._end_reason)
            log.info("ended")

    async def _ask_for_time(self) -> None:
        """Keep systemd waiting while this daemon starts or ends; what it waits for has limits of its own."""
        while True:
            if self._loop is None or self._ending:
                self._notify.send(EXTEND_TIMEOUT_USEC=round(_MORE_TIME_S * 1e6))
            if self._loop is None:
                why = ": the first start compiles the needle's equations" if self._parts.simulated else ""
                self._notify.send(STATUS=f"starting{why}")
            await asyncio.sleep(_ASK_EVERY_S)

    async def _serve(self, rig: Rig, listener: socket.socket, on_ready: Callable[[], None]) -> None:
        clock = self._parts.make_clock(rig)
        self._loop = ControlLoop(
            rig, self._brain, clock, self._on_sample, self._notify.alive, self._on_standstill
        )
        self._notify.send(READY=1, STATUS="idle")
        log.info("ready", rig=self._parts.config.name, socket=str(listener.getsockname()))
        on_ready()
        try:
            await self._loop.run()
        finally:
            clock.close()
            self._ending = True
            self._lease.stop()
            self._notify.send(STOPPING=1)
            if self._run is not None and self._finishing is None:
                self._brain.stop("the daemon was told to end")
                self._finish_soon()
            if self._finishing is not None:
                await self._finishing
            await self._api.close()

    def end(self) -> None:
        """Stop the drive in the next tick and leave `run`, also when it has not begun yet."""
        self._ending = True
        if self._loop is not None:
            self._lease.stop()
            if self._occupied:
                self._brain.stop("the daemon was told to end")
            self._loop.end()
        elif self._main is not None:
            self._main.cancel()

    async def _do(self, name: str, content: Message, claim: Claim) -> Message:
        """Carry out one order of the API; raises what forbids it."""
        order = read_order(name, content)
        if isinstance(order, Reason):
            self.stop(order.reason)
            return {"stopping": True}
        if self._loop is not None:
            await self._loop.worked()  # at any other moment it could make a tick late
        match name, order:
            case "state", _:
                return {**self._state("state"), "ticks": self.describe_timing()}
            case "take_lease", Holder():
                lease = self._lease.take(order.holder, claim)
                return {"lease": lease, "holder": order.holder, "expires_s": LEASE_S, "version": VERSION}
            case "return_lease", _:
                self._lease.give_back(claim)
                return {"returned": True}
        self._lease.check(claim)
        if self._loop is None or self._ending:
            raise BadInput("the daemon starts or ends just now; ask again")
        if self._starting or (self._run is not None and self._brain.state.phase in ACTIVE):
            raise BadInput("a sequence is running; wait for it, or stop it first: needle-rig stop")
        self._starting = True
        try:
            await self._closed.wait()  # a run that was just stopped
            self._lease.check(claim)
            return (
                await self._compensate(order, claim)
                if isinstance(order, Order)
                else self._command(name, order)
            )
        finally:
            self._starting = False

    async def _compensate(self, order: Order, claim: Claim) -> Started:
        """Start a run; the answer names its file."""
        request = _request(order)
        if order.model is not None:
            saved = await self._parts.thinker.model(order.model)
            trust = Trust(saved.uncertainties, saved.error_over_floor)
            request = dataclasses.replace(request, model=saved.model, trust=trust)
        self._brain.check(request)
        await self._parts.thinker.get_ready(order.strategy)
        path = await self._recorder.begin(self._runs, self._parts.config, self._about(order, request))
        try:
            self._lease.check(claim)
            self._brain.compensate(dataclasses.replace(request, run=str(path)))
        except NeedleRigError as refusal:
            try:
                await self._recorder.discard()
            except NeedleRigError as error:
                log.error("recorder", reason=str(error))
            raise refusal
        self._run, self._failure, self._last = path, None, None
        text = order.model
        self._model_sha256 = None if text is None else hashlib.sha256(text.encode()).hexdigest()
        self._closed.clear()
        self._set_busy()
        log.info("run", target_deg=order.target_deg, strategy=order.strategy, file=str(path))
        return {"run": str(path)}

    def _command(self, name: str, order: Model) -> Started:
        """A motion that is no run, or a change of state; the answer numbers motions."""
        brain = self._brain
        match order:
            case Jog():
                brain.jog(_rad(order.by_deg), _rad(order.to_deg), _rad(order.speed_deg_s))
            case Home():
                brain.home(order.by, rad(order.angle_deg), _rad(order.speed_deg_s))
            case _:
                {"hold": brain.hold, "release": brain.release, "clear": brain.clear}[name]()
        self._set_busy()
        if name in ("release", "clear"):
            return {"done": name}
        self._motions += 1
        self._moving = True
        log.info(name, motion=self._motions, **order.model_dump())
        return {"motion": self._motions}

    def stop(self, reason: str) -> None:
        """Stop the drive in the next tick; the run ends as aborted, what was asked before does not begin."""
        self._lease.stop()
        self._brain.stop(reason)
        self._set_busy()

    @property
    def _occupied(self) -> bool:
        return self._run is not None or self._starting or self._moving

    def _set_busy(self) -> None:
        if self._loop is not None:
            self._loop.busy = True

    def describe(self) -> Whole:
        """All that is to be said now."""
        return {
            "version": VERSION,
            "rig": self._rig_document,
            "runs": str(self._runs.absolute()),
            "run": None if self._run is None else str(self._run),
            "model_sha256": self._model_sha256,
            "last": self._last,
            "warnings": [*self._warnings, *filter(None, [self._recorder.crowded])],
            "starting": self._loop is None,
            "since_utc": self._logbook.since_utc,
            "before": self._logbook.before or None,
            "unfinished": self._recorder.unfinished,
            "rates_hz": self._rates.hz,
            "firmware": self._firmware,
            "lease": self._lease.holder,
            "motions": self._motions,
            "moving": self._moving,
            **report.state_document(self._brain.state),
        }

    @property
    def _firmware(self) -> dict[str, Node]:
        return {} if self._rig is None else report.firmware_document(self._rig.firmware())

    def _state(self, kind: Literal["state", "phase"]) -> State:
        return {"type": kind, **self.describe()}  # type: ignore[typeddict-item]  # ticks may be absent

    def describe_timing(self) -> Ticks:
        """How well the ticks keep their time; lateness over the newest 4096."""
        if self._loop is None:
            return {}
        timing = self._loop.timing()
        return {
            "count": timing.ticks,
            "missed": timing.missed,
            "late_p50_ms": rounded(timing.late_p50_s * 1e3, 4),
            "late_p99_ms": rounded(timing.late_p99_s * 1e3, 4),
            "late_max_ms": rounded(timing.late_max_s * 1e3, 4),
            "lost_rows": self._recorder.lost_rows,
        }

    def _about(self, order: Order, request: Request) -> Message:
        simulation = self._parts.config.simulation
        return {
            "strategy": order.strategy,
            "target_deg": order.target_deg,
            "kind": "simulated" if self._parts.simulated else "hardware",
            "parameters": simulation.parameters if simulation else "",
            "options": json.dumps(order.options),
            "firmware": json.dumps(self._firmware),
            **({} if request.model is None else {"model": request.model.name, "model_file": order.model}),
            **{
                name: value
                for name in ("settle_s", "speed_deg_s", "lag_left_deg")
                if (value := getattr(order, name)) is not None
            },
        }

    def _on_sample(self, sample: Sample) -> None:
        self._time_s = sample.time_s
        active = sample.phase in ACTIVE
        if self._loop is not None:
            self._loop.busy = self._wants_ticks or (sample.phase is Phase.FAULT and self._fault_passes())
        if self._run is not None and self._finishing is None:
            self._recorder.sample(sample)
        told = (sample.phase, sample.motion)
        if told != self._told:
            self._told = told
            self._on_phase(sample)
        if not active:
            if self._run is not None and self._finishing is None:
                self._finish_soon()
            if self._moving and not self._brain.busy:
                self._moving = False
                moved: Moved = {"type": "moved", "moved": self._motions, **self.describe()}
                self._api.event(moved)
        now_s = time.monotonic()
        self._rates.step(sample.time_s)
        self._tell_state()
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + _STATUS_EVERY_S
            self._notify.send(STATUS=f"{sample.phase} {sample.motion}".strip())

    @property
    def _wants_ticks(self) -> bool:
        """Something goes on that no strategy still thinks about: virtual time waits for the answer."""
        return self._brain.busy and not self._parts.thinker.thinking

    def _fault_passes(self) -> bool:
        """Whether the next tick ends the fault, as where a strategy was refused."""
        state = self._brain.state
        return state.fault_name == FaultName.CONTROL and not state.latched

    def _on_standstill(self) -> None:
        """Virtual time stands still; it goes on when a strategy has answered."""
        if self._wants_ticks:
            self._set_busy()
        self._tell_state()

    def _tell_state(self) -> None:
        """Tell those who listen where it stands, when it is time."""
        self._api.state(time.monotonic(), lambda: self._state("state"))

    def _on_phase(self, sample: Sample) -> None:
        state = self._brain.state
        text = f"{sample.motion} {sample.phase}" if sample.phase in ACTIVE else sample.phase.value
        if state.waiting_for:
            text += f", waits for {state.waiting_for}"
        self._recorder.event(sample.time_s, "phase", text)
        if sample.phase is Phase.FAULT:
            self._recorder.event(sample.time_s, "fault", state.fault or "")
            times = self._faults.count(f"{state.fault_name}, {state.waiting_for}", time.monotonic())
            if times is not None:
                log.error("fault", reason=state.fault, times=times)
        self._api.event(self._state("phase"))

    def _on_recorder_failure(self, sentence: str) -> None:
        log.error("recorder", reason=sentence)
        if self._run is not None:
            self._failure = sentence
            self._brain.stop(sentence)

    def _finish_soon(self) -> None:
        self._parts.thinker.drop()
        self._finishing = asyncio.create_task(self._finish(self._brain.state), name="finish run")

    async def _finish(self, state: BrainState) -> None:
        try:
            await self._close_run(state)
        finally:
            self._run, self._finishing = None, None
            self._closed.set()
        assert self._last is not None
        ended: Ended = {"type": "ended", **self._last}
        self._api.event(ended)

    async def _close_run(self, state: BrainState) -> None:
        """Close the run's file, then keep how it ended."""
        run = self._run
        outcome = state.outcome
        assert outcome is not None
        if self._failure is not None:
            outcome = dataclasses.replace(outcome, status="fault", text=self._failure)
        result = report.result_document(outcome, state.settled, self._rig_document, str(run))
        try:
            await self._recorder.finish(result, self._time_s)
        except NeedleRigError as error:
            log.error("recorder", reason=str(error))
            if self._failure is None:
                outcome = dataclasses.replace(outcome, status="fault", text=str(error))
                result["status"] = "fault"
        self._last = {
            "result": result,
            "text": outcome.text,
            "conditions": [report.condition_document(condition) for condition in outcome.conditions],
            "settled": [report.settled_document(motion) for motion in state.settled],
        }
        log.info("run ended", status=outcome.status, text=outcome.text)


def _request(order: Order) -> Request:
    return Request(
        target_rad=rad(order.target_deg),
        strategy=order.strategy,
        options=order.options,
        settle_s=order.settle_s,
        speed_rad_s=_rad(order.speed_deg_s),
        lag_left_rad=_rad(order.lag_left_deg),
    )


def _rad(angle_deg: float | None) -> float | None:
    return None if angle_deg is None else rad(angle_deg)
