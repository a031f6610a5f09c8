"""The daemon's end of the API process: starts it, answers its questions, and replaces it when it fails."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import socket
import sys
from collections.abc import Awaitable, Callable

import structlog

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.service.api.documents import Answered, Asked, Message
from needle_rig.service.api.lease import Claim, Taken
from needle_rig.service.api.lines import Lines

log = structlog.get_logger("api")

STATES_HZ = 30.0
"""As often as a page draws traces that move."""
RESTART_S = 1.0
"""From one start of the process to the next at least, so that one which fails at once takes no core."""
CHECK_S = 1.0
SILENT = 5
"""Checks without a word from the process: it hangs. A machine that stood still is one."""
STARTING = 60
"""The same before its first word: a computer that has just started, or is busy, takes long over the imports,
and a process that is ended meanwhile would never get there."""
BACKLOG_LIMIT_BYTES = 8 * 2**20
_COMPLAIN_EVERY = 10
_ANSWER_TIMEOUT_S = 12.0
"""A start on a slow disk is given up before."""
_END_TIMEOUT_S = 4.0

Do = Callable[[str, Message, Claim], Awaitable[Message]]


class ApiLink:
    """Serves `listener` in a process of its own; `do` carries out what is asked and gives the answer.

    It raises what `errors` has for what cannot be done.
    """

    def __init__(self, do: Do) -> None:
        self._do = do
        self._lines: Lines | None = None
        self._serving = False
        self._listeners = 0
        self._heard = False
        self._next_state_s = 0.0
        self._tasks: set[asyncio.Task[None]] = set()
        self._keeping: asyncio.Task[None] | None = None

    def start(self, listener: socket.socket) -> None:
        """Start the process; it gets ready while the daemon goes on."""
        self._keeping = asyncio.create_task(self._keep(listener), name="keep api")

    def serve(self) -> None:
        """Let clients in."""
        self._serving = True
        if self._lines is not None:
            self._lines.send("serve", {})

    def event(self, document: Message) -> None:
        """Tell all who listen."""
        if self._lines is not None and self._listeners:
            self._lines.send("event", document)

    def state(self, now_s: float, describe: Callable[[], Message]) -> None:
        """Tell what `describe` gives, when somebody listens, it is time and the process keeps up."""
        lines = self._lines
        if lines is None or not self._listeners or now_s < self._next_state_s or lines.waiting_bytes:
            return
        # from when it was due, not from now: a tick of 5 ms would round 33 up to 35
        self._next_state_s = max(self._next_state_s, now_s - 1 / STATES_HZ) + 1 / STATES_HZ
        lines.send("state", describe())

    async def close(self) -> None:
        """Answer what was asked, let listeners fetch the rest, and end the process; safe to call twice."""
        keeping, self._keeping = self._keeping, None
        if keeping is None:
            return
        if self._tasks:
            await asyncio.wait(self._tasks, timeout=_ANSWER_TIMEOUT_S)
        if self._lines is not None:
            self._lines.send("end", {})
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.shield(keeping), _END_TIMEOUT_S)
        keeping.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await keeping

    async def _keep(self, listener: socket.socket) -> None:
        loop = asyncio.get_running_loop()
        failures = 0
        while True:
            again_s = loop.time() + RESTART_S
            how = await self._live(listener)
            if self._keeping is None:
                return
            if failures % _COMPLAIN_EVERY == 0:
                log.error("api process", reason=f"it {how} and is started again", failures=failures + 1)
            failures += 1
            await asyncio.sleep(max(again_s - loop.time(), 0.0))

    async def _live(self, listener: socket.socket) -> str:
        """One life of the process; says how it ended."""
        own, theirs = socket.socketpair()
        path = str(listener.getsockname())
        with theirs:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "needle_rig.service.api.api_process"),
                *(str(listener.fileno()), str(theirs.fileno()), path, str(os.getpid())),
                stdin=asyncio.subprocess.DEVNULL,
                stdout=asyncio.subprocess.DEVNULL,
                pass_fds=(listener.fileno(), theirs.fileno()),
            )
        try:
            return await self._watch(process, own)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
            if self._lines is not None:
                self._lines.close()
            self._lines, self._listeners = None, 0

    async def _watch(self, process: asyncio.subprocess.Process, own: socket.socket) -> str:
        lines = self._lines = Lines(self._on_line, lambda: None)
        await asyncio.get_running_loop().create_connection(lambda: lines, sock=own)
        if self._serving:
            lines.send("serve", {})
        ending = asyncio.create_task(process.wait(), name="api process")
        try:
            silent, patience = 0, STARTING
            while silent < patience and lines.waiting_bytes < BACKLOG_LIMIT_BYTES:
                self._heard = False
                done, _ = await asyncio.wait({ending}, timeout=CHECK_S)
                if done:
                    return f"ended (exit {process.returncode})"
                silent, patience = (0, SILENT) if self._heard else (silent + 1, patience)
            return "hangs"
        finally:
            ending.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await ending

    def _on_line(self, word: str, text: bytes) -> None:
        self._heard = True
        if word == "listening":
            self._listeners = int(json.loads(text)["count"])
        elif word == "ask":
            task = asyncio.create_task(self._answer(json.loads(text)), name="answer")
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    async def _answer(self, asked: Asked) -> None:
        lines = self._lines
        try:
            claim = Claim(asked["begun_s"], asked["lease"])
            content, status = await self._do(asked["order"], asked["content"], claim), 0
        except NeedleRigError as error:
            content = {"error": str(error), "exit_code": error.exit_code}
            status = 422 if isinstance(error, BadInput) and not isinstance(error, Taken) else 409
        except Exception as error:
            log.exception("defect", order=asked["order"])
            content = {"error": f"a defect of the daemon: {error!r}; see its log", "exit_code": 70}
            status = 500
        if lines is not None:
            answer: Answered = {"number": asked["number"], "status": status, "content": content}
            lines.send("answer", answer)
