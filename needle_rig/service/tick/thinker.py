"""Where strategies think: a process of its own, so that no tick waits for a plan, however long it takes."""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import pickle
import signal
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, Any

from needle_rig.control.checked import Checked
from needle_rig.control.compensation import think_at_once
from needle_rig.control.manual import Turn
from needle_rig.control.strategies.base_equals_tip import BaseEqualsTip
from needle_rig.control.strategies.decay import Decay
from needle_rig.control.strategies.dither import Dither
from needle_rig.control.strategies.none import NoCompensation
from needle_rig.control.strategies.protocol import Protocol
from needle_rig.control.strategies.reed2008 import Reed2008
from needle_rig.control.strategies.reed2008_elastic import Reed2008Elastic
from needle_rig.control.strategies.relax import Relax
from needle_rig.control.strategies.single_lag import SingleLag
from needle_rig.control.strategies.tip_friction import TipFriction
from needle_rig.control.strategy import History, Strategy, Task, Waypoint, find_strategies
from needle_rig.errors import NeedleRigError, RigFault
from needle_rig.parent import end_with_parent

if TYPE_CHECKING:
    from needle_rig.model import SavedModel

QUICK = frozenset(
    {
        *(BaseEqualsTip, Decay, Dither, NoCompensation, Protocol, Reed2008, Reed2008Elastic, Relax),
        *(SingleLag, TipFriction, Turn),
    }
)
"""Strategies known to answer within a tick: a few lines of arithmetic. All others think in the child."""
_SPAWN = multiprocessing.get_context("spawn")
_CLOSE_S = 1.0


class Thinker:
    """Asks quick strategies within the tick and others in a child, which starts when first needed.

    A child that has not answered after `limit_s` of real time is killed, and so is one whose answer nobody
    wants any more; the next question gets a new one.
    """

    def __init__(self, limit_s: float = threading.TIMEOUT_MAX) -> None:
        self._limit_s = limit_s
        # one thread for good: to start one takes ticks
        self._asking = ThreadPoolExecutor(1, "thinker")
        self._lock = threading.Lock()
        self._child: _Child | None = None
        self._answer: Future[Waypoint | None] | None = None
        self._questions = 0

    def __call__(
        self, strategy: Strategy, task: Task, history: History
    ) -> Waypoint | Future[Waypoint | None] | None:
        """The strategy's next motion, or a Future of it. Raises BadInput or RigFault, as the Future does."""
        strategy = Checked.of(strategy)
        if type(strategy.inner) in QUICK:
            return think_at_once(strategy, task, history)
        self.drop()
        self._answer = self._asking.submit(self._asked, self._questions, strategy, task, history)
        return self._answer

    async def get_ready(self, strategy: str) -> None:
        """Start the child that a strategy will need, while the drive still sleeps: it may take several ticks.

        Raises RigFault.
        """
        if find_strategies()[strategy] not in QUICK:
            await asyncio.wrap_future(self._asking.submit(self._started))

    async def model(self, text: str) -> SavedModel:
        """The model in the text of a model file: its effects' modules are read here for the first time.

        Raises BadInput for a file that cannot be used, RigFault.
        """
        saved: SavedModel = await asyncio.wrap_future(self._asking.submit(self._read, text))
        return saved

    @property
    def thinking(self) -> bool:
        """Whether an answer is awaited."""
        return self._answer is not None and not self._answer.done()

    def drop(self) -> None:
        """Nobody waits for the answer any more: end a child that still thinks."""
        with self._lock:
            self._questions += 1
            if self.thinking and self._child is not None:
                self._child.process.kill()
                self._child = None
            self._answer = None

    def close(self) -> None:
        """End the child, also while it thinks, within a second. Safe to call twice."""
        self.drop()
        self._asking.shutdown(wait=False, cancel_futures=True)
        if self._child is not None:
            self._child.process.kill()
            self._child.process.join(_CLOSE_S)

    def _asked(self, question: int, strategy: Checked, task: Task, history: History) -> Waypoint | None:
        try:
            asked = pickle.dumps((think_at_once, strategy, task, history), pickle.HIGHEST_PROTOCOL)
        except Exception as error:
            raise RigFault(
                f"strategy {strategy.name} cannot be asked in another process:"
                f" {type(error).__name__}: {error}; choose another"
            ) from error
        with self._lock:
            if question != self._questions:
                return None  # dropped before a child heard of it
            child = self._running()
        waypoint: Waypoint | None = child.answer(asked, f"strategy {strategy.name}", self._limit_s)
        return waypoint

    def _read(self, text: str) -> SavedModel:
        with self._lock:
            child = self._running()
        asked = pickle.dumps((_model, text), pickle.HIGHEST_PROTOCOL)
        saved: SavedModel = child.answer(asked, "the model", self._limit_s)
        return saved

    def _started(self) -> None:
        with self._lock:
            self._running()

    def _running(self) -> _Child:
        if self._child is None or not self._child.process.is_alive():
            try:
                self._child = _Child()
            except OSError as error:
                raise RigFault(
                    f"no process can be started that a strategy thinks in: {error.strerror};"
                    " free some memory, or choose another strategy"
                ) from error
        return self._child


class _Child:
    """A process that answers one question after the other."""

    def __init__(self) -> None:
        self._here, there = _SPAWN.Pipe()
        self.process = _SPAWN.Process(target=_answer_all, args=(there,), name="thinker", daemon=True)
        try:
            self.process.start()
        finally:
            there.close()

    def answer(self, question: bytes, name: str, limit_s: float) -> Any:
        """What it finds within `limit_s`; after that it is dead. Raises what it refuses, RigFault."""
        overdue = threading.Timer(limit_s, self.process.kill)
        overdue.daemon = True
        overdue.start()
        asked_s = time.monotonic()
        try:
            self._here.send_bytes(question)
            said = self._here.recv()
        except (EOFError, OSError):
            late = time.monotonic() - asked_s >= limit_s
            silent = f"has not answered for {limit_s:g} s (sequence.motion_timeout_s)"
            said = RigFault(f"{name} {silent if late else 'lost its process'}; choose another")
            self.process.join(_CLOSE_S)
        finally:
            overdue.cancel()
        if isinstance(said, NeedleRigError):
            raise said
        return said


def _answer_all(there: Connection) -> None:
    """Answer until nobody asks: lower than the tick in every queue, and gone when the daemon is."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    os.nice(5)
    os.dup2(2, 1)  # standard output is the daemon's word to its client
    with contextlib.suppress(EOFError):
        while True:
            there.send(_answered(there.recv_bytes()))


def _model(text: str) -> SavedModel:
    from needle_rig.model import model_in

    return model_in(text, "the model of this order")


def _answered(question: bytes) -> Any:
    try:
        function, *arguments = pickle.loads(question)
        return function(*arguments)
    except NeedleRigError as refusal:
        return refusal
    except BaseException as error:  # noqa: BLE001 - what a strategy's file does while it is read
        return RigFault(
            f"a strategy or a model cannot be read in another process: {type(error).__name__}: {error}"
            "; choose another"
        )
