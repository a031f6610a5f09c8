"""The rig for the page: one connection to the daemon's stream for all watchers, and orders to it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import httpx
from websockets.asyncio.client import unix_connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake

from needle_rig.errors import NeedleRigError, RigFault
from needle_rig.service.api.endpoint import sockets_for_client
from needle_rig.service.api.openapi import ROUTES
from needle_rig.service.api.stream import Listener, Stream
from needle_rig.service.client import failure
from needle_rig.version import differs

AGAIN_S = 0.3
"""From one try to reach the daemon to the next, and from one word to the watchers that nobody answers."""
SILENT_S = 1.0
"""A stream that says nothing for so long is broken; it speaks 30 times a second."""
ANSWER_S = 15.0
STOP_S = 1.0
"""A person who pressed Stop waits no longer for its confirmation before the emergency stop."""
HOLDER = "a person at the page"
ORDERS = frozenset(path.order for path in ROUTES if path.method == "POST" and path.order != "take_lease")

Document = dict[str, Any]


class RigLink:
    """The daemon at `path`, or at the first usual place where one answers; the page's `own` ends for good."""

    def __init__(self, path: Path | None, own: bool = False) -> None:
        self._path, self._own = path, own
        self._stream = Stream()
        self._lease: str | None = None
        self._orders = asyncio.Lock()
        self._newest: str | None = None
        self._task: asyncio.Task[None] | None = None
        self.reached = False

    def open(self) -> None:
        """Begin to listen, in the running loop."""
        self._task = asyncio.get_running_loop().create_task(self._listen())

    async def close(self) -> None:
        """End the connection and let all watchers go."""
        if self._task is not None:
            self._task.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._task
        await self._stream.end(0.2)

    @asynccontextmanager
    async def watch(self) -> AsyncIterator[Listener]:
        """What the daemon tells from now on, the newest state first."""
        with self._stream.listen() as listener:
            if self._newest is not None:
                listener.put_state(self._newest)
            yield listener

    def tell(self, document: Mapping[str, Any]) -> None:
        """Tell all watchers something of our own, as an event between those of the daemon."""
        self._stream.event(json.dumps(document))

    @property
    def other_version(self) -> str | None:
        """That the daemon is of another version; None where it is of the same, or silent."""
        if not self.reached or self._newest is None:
            return None
        return differs(json.loads(self._newest).get("version"))

    async def order(self, name: str, content: Mapping[str, Any]) -> Document:
        """Pass an order on; one that needs a lease takes it. Raises BadInput, RigFault, Aborted.

        A stop waits behind nothing.
        """
        if name == "stop":
            return await self._stop(content)
        async with self._orders:
            await self._take_lease()
            headers = {} if self._lease is None else {"Lease": self._lease}
            return await self._ask(f"/{name}", content, headers)

    async def _stop(self, content: Mapping[str, Any]) -> Document:
        """The daemon's own confirmation, which comes once it took the stop."""
        self._lease = None
        try:
            async with asyncio.timeout(STOP_S):
                return await self._ask("/stop", content, {})
        except TimeoutError:
            raise RigFault(
                f"the daemon did not confirm the stop within {STOP_S:g} s; use the emergency stop"
            ) from None

    async def _take_lease(self) -> None:
        """Take it, or renew ours; one that a stop or ten seconds of rest ended is taken anew."""
        if self._lease is not None:
            try:
                await self._ask("/lease", {"holder": HOLDER}, {"Lease": self._lease})
                return
            except NeedleRigError:
                self._lease = None
        self._lease = (await self._ask("/lease", {"holder": HOLDER}, {}))["lease"]

    async def _ask(self, path: str, content: Mapping[str, Any], headers: Mapping[str, str]) -> Document:
        last: Exception | None = None
        for place in self._places():
            try:
                async with httpx.AsyncClient(
                    transport=httpx.AsyncHTTPTransport(uds=str(place), verify=False),
                    base_url="http://daemon",
                    timeout=ANSWER_S,
                ) as client:
                    answer: Document = (await client.post(path, json=content, headers=headers)).json()
            except (httpx.TransportError, ValueError) as error:
                last = error
                continue
            if "error" in answer:
                raise failure(answer)
            return answer
        raise RigFault(f"no daemon answers ({type(last).__name__}); {self._advice()}") from None

    def _advice(self) -> str:
        return "start needle-rig web again" if self._own else "start one: needle-rig daemon"

    def _places(self) -> list[Path]:
        return sockets_for_client() if self._path is None else [self._path]

    async def _listen(self) -> None:
        while True:
            for place in self._places():
                with contextlib.suppress(OSError, InvalidHandshake, EOFError, ConnectionClosed, TimeoutError):
                    async with unix_connect(
                        str(place), uri="ws://daemon/stream", max_size=None, compression=None, open_timeout=5
                    ) as stream:
                        while True:
                            # wait_for of Python 3.11 loses a cancellation that comes with a message
                            async with asyncio.timeout(SILENT_S):
                                text = await stream.recv(decode=True)
                            self._take(text)
            self._lost()
            await asyncio.sleep(AGAIN_S)

    def _take(self, text: str | bytes) -> None:
        assert isinstance(text, str)
        self.reached = True
        # as the daemon writes it; the one key that tells events from states stands in every document
        if '"type": "state"' in text or '"type":"state"' in text:
            self._newest = text
            self._stream.state(text)
        else:
            self._stream.event(text)

    def _lost(self) -> None:
        self.reached = False
        where = " or ".join(str(place) for place in self._places())
        text = f"no daemon answers at {where}; {self._advice()}"
        if self._own:
            text = f"the rig of this page has ended; {self._advice()}"
        said = {"type": "lost", "text": text}
        self._newest = json.dumps(said | {"at": round(time.monotonic(), 1)})
        self._stream.state(self._newest)
