"""The page's WebSocket: what the daemon tells to the page, and stops from it.

The page sends a stop here and as a request at once. This connection is open already, so that a stop on it
waits for no new one.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import TYPE_CHECKING, Any

from starlette.websockets import WebSocketDisconnect

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.service.api.orders import read_order
from needle_rig.web.guard import WEBSOCKET_PAGE, WEBSOCKET_TOKEN

if TYPE_CHECKING:
    from starlette.websockets import WebSocket

    from needle_rig.web.rig_link import RigLink

STOP_BYTES = 1024
"""A stop with its reason; the page says nothing else here."""
NOT_UNDERSTOOD = 1008
"""Close code of RFC 6455: the message breaks the policy."""


async def live(rig: RigLink, socket: WebSocket) -> None:
    """Tell all that the daemon tells, and pass stops on, until one side leaves."""
    both_ways = (WEBSOCKET_TOKEN, WEBSOCKET_PAGE)
    offered = [name for name in socket.scope["subprotocols"] if name.startswith(both_ways)]
    await socket.accept(subprotocol=offered[0] if offered else None)
    stops: set[asyncio.Task[None]] = set()

    async def tell() -> None:
        async with rig.watch() as listener:
            async for text in listener.messages():
                await socket.send_text(text)

    async def hear() -> None:
        while (message := await socket.receive())["type"] != "websocket.disconnect":
            try:
                key, content = _stop(message.get("text"))
            except BadInput as error:
                await socket.close(NOT_UNDERSTOOD, str(error)[:120])
                return
            # a stop never waits for the answer to one before it
            stop = asyncio.create_task(_pass_on(rig, socket, key, content))
            stops.add(stop)
            stop.add_done_callback(stops.discard)

    both = {asyncio.create_task(tell()), asyncio.create_task(hear())}
    try:
        await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        if stops:
            # it goes on to the daemon although its page has left
            await asyncio.wait(stops)
    finally:
        for task in both:
            task.cancel()
        await asyncio.gather(*both, return_exceptions=True)
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await socket.close()


def _stop(text: str | None) -> tuple[int, dict[str, Any]]:
    """Key and content of a stop; raises BadInput."""
    try:
        said = json.loads(text or "")
    except (ValueError, RecursionError):
        said = None
    key = said.pop("key", None) if isinstance(said, dict) else None
    if not isinstance(key, int):
        raise BadInput("this is no stop; send a JSON object with a key and a reason")
    return key, read_order("stop", said).model_dump(exclude_none=True)


async def _pass_on(rig: RigLink, socket: WebSocket, key: int, content: dict[str, Any]) -> None:
    said: dict[str, Any] = {"type": "stop", "key": key}
    try:
        await rig.order("stop", content)
    except NeedleRigError as error:
        said["error"] = str(error)
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_text(json.dumps(said))
