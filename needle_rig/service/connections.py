"""The API's connections: how many, how long each may take, and when the first byte of a request came."""

from __future__ import annotations

import asyncio
import select
import socket
import time
from collections.abc import Mapping
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
_TURNS_FROM_QUEUE = 4
_TURNS_FROM_ACCEPT = 2
"""Turns of the event loop until a connection is made that waits at the listener, or that was accepted."""


class Connections:
    """All connections, at most `limit`: a new one always gets in, since it may carry a stop.

    Needs a running asyncio loop and `sweep` in it.
    """

    def __init__(self, listener: socket.socket, limit: int) -> None:
        self._listener = listener
        self._limit = limit
        self._clients: dict[HttpConnection, None] = {}
        self._watchers: dict[WatcherConnection, None] = {}
        self._newcomers_begun_s: float | None = None

    def opened(self) -> None:
        """The server accepts from now on: what waits at the listener came at an unknown time, long ago."""
        self._take_newcomers_for_begun(0.0, _TURNS_FROM_QUEUE)

    def all_begun(self) -> float:
        """The time now, on the monotonic clock; requests of which a byte has come, read or not, begun before.

        Called right after a stop was acknowledged: what lies in a queue of the kernel then came before.
        """
        poll = select.poll()
        poll.register(self._listener, select.POLLIN)
        waiting = {}
        for client in self._clients:
            if client.begun_s is None and (descriptor := client.descriptor) >= 0:
                waiting[descriptor] = client
                poll.register(descriptor, select.POLLIN)
        ready = poll.poll(0)
        now_s = time.monotonic()
        for descriptor, _ in ready:
            if descriptor in waiting:
                waiting[descriptor].begun_s = now_s
        listened = any(descriptor == self._listener.fileno() for descriptor, _ in ready)
        self._take_newcomers_for_begun(now_s, _TURNS_FROM_QUEUE if listened else _TURNS_FROM_ACCEPT)
        return now_s

    def _take_newcomers_for_begun(self, begun_s: float, turns: int) -> None:
        self._newcomers_begun_s = begun_s if turns else None
        if turns:
            asyncio.get_running_loop().call_soon(self._take_newcomers_for_begun, begun_s, turns - 1)

    def add(self, connection: HttpConnection | WatcherConnection) -> None:
        """Take one in; beyond the limit the oldest that watches nothing goes, or else the oldest watcher."""
        if isinstance(connection, HttpConnection):
            if self._newcomers_begun_s is not None and _has_come(connection):
                connection.begun_s = self._newcomers_begun_s
            self._clients[connection] = None
        else:
            self._watchers[connection] = None
        if len(self._clients) + len(self._watchers) > self._limit:
            queue: Mapping[Any, None] = (
                self._clients if len(self._clients) > 1 or not self._watchers else self._watchers
            )
            oldest: HttpConnection | WatcherConnection = next(iter(queue))
            self.discard(oldest)
            oldest.transport.abort()

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
                    connection.transport.abort()


def _has_come(connection: HttpConnection) -> bool:
    poll = select.poll()
    poll.register(connection.descriptor, select.POLLIN)
    return bool(poll.poll(0))


class HttpConnection(H11Protocol):
    """Says in `request.state.begun_s` when a request's first byte came, on the monotonic clock.

    Of requests that come in one piece all have the time of the first: never too late.
    """

    def __init__(self, connections: Connections, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._all = connections
        self.begun_s: float | None = None
        self._since_s = time.monotonic()

    @property
    def descriptor(self) -> int:
        """Of its socket; -1 when that is closed."""
        own = self.transport.get_extra_info("socket")
        return -1 if own is None else int(own.fileno())

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """See asyncio.Protocol."""
        super().connection_made(transport)
        self._all.add(self)

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
        self._all.add(self)

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
