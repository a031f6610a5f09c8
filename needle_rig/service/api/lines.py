"""Lines between the daemon and its API process, over one socket pair: a word, a blank and a JSON document."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable

from needle_rig.service.api.documents import Message

LINE_LIMIT_BYTES = 4 * 2**20
"""Far above the longest state; a longer line means that the other end has gone mad."""


class Lines(asyncio.Protocol):
    """One end. `on_line` gets each line as it came, `on_end` is called once, when no more will come."""

    def __init__(self, on_line: Callable[[str, bytes], None], on_end: Callable[[], None]) -> None:
        self._on_line, self._on_end = on_line, on_end
        self._rest = b""
        self._transport: asyncio.WriteTransport | None = None

    @property
    def waiting_bytes(self) -> int:
        """What the other end has not taken yet."""
        return 0 if self._transport is None else self._transport.get_write_buffer_size()

    def send(self, word: str, document: Message) -> None:
        """Send a line, unless the other end has gone; never waits."""
        if self._transport is not None:
            text = json.dumps(document, allow_nan=False)
            self._transport.write(f"{word} {text}\n".encode())

    def close(self) -> None:
        """Close this end; safe to call twice."""
        if self._transport is not None:
            self._transport.abort()

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """See asyncio.Protocol."""
        assert isinstance(transport, asyncio.WriteTransport)
        self._transport = transport

    def data_received(self, data: bytes) -> None:
        """See asyncio.Protocol."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        for line in lines:
            word, _, text = line.partition(b" ")
            self._on_line(word.decode(), text)
        if len(self._rest) > LINE_LIMIT_BYTES:
            self.close()

    def connection_lost(self, exc: Exception | None) -> None:  # noqa: ARG002 see asyncio.Protocol
        """See asyncio.Protocol."""
        self._transport = None
        self._on_end()
