"""The API over the daemon's socket: what each request asks of the daemon, and what comes back.

Commands that move the rig (`/compensate /jog /home /hold`) and `/clear`, `/release` may need a lease: while
somebody holds one, they must carry it in the header `Lease`; while nobody does, they need none. `POST /lease`
takes it (with the header: renews it), `DELETE /lease` returns it; it also ends when it is not used for 10 s
while the rig is still, and with every stop. `/stop` needs no lease and waits behind nothing. A request of
which the first byte came before a stop was acknowledged, or which carries a lease from before, is refused;
one that came in the same instant as the acknowledgement may be, and can be sent again.
Anybody may read `/state` and watch `/stream`.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from needle_rig.errors import Aborted, BadInput
from needle_rig.service.api.documents import Message
from needle_rig.service.api.openapi import ROUTES, Path, openapi_document
from needle_rig.service.api.orders import read_order
from needle_rig.service.api.serving import LetIn

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

    from needle_rig.service.api.connections import Connections
    from needle_rig.service.api.stream import Stream

BODY_LIMIT_BYTES = 64 * 1024
"""An order with every option full of numbers takes a third of this."""
ORDER_EVERY_S = 0.01
"""From one order to the next: a tick of 5 ms meets one at most, however many come."""
STATE_EVERY_S = 0.04
"""From one question for the state to the next: as often as the stream tells it, so that less than one tick in
a hundred meets the 0.3 ms that an answer takes."""
PATIENCE_S = 2.0


@dataclass(frozen=True)
class Answer:
    """What the daemon answers: a document, and the HTTP status of a refusal; 0 when it was done."""

    status: int
    content: Message


Ask = Callable[[str, Message, float, str | None], Awaitable[Answer]]
"""Asks the daemon: name of the order, its content, when its first byte came, and its lease."""


class TooMany(BadInput):
    """More is asked than the daemon should hear."""


class Shared:
    """One question for all who ask it at a time; who asks while it is on its way gets the next answer.

    Of questions with different contents the first is sent.
    """

    def __init__(self, ask: Callable[[Message], Awaitable[Answer]]) -> None:
        self._ask = ask
        self._asking: asyncio.Task[Answer] | None = None
        self._next: asyncio.Task[Answer] | None = None

    async def __call__(self, content: Message) -> Answer:
        """The answer to a question that was not sent before this call."""
        if self._next is None:
            self._next = asyncio.create_task(self._after(self._asking, content))
        return await asyncio.shield(self._next)

    async def _after(self, before: asyncio.Task[Answer] | None, content: Message) -> Answer:
        if before is not None:
            await asyncio.wait({before})
        self._asking, self._next = self._next, None
        return await self._ask(content)


class Pace:
    """Lets one through in `every_s`."""

    def __init__(self, every_s: float) -> None:
        self._every_s = every_s
        self._next_s = 0.0

    async def turn(self) -> None:
        """Wait for one's turn; raises TooMany instead of waiting long."""
        now_s = time.monotonic()
        wait_s = self._next_s - now_s
        if wait_s > PATIENCE_S:
            raise TooMany(f"more than {1 / self._every_s:g} requests a second; ask less often")
        self._next_s = max(now_s, self._next_s) + self._every_s
        if wait_s > 0:
            await asyncio.sleep(wait_s)


class Desk:
    """Passes requests on to the daemon: stops at once, the others one by one and none during a stop."""

    def __init__(self, ask: Ask, connections: Connections) -> None:
        self._ask_daemon = ask
        self._connections = connections
        self._stopping = 0
        self._stopped = asyncio.Event()
        self._stopped.set()
        self._acknowledged_s = -1.0
        self._orders, self._states = Pace(ORDER_EVERY_S), Pace(STATE_EVERY_S)
        self._state = Shared(self._ask_state)
        self._stop = Shared(lambda content: ask("stop", content, time.monotonic(), None))

    async def ask(self, order: str, content: Message, begun_s: float, lease: str | None) -> Answer:
        """Pass on an order that is no stop; raises Aborted for one that began before a stop."""
        await self._orders.turn()
        await self._stopped.wait()
        if begun_s <= self._acknowledged_s:
            raise Aborted("stopped by a person before it began; ask for it anew")
        return await self._ask_daemon(order, content, begun_s, lease)

    async def state(self) -> Answer:
        """The state as it is after this call."""
        return await self._state({})

    async def stop(self, content: Message) -> Answer:
        """Pass on a stop; the orders that come meanwhile wait until `acknowledged` is called."""
        self._stopping += 1
        self._stopped.clear()
        return await self._stop(content)

    def acknowledged(self) -> None:
        """The answer to a stop was written, or its client has gone."""
        self._acknowledged_s = self._connections.all_begun()
        self._stopping -= 1
        if not self._stopping:
            self._stopped.set()

    async def _ask_state(self, content: Message) -> Answer:
        await self._states.turn()
        return await self._ask_daemon("state", content, time.monotonic(), None)


class Acknowledgement(JSONResponse):
    """The answer to a stop, which tells the desk when it was written."""

    def __init__(self, answer: Answer, desk: Desk) -> None:
        super().__init__(answer.content, answer.status or 202)
        self._desk = desk

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See Response."""
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._desk.acknowledged()


def application(ask: Ask, stream: Stream, connections: Connections) -> ASGIApp:
    """The web application; `connections` must serve it, since they know when a request's first byte came."""
    desk = Desk(ask, connections)

    def route(path: Path) -> Route:
        async def answer(request: Request) -> Response:
            content = read_order(path.order, await _body(request)).model_dump()
            begun_s, lease = request.state.begun_s, request.headers.get("lease")
            told = await desk.ask(path.order, content, begun_s, lease)
            return JSONResponse(told.content, told.status or path.status)

        return Route(path.path, answer, methods=[path.method], name=path.order)

    async def stop(request: Request) -> Response:
        content = read_order("stop", await _body(request)).model_dump()
        try:
            answer = await desk.stop(content)
        except BaseException:
            desk.acknowledged()
            raise
        return Acknowledgement(answer, desk)

    async def state(_: Request) -> Response:
        return JSONResponse((await desk.state()).content)

    async def openapi(_: Request) -> Response:
        return JSONResponse(openapi_document())

    async def send_all(socket: WebSocket) -> None:
        with stream.listen() as listener:
            state = (await desk.state()).content
            await socket.send_text(json.dumps({name: state[name] for name in state if name != "ticks"}))
            async for text in listener.messages():
                await socket.send_text(text)
            await socket.close()

    async def watch(socket: WebSocket) -> None:
        await socket.accept()
        both = {asyncio.create_task(send_all(socket)), asyncio.create_task(_until_gone(socket))}
        try:
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in both:
                task.cancel()
            for task in both:
                with contextlib.suppress(asyncio.CancelledError, WebSocketDisconnect, TooMany):
                    await task

    own = {"stop": stop, "state": state}
    app = Starlette(
        routes=[
            *(
                Route(path.path, own[path.order], methods=[path.method]) if path.order in own else route(path)
                for path in ROUTES
            ),
            Route("/openapi.json", openapi),
            WebSocketRoute("/stream", watch),
        ],
        exception_handlers={
            BadInput: _refuse,
            Aborted: _refuse,
            HTTPException: _refuse_path,
        },
    )
    return LetIn(app)


async def _until_gone(socket: WebSocket) -> None:
    """Drop what a watcher says until it leaves."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


_DESCRIBED = {"Link": '</openapi.json>; rel="service-desc"'}
"""Where a program finds what may be asked (RFC 8631); a person at a command line asks --help."""


class TooLong(BadInput):
    """A body beyond the limit."""


async def _body(request: Request) -> bytes:
    content = bytearray()
    try:
        async for chunk in request.stream():
            # what is too long is read all the same: its client reads no answer before
            if len(content) <= BODY_LIMIT_BYTES:
                content += chunk
    except ClientDisconnect:
        raise BadInput("the request broke off; send it again") from None
    if len(content) > BODY_LIMIT_BYTES:
        raise TooLong(f"the request is longer than {BODY_LIMIT_BYTES} bytes; send less")
    return bytes(content)


async def _refuse(_: Request, error: Exception) -> Response:
    assert isinstance(error, BadInput | Aborted)
    status = {TooLong: 413, TooMany: 429, Aborted: 409}.get(type(error), 422)
    return JSONResponse({"error": str(error), "exit_code": error.exit_code}, status, _DESCRIBED)


async def _refuse_path(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    text = f"{request.method} {request.url.path}: {error.detail.lower()}"
    headers = {**(error.headers or {}), **_DESCRIBED}
    return JSONResponse({"error": text, "exit_code": BadInput.exit_code}, error.status_code, headers)
