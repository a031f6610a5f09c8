"""The daemon: owns the rig, runs the tick, and does what is asked over its socket."""

from __future__ import annotations

import asyncio
import dataclasses
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import structlog

from needle_rig.control.brain import Brain
from needle_rig.control.compensation import ACTIVE
from needle_rig.control.reports import Request
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.records import Phase, Sample
from needle_rig.service import report
from needle_rig.service.loop import ControlLoop
from needle_rig.service.recorder import Recorder
from needle_rig.service.stream import Document, Stream
from needle_rig.units import rad

if TYPE_CHECKING:
    import socket

    from needle_rig.config.schema import RigConfig
    from needle_rig.rig import RawReadings, Rig
    from needle_rig.service.api import Order
    from needle_rig.service.clock import Clock
    from needle_rig.service.notify import Notify

log = structlog.get_logger("daemon")

_STATUS_EVERY_S = 5.0


@dataclasses.dataclass(frozen=True)
class Parts:
    """What a daemon is made of; `assembly` builds it. `make_rig` gets the receiver of raw readings."""

    config: RigConfig
    brain: Brain
    make_rig: Callable[[RawReadings], Rig]
    make_clock: Callable[[Rig], Clock]
    make_steady: Callable[[], list[str]]
    """Asks the system for a steady tick and returns what it refused."""
    close: Callable[[], None] = lambda: None
    """Called last."""


class Daemon:
    """Serves one rig until `end`. All methods belong to the event loop that runs `run`."""

    def __init__(self, parts: Parts, runs: Path, notify: Notify) -> None:
        self.stream = Stream()
        self._parts = parts
        self._brain = parts.brain
        self._runs = runs
        self._notify = notify
        self._recorder = Recorder(self._on_recorder_failure)
        self._rig_document = report.rig_document(parts.config)
        self._loop: ControlLoop | None = None
        self._warnings: list[str] = []
        self._main: asyncio.Task[Any] | None = None
        self._told: tuple[Phase, str] = (Phase.IDLE, "")
        self._run: Path | None = None
        self._starting = False
        self._finishing: asyncio.Task[None] | None = None
        self._failure: str | None = None
        self._last: Document | None = None
        self._next_status_s = 0.0
        self._time_s = 0.0

    async def run(self, listener: socket.socket, on_ready: Callable[[], None]) -> None:
        """Open the rig, serve until `end`, then stop the drive and release everything."""
        self._main = asyncio.current_task()
        try:
            # the writer gets ready while the rig is built
            await self._recorder.start(self._runs)
            rig = self._parts.make_rig(self._recorder.raw)
            try:
                await rig.open()
                await self._serve(rig, listener, on_ready)
            finally:
                await rig.close()
        finally:
            await self._recorder.close()
            self._parts.close()
            log.info("ended")

    async def _serve(self, rig: Rig, listener: socket.socket, on_ready: Callable[[], None]) -> None:
        from needle_rig.service.api import server

        self._warnings = self._parts.make_steady()
        for warning in self._warnings:
            log.warning("not steady", reason=warning)
        clock = self._parts.make_clock(rig)
        self._loop = ControlLoop(rig, self._brain, clock, self._on_sample, self._notify.alive)
        api = server(self)
        serving = asyncio.create_task(api.serve(sockets=[listener]), name="api")
        self._notify.send(READY=1, STATUS="idle")
        log.info("ready", rig=self._parts.config.name, socket=str(listener.getsockname()))
        on_ready()
        try:
            await self._loop.run()
        finally:
            clock.close()
            self._notify.send(STOPPING=1)
            if self._run is not None and self._finishing is None:
                self._brain.stop("the daemon was told to end")
                self._finish_soon()
            if self._finishing is not None:
                await self._finishing
            await self.stream.end()  # a server told to exit may close before how the run ended is sent
            api.should_exit = True
            await serving

    def end(self) -> None:
        """Stop the drive in the next tick and leave `run`."""
        if self._loop is not None:
            if self._run is not None:
                self._brain.stop("the daemon was told to end")
            self._loop.end()
        elif self._main is not None:
            self._main.cancel()

    async def compensate(self, order: Order) -> Document:
        """Start a run; the answer names its file. Raises BadInput or RigFault when it cannot start."""
        if self._run is not None or self._starting or self._loop is None:
            raise BadInput("a sequence is running; wait for it, or stop it first: needle-rig stop")
        self._starting = True
        path: Path | None = None
        try:
            path = await self._recorder.begin(self._runs, self._parts.config, self._about(order))
            self._brain.compensate(_request(order, path))
        except NeedleRigError:
            if path is not None:
                await self._recorder.discard()
            raise
        finally:
            self._starting = False
        self._run, self._failure, self._last = path, None, None
        self._loop.busy = True
        log.info("run", target_deg=order.target_deg, strategy=order.strategy, file=str(path))
        return {"run": str(path)}

    def stop(self, reason: str) -> None:
        """Stop the drive in the next tick; the run ends as aborted."""
        self._brain.stop(reason)

    def clear(self) -> None:
        """Leave a fault. Raises BadInput while a sequence runs."""
        self._brain.clear()
        if self._loop is not None:
            self._loop.busy = True

    def describe(self) -> Document:
        """The whole state, as streamed."""
        return {
            "type": "state",
            "rig": self._rig_document,
            "run": None if self._run is None else str(self._run),
            "last": self._last,
            "warnings": self._warnings,
            "unfinished": self._recorder.unfinished,
            **report.state_document(self._brain.state),
        }

    def describe_timing(self) -> Document:
        """How well the ticks keep their time; lateness over the newest 4096."""
        if self._loop is None:
            return {}
        timing = self._loop.timing()
        return {
            "count": timing.ticks,
            "missed": timing.missed,
            "late_p50_ms": report.number(timing.late_p50_s * 1e3),
            "late_p99_ms": report.number(timing.late_p99_s * 1e3),
            "late_max_ms": report.number(timing.late_max_s * 1e3),
            "lost_rows": self._recorder.lost_rows,
        }

    def _about(self, order: Order) -> Document:
        simulation = self._parts.config.simulation
        return {
            "strategy": order.strategy,
            "target_deg": order.target_deg,
            "parameters": simulation.parameters if simulation else "",
            "options": json.dumps(order.options),
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
            self._loop.busy = active
        if self._run is not None and self._finishing is None:
            self._recorder.sample(sample)
        told = (sample.phase, sample.motion)
        if told != self._told:
            self._told = told
            self._on_phase(sample)
        if self._run is not None and self._finishing is None and not active:
            self._finish_soon()
        now_s = time.monotonic()
        self.stream.state(now_s, self.describe)
        if now_s >= self._next_status_s:
            self._next_status_s = now_s + _STATUS_EVERY_S
            self._notify.send(STATUS=f"{sample.phase} {sample.motion}".strip())

    def _on_phase(self, sample: Sample) -> None:
        state = self._brain.state
        text = f"{sample.motion} {sample.phase}" if sample.phase in ACTIVE else sample.phase.value
        if state.waiting_for:
            text += f", waits for {state.waiting_for}"
        self._recorder.event(sample.time_s, "phase", text)
        if sample.phase is Phase.FAULT:
            self._recorder.event(sample.time_s, "fault", state.fault or "")
            log.error("fault", reason=state.fault)
        self.stream.event({**self.describe(), "type": "phase"})

    def _on_recorder_failure(self, sentence: str) -> None:
        log.error("recorder", reason=sentence)
        if self._run is not None:
            self._failure = sentence
            self._brain.stop(sentence)

    def _finish_soon(self) -> None:
        self._finishing = asyncio.create_task(self._finish(), name="finish run")

    async def _finish(self) -> None:
        """Close the run's file, then tell how it ended."""
        state, run = self._brain.state, self._run
        outcome = state.outcome
        assert outcome is not None
        parameters = self._rig_document["parameters"]
        if self._failure is not None:
            outcome = dataclasses.replace(outcome, status="fault", text=self._failure)
        result = report.result_document(outcome, state.settled, parameters, str(run))
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
        self._run, self._finishing = None, None
        log.info("run ended", status=outcome.status, text=outcome.text)
        self.stream.event({"type": "ended", **self._last})


def _request(order: Order, path: Path) -> Request:
    return Request(
        target_rad=rad(order.target_deg),
        strategy=order.strategy,
        options=order.options,
        settle_s=order.settle_s,
        speed_rad_s=None if order.speed_deg_s is None else rad(order.speed_deg_s),
        lag_left_rad=None if order.lag_left_deg is None else rad(order.lag_left_deg),
        run=str(path),
    )
