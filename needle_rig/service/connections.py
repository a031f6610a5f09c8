"""The API's connections: how many, how long each may take, and when the first byte of a request came."""

from __future__ import annotations

import asyncio
import logging
import select
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

REQUEST_S = 5.0
"""So long a request may take to come, from the connection or the last answer; a client needs some 10 ms."""
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
_ACCEPT_AGAIN_S = 0.1

log = logging.getLogger("api")


class Connections:
    """All connections to `listener`, at most `limit`: a new one always gets in, since it may carry a stop."""

    def __init__(self, listener: socket.socket, limit: int) -> None:
        self._listener = listener
        self._limit = limit
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
        unread = {client.socket.fileno(): client for client in self._clients if client.begun_s is None}
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
            self._add(self._clients, connection)
            task = loop.create_task(loop.connect_accepted_socket(lambda c=connection: c, accepted))  # type: ignore[misc]
            self._making.add(task)
            task.add_done_callback(self._making.discard)

    def _accept_again(self) -> None:
        if self._make is not None:
            asyncio.get_running_loop().add_reader(self._listener, self._accept)

    def watch(self, connection: WatcherConnection) -> None:
        """Take in a client that became a watcher."""
        self._add(self._watchers, connection)

    def _add(self, those: dict[Any, None], connection: HttpConnection | WatcherConnection) -> None:
        """Beyond the limit the oldest that watches nothing goes, or else the oldest watcher."""
        those[connection] = None
        if len(self._clients) + len(self._watchers) > self._limit:
            only_watchers = len(self._clients) <= 1 and self._watchers
            queue: Mapping[Any, None] = self._watchers if only_watchers else self._clients
            oldest: HttpConnection | WatcherConnection = next(iter(queue))
            self.discard(oldest)
            oldest.drop()

    def discard(self, connection: HttpConnection | WatcherConnection) -> None:
        """Forget one."""
        if isinstance(connection, HttpConnection):
            self._clients.pop(connection, None)
        else:
            self._watchers.pop(connection, None)

    async def sweep(self) -> None:
        """Drop those that take too long, for ever."""
        while True:
            await asyncio.sleep(_SWEEP_EVERY_S)
            now_s = time.monotonic()
            everybody: tuple[HttpConnection | WatcherConnection, ...] = (*self._clients, *self._watchers)
            for connection in everybody:
                if connection.overdue(now_s):
                    connection.drop()


def _readable(descriptors: Iterable[int]) -> list[int]:
    poll = select.poll()
    for descriptor in descriptors:
        if descriptor >= 0:
            poll.register(descriptor, select.POLLIN)
    return [descriptor for descriptor, _ in poll.poll(0)]


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
        self.app_state = {"begun_s": self.begun_s}
        super().data_received(data)

    def on_response_complete(self) -> None:
        """See H11Protocol."""
        self._since_s = time.monotonic()
        super().on_response_complete()
        if self.cycle.response_complete and not self.conn.trailing_data[0]:
            self.begun_s = None

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
        coming = self.conn.their_state in (h11.IDLE, h11.SEND_BODY)
        return now_s - self._since_s > (REQUEST_S if coming else ANSWER_S)


class WatcherConnection(WebSocketsSansIOProtocol):
    """A watcher of the stream, dropped when it does not read."""

    def __init__(self, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._all = connections
        self._stuck_since_s: float | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See asyncio.Protocol."""
        super().connection_made(transport)
        self._all.watch(self)

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
