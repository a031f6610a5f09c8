"""A server's connections: how many, how long each may take, and when the first byte of a request came.

Who has not shown yet that it may ask is a stranger. Strangers and those that were let in have a budget each,
so that no number of strangers takes a place of somebody who may command.
"""

from __future__ import annotations

import asyncio
import logging
import select
import socket
import time
from collections.abc import Callable, Iterable
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import CloseCode

REQUEST_S = 5.0
"""So long a request may take to come, from the connection or the last answer; a client needs some 10 ms.

A browser opens a connection before it has a request, and would open another one if this were short.
"""
ANSWER_S = 30.0
"""So long an answer may take to be made and fetched; the slowest, a start on a slow disk, takes 10 s."""
UNREAD_S = 5.0
"""So long a watcher may leave a full buffer unread."""
_SWEEP_EVERY_S = 0.5
ACCEPTED_AT_ONCE = 16
"""Connections that are accepted in one turn of the loop."""
_TURNS_TO_CLOSE = 4
SPARE = ACCEPTED_AT_ONCE * _TURNS_TO_CLOSE
"""Descriptors beyond the limit."""
LET_IN = "let_in"
"""Key of a scope's state: what an application calls for a connection that has shown that it may ask."""
_ACCEPT_AGAIN_S = 0.1

log = logging.getLogger("api")


class Connections:
    """All connections to `listener`: at most `limit` strangers, and at most `limit` that were let in.

    A new one always gets in, since it may carry a stop; then the oldest stranger goes. The application times
    bodies and answers of those that were let in when it is `timed_by_application`.
    """

    def __init__(self, listener: socket.socket, limit: int, *, timed_by_application: bool = False) -> None:
        self._listener = listener
        self._limit = limit
        self.timed_by_application = timed_by_application
        self._strangers: dict[Connection, None] = {}
        self._clients: dict[HttpConnection, None] = {}
        self._watchers: dict[WatcherConnection, None] = {}
        self._make: Callable[[], HttpConnection] | None = None
        self._making: set[asyncio.Task[Any]] = set()
        self._queue_begun_s: float | None = None

    def open(self, make: Callable[[], HttpConnection]) -> None:
        """Accept from now on, in the running asyncio loop. What waits already came at an unknown time."""
        self._make = make
        self._queue_begun_s = 0.0
        asyncio.get_running_loop().add_reader(self._listener, self._accept)

    def close(self) -> None:
        """Accept no more; safe to call twice."""
        self._make = None
        asyncio.get_running_loop().remove_reader(self._listener)

    def all_begun(self) -> float:
        """The time now, on the monotonic clock; requests of which a byte has come, read or not, begun before.

        Called right after a stop was acknowledged: what lies in a queue of the kernel then came before.
        """
        now_s = time.monotonic()
        self._queue_begun_s = now_s
        self._accept()
        requests = [each for each in (*self._strangers, *self._clients) if isinstance(each, HttpConnection)]
        unread = {request.socket.fileno(): request for request in requests if request.begun_s is None}
        for descriptor in _readable(unread):
            unread[descriptor].begun_s = now_s
        return now_s

    def _accept(self) -> None:
        loop = asyncio.get_running_loop()
        for _ in range(ACCEPTED_AT_ONCE):
            try:
                accepted, _ = self._listener.accept()
            except BlockingIOError:
                self._queue_begun_s = None
                return
            except OSError as error:
                log.warning("no connection can be accepted: %s", error)
                loop.remove_reader(self._listener)
                loop.call_later(_ACCEPT_AGAIN_S, self._accept_again)
                return
            accepted.setblocking(False)
            if self._make is None:
                accepted.close()
                return
            connection = self._make()
            connection.socket = accepted
            if self._queue_begun_s is not None and _readable([accepted.fileno()]):
                connection.begun_s = self._queue_begun_s
            self.add(connection)
            task = loop.create_task(loop.connect_accepted_socket(lambda c=connection: c, accepted))  # type: ignore[misc]
            self._making.add(task)
            task.add_done_callback(self._making.discard)

    def _accept_again(self) -> None:
        if self._make is not None:
            asyncio.get_running_loop().add_reader(self._listener, self._accept)

    def add(self, stranger: Connection) -> None:
        """Take in a connection that has shown nothing yet; beyond the limit the oldest such one goes."""
        self._strangers[stranger] = None
        if len(self._strangers) > self._limit:
            self._close(next(iter(self._strangers)))

    def let_in(self, connection: Connection) -> None:
        """It has shown that it may ask. Beyond the limit the oldest that watches nothing goes, or else the
        oldest watcher. Safe to call twice, and for one that has gone.
        """
        if connection not in self._strangers:
            return
        del self._strangers[connection]
        if isinstance(connection, HttpConnection):
            self._clients[connection] = None
        else:
            self._watchers[connection] = None
        if len(self._clients) + len(self._watchers) > self._limit:
            others: list[Connection] = [each for each in self._clients if each is not connection]
            self._close(next(iter(others or self._watchers), connection))

    def is_stranger(self, connection: Connection) -> bool:
        """Whether it has shown nothing yet."""
        return connection in self._strangers

    def _close(self, connection: Connection) -> None:
        self.discard(connection)
        connection.drop()

    def discard(self, connection: Connection) -> None:
        """Forget one."""
        self._strangers.pop(connection, None)
        if isinstance(connection, HttpConnection):
            self._clients.pop(connection, None)
        else:
            self._watchers.pop(connection, None)

    async def sweep(self) -> None:
        """Drop those that take too long, for ever."""
        while True:
            await asyncio.sleep(_SWEEP_EVERY_S)
            now_s = time.monotonic()
            for connection in (*self._strangers, *self._clients, *self._watchers):
                if connection.overdue(now_s):
                    connection.drop()


def _readable(descriptors: Iterable[int]) -> list[int]:
    poll = select.poll()
    for descriptor in descriptors:
        if descriptor >= 0:
            poll.register(descriptor, select.POLLIN)
    return [descriptor for descriptor, _ in poll.poll(0)]


def _is_utf8(text: bytes) -> bool:
    try:
        text.decode()
    except UnicodeDecodeError:
        return False
    return True


class HttpConnection(H11Protocol):
    """Says in `request.state.begun_s` when a request's first byte came, on the monotonic clock.

    Of requests that come in one piece all have the time of the first: never too late.
    """

    def __init__(self, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._all = connections
        self.socket: socket.socket
        self.begun_s: float | None = None
        self._since_s = time.monotonic()
        self._dropped = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See asyncio.Protocol."""
        super().connection_made(transport)
        if self._dropped:
            transport.abort()

    def drop(self) -> None:
        """Close it at once, whatever goes on."""
        self._dropped = True
        if self.transport is not None:
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """See asyncio.Protocol."""
        if self.begun_s is None:
            self.begun_s = time.monotonic()
        self.app_state = {"begun_s": self.begun_s, LET_IN: self._let_in}
        super().data_received(data)

    def on_response_complete(self) -> None:
        """See H11Protocol."""
        self._since_s = time.monotonic()
        super().on_response_complete()
        if self.cycle.response_complete and not self.conn.trailing_data[0]:
            self.begun_s = None

    def _let_in(self) -> None:
        self._all.let_in(self)

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """See H11Protocol."""
        self._all.discard(self)
        super().handle_websocket_upgrade(event)

    def connection_lost(self, exc: Exception | None) -> None:
        """See asyncio.Protocol."""
        self._all.discard(self)
        super().connection_lost(exc)

    def overdue(self, now_s: float) -> bool:
        """Whether its request, or the answer, has taken too long."""
        state = self.conn.their_state
        if state is not h11.IDLE and self._all.timed_by_application and not self._all.is_stranger(self):
            return False
        return now_s - self._since_s > (REQUEST_S if state in (h11.IDLE, h11.SEND_BODY) else ANSWER_S)


class WatcherConnection(WebSocketsSansIOProtocol):
    """A watcher of the stream, dropped when it does not read."""

    def __init__(self, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._all = connections
        self.app_state = {**self.app_state, LET_IN: self._let_in}
        self._stuck_since_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See asyncio.Protocol."""
        super().connection_made(transport)
        self._all.add(self)

    def _let_in(self) -> None:
        self._all.let_in(self)

    def send_receive_event_to_app(self) -> None:
        """See WebSocketsSansIOProtocol, which logs a traceback for a text that is no UTF-8."""
        if self.curr_msg_data_type == "text" and not self.close_sent and not _is_utf8(b"".join(self.frames)):
            self.frames = []
            self.conn.send_close(CloseCode.INVALID_DATA)
            self.handle_parser_exception()
            return
        super().send_receive_event_to_app()

    def handle_parser_exception(self) -> None:
        """See WebSocketsSansIOProtocol, which calls what is sent afterwards a defect of the application."""
        super().handle_parser_exception()
        self.disconnected = True

    def drop(self) -> None:
        """Close it at once, whatever goes on."""
        self.transport.abort()

    def pause_writing(self) -> None:
        """See asyncio.Protocol."""
        self._stuck_since_s = time.monotonic()
        super().pause_writing()

    def resume_writing(self) -> None:
        """See asyncio.Protocol."""
        self._stuck_since_s = None
        super().resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """See asyncio.Protocol."""
        self._all.discard(self)
        super().connection_lost(exc)

    def overdue(self, now_s: float) -> bool:
        """Whether it has left a full buffer unread for too long, or does not take its farewell."""
        if self._stuck_since_s is None and self.transport.is_closing():
            self._stuck_since_s = now_s
        return self._stuck_since_s is not None and now_s - self._stuck_since_s > UNREAD_S


Connection = HttpConnection | WatcherConnection
