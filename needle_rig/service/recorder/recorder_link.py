"""The line to one recorder process: messages down its pipe, answers back by number."""

from __future__ import annotations

import asyncio
import itertools
import json
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypedDict

from needle_rig.errors import BadInput, RigFault

START_TIMEOUT_S = 30.0
"""Until the process has started, on a machine that has no time for it."""
CLOSE_TIMEOUT_S = 10.0
REPLY_LIMIT_BYTES = 65_536
"""Answers are one sentence and a path: what is longer is no answer of a recorder in its senses."""

_READ_BYTES = 65_536


class Reply(TypedDict, total=False):
    """What a recorder process says: every line has a number, the rest is as was asked."""

    number: int
    """Of the message that it answers; 0: it is ready, or what it could not record."""
    ready: bool
    error: str
    exit_code: int
    kept_rows: int
    """Beside an error: the rows of the open run that are kept; none follow."""
    opened: str
    closed: str
    complete: bool
    removed: list[str]
    unread_bytes: int
    text: str
    torn_bytes: int


class Gone(RigFault):
    """The recorder process has ended, or was killed because it did not answer."""


class RecorderLink:
    """One recorder process. `on_failure` gets what it could not record, `on_gone` why it ended; once."""

    def __init__(
        self,
        process: asyncio.subprocess.Process,
        on_failure: Callable[[str], None],
        on_gone: Callable[[str], None],
    ) -> None:
        self.process = process
        self._on_failure = on_failure
        self._on_gone = on_gone
        self._numbers = itertools.count(1)
        self._waiting: dict[int, asyncio.Future[Reply]] = {}
        self._ready = asyncio.Event()
        self._reason = ""
        self._listening = asyncio.create_task(self._listen(), name="recorder replies")

    @classmethod
    async def start(cls, on_failure: Callable[[str], None], on_gone: Callable[[str], None]) -> RecorderLink:
        """Start a process, which gets ready meanwhile. Raises RigFault when there can be none."""
        try:
            process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "needle_rig.service.recorder.recorder_process"),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
            )
        except OSError as error:
            raise RigFault(f"the recorder cannot be started: {error.strerror}; start again") from None
        return cls(process, on_failure, on_gone)

    @property
    def gone(self) -> bool:
        """Whether the process has ended or was given up; one that hangs on a disk may outlive its kill."""
        return bool(self._reason)

    @property
    def ended(self) -> bool:
        """Whether nothing is left of the process."""
        return self._listening.done()

    @property
    def backlog_bytes(self) -> int:
        """What waits here because the process does not take it."""
        assert self.process.stdin is not None
        return self.process.stdin.transport.get_write_buffer_size()

    def send(self, *message: Any) -> int:
        """Send a message that is not answered; returns its length in bytes."""
        return self._write(0, *message)

    async def ask(self, timeout_s: float, *message: Any) -> Reply:
        """Send a message and wait for its answer. A process that does not answer in time is killed.

        Raises Gone then and when the process ends, and the BadInput or RigFault with which it answers.
        """
        try:
            async with asyncio.timeout(START_TIMEOUT_S):
                await self._ready.wait()
        except TimeoutError:
            raise self._give_up(f"the recorder did not start within {START_TIMEOUT_S:g} s") from None
        if self.gone:
            raise Gone(self._reason)
        number = next(self._numbers)
        self._waiting[number] = asyncio.get_running_loop().create_future()
        try:
            self._write(number, *message)
            async with asyncio.timeout(timeout_s):
                reply = await self._waiting[number]
        except TimeoutError:
            raise self._give_up(
                f"the recorder did not answer within {timeout_s:.2g} s; look at the disk of the runs"
            ) from None
        finally:
            del self._waiting[number]
        if "error" in reply:
            raise (BadInput if reply.get("exit_code") == BadInput.exit_code else RigFault)(reply["error"])
        return reply

    async def close(self) -> None:
        """Let the process finish its work and end it."""
        assert self.process.stdin is not None
        self.process.stdin.close()
        try:
            async with asyncio.timeout(CLOSE_TIMEOUT_S):
                await self.process.wait()
        except TimeoutError:
            self._give_up("the recorder did not end")
        with suppress(TimeoutError):
            await asyncio.wait_for(self._listening, CLOSE_TIMEOUT_S)

    def _give_up(self, reason: str) -> Gone:
        if self.process.returncode is None:
            self.process.kill()
        self._end(reason)
        return Gone(self._reason)

    def _end(self, reason: str) -> None:
        if self._reason:
            return
        self._reason = reason
        self._ready.set()
        for waiting in self._waiting.values():
            if not waiting.done():
                waiting.set_exception(Gone(reason))
        self._on_gone(reason)

    def _write(self, *message: Any) -> int:
        raw = pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL)
        if not self.gone:
            assert self.process.stdin is not None
            self.process.stdin.write(raw)
        return len(raw)

    async def _listen(self) -> None:
        assert self.process.stdout is not None
        rest = b""
        while chunk := await self.process.stdout.read(_READ_BYTES):
            *lines, rest = (rest + chunk).split(b"\n")
            try:
                if len(rest) > REPLY_LIMIT_BYTES:
                    raise ValueError
                for line in lines:
                    self._take(json.loads(line))
            except (ValueError, KeyError, TypeError):
                self._give_up("the recorder answered what no recorder says")
                rest = b""
        await self.process.wait()
        self._end("the recorder ended before the run did")

    def _take(self, reply: Reply) -> None:
        number = reply["number"]
        if number == 0:
            if "error" in reply:
                self._on_failure(reply["error"])
            else:
                self._ready.set()
        elif number in self._waiting and not self._waiting[number].done():
            self._waiting[number].set_result(reply)
