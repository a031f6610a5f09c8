"""The API's process: serves the daemon's socket, so that no request costs the tick more than one short line.

The daemon starts it as `python -m needle_rig.service.api.api_process LISTENER LINES PATH DAEMON`: two
inherited descriptors, where the socket is, and the daemon's process id. It begins to serve at the line
`serve`. When the daemon dies, it removes the socket in its place.
"""

from __future__ import annotations

import asyncio
import json
import logging
import os
import resource
import signal
import socket
import sys
import time
from pathlib import Path

import uvicorn

from needle_rig.records import JsonObject
from needle_rig.service.api.api import BODY_LIMIT_BYTES, Answer, application
from needle_rig.service.api.connections import Connections
from needle_rig.service.api.documents import Answered, Asked, Message
from needle_rig.service.api.endpoint import Made
from needle_rig.service.api.lines import Lines
from needle_rig.service.api.serving import connection_limit, server
from needle_rig.service.api.stream import Stream

CONNECTIONS = 256
"""Of strangers, and of those let in: far more than people and pages at one rig."""
_OWN_DESCRIPTORS = 32
MEMORY_BYTES = 1 << 30
"""Address space; 512 connections with full buffers take a fifth of it."""
ALIVE_EVERY_S = 1.0
_COMPLAIN_EVERY_S = 10.0
_DEATH_S = 1.0
"""A killed parent's sockets close before it is dead."""


class Process:
    """Passes questions to the daemon and what it says to those who wait or listen."""

    def __init__(self, listener: socket.socket, place: Made, daemon: int) -> None:
        self._listener, self._place, self._daemon = listener, place, daemon
        self._lines = Lines(self._on_line, self._on_end)
        self._answers: dict[int, asyncio.Future[Answer]] = {}
        self._asked = 0
        self._stream = Stream(lambda count: self._lines.send("listening", {"count": count}))
        self._serve = asyncio.Event()
        self._server: uvicorn.Server | None = None
        self._ending: asyncio.Task[None] | None = None

    async def run(self, lines: socket.socket) -> None:
        """Serve until the daemon says `end` or is gone."""
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(_complain)
        await loop.create_connection(lambda: self._lines, sock=lines)
        living = asyncio.create_task(self._live(), name="alive")
        await self._serve.wait()
        connections = Connections(self._listener, connection_limit(CONNECTIONS, _OWN_DESCRIPTORS))
        self._server = server(
            application(self._ask, self._stream, connections),
            connections,
            lifespan="off",
            h11_max_incomplete_event_size=BODY_LIMIT_BYTES,
            ws_max_size=BODY_LIMIT_BYTES,
        )
        sweeping = asyncio.create_task(connections.sweep(), name="sweep")
        try:
            await self._server.serve()
        finally:
            sweeping.cancel()
            living.cancel()
            self._lines.close()

    async def _live(self) -> None:
        while True:
            self._lines.send("alive", {})
            await asyncio.sleep(ALIVE_EVERY_S)

    async def _ask(self, order: str, content: Message, begun_s: float, lease: str | None) -> Answer:
        self._asked += 1
        number = self._asked
        self._answers[number] = asyncio.get_running_loop().create_future()
        asked: Asked = {
            "number": number,
            "order": order,
            "content": content,
            "begun_s": begun_s,
            "lease": lease,
        }
        self._lines.send("ask", asked)
        try:
            return await self._answers[number]
        finally:
            del self._answers[number]

    def _on_line(self, word: str, text: bytes) -> None:
        if word == "state":
            self._stream.state(text.decode())
        elif word == "event":
            self._stream.event(text.decode())
        elif word == "answer":
            told: Answered = json.loads(text)
            answer = self._answers.get(told["number"])
            if answer is not None and not answer.done():
                answer.set_result(Answer(told["status"], told["content"]))
        elif word == "serve":
            self._serve.set()
        elif word == "end" and self._ending is None:
            self._ending = asyncio.create_task(self._end(), name="end")

    async def _end(self) -> None:
        await self._stream.end()  # a server told to exit may close before how the run ended is sent
        if self._server is None:
            self._on_end()
        else:
            self._server.should_exit = True

    def _on_end(self) -> None:
        """The daemon wants no more, or is gone: then what it cannot do any more is done here."""
        deadline_s = time.monotonic() + _DEATH_S
        while self._ending is None and time.monotonic() < deadline_s:
            if os.getppid() != self._daemon:
                self._place.remove()
                break
            time.sleep(_DEATH_S / 100)
        os._exit(0)


class _Rarely(logging.Filter):
    """Lets one complaint through in ten seconds, and says how many others there were."""

    def __init__(self) -> None:
        super().__init__()
        self._next_s = 0.0
        self._withheld = 0

    def filter(self, record: logging.LogRecord) -> bool:
        if time.monotonic() < self._next_s:
            self._withheld += 1
            return False
        self._next_s = time.monotonic() + _COMPLAIN_EVERY_S
        if self._withheld:
            record.msg = f"{record.msg} (and {self._withheld} complaints before)"
            self._withheld = 0
        return True


def _complain(_: asyncio.AbstractEventLoop, context: JsonObject) -> None:
    error = context.get("exception")
    reason = context["message"] if error is None else f"{context['message']}: {error!r}"
    logging.getLogger("api").warning("%s", reason)


def limit_memory() -> None:
    """Take at most MEMORY_BYTES of address space, or less where less is allowed."""
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    allowed = MEMORY_BYTES if hard == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_AS, (allowed, allowed))


def main(listener: int, lines: int, path: Path, daemon: int) -> None:
    """Serve; the arguments are the module's."""
    # the daemon decides when this ends, not a Ctrl-C, a closed terminal or a signal to the whole group
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    limit_memory()
    handler = logging.StreamHandler()
    handler.addFilter(_Rarely())
    handler.setFormatter(logging.Formatter("api: %(message)s"))
    logging.basicConfig(level=logging.WARNING, handlers=[handler])
    place = Made.at(path)

    async def serve() -> None:
        await Process(socket.socket(fileno=listener), place, daemon).run(socket.socket(fileno=lines))

    asyncio.run(serve())


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]), int(sys.argv[4]))
