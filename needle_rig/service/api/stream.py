"""Hands what happens to all who listen; a slow listener gets the newest state, not a queue of old ones."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress

_EVENT_LIMIT = 1000


class Listener:
    """One listener's view: every event in order, and the newest state."""

    def __init__(self) -> None:
        self._events: deque[str] = deque(maxlen=_EVENT_LIMIT)
        self._state: str | None = None
        self._news = asyncio.Event()
        self._over = False

    def put_event(self, text: str) -> None:
        """Keep an event until it is fetched; of more than a thousand the oldest go."""
        self._events.append(text)
        self._news.set()

    def put_state(self, text: str) -> None:
        """Replace the state that was not fetched yet."""
        self._state = text
        self._news.set()

    def end(self) -> None:
        """No more will come."""
        self._over = True
        self._news.set()

    async def messages(self) -> AsyncIterator[str]:
        """What comes in, events before the state, until the end."""
        while True:
            while self._events:
                yield self._events.popleft()
            if self._state is not None:
                text, self._state = self._state, None
                yield text
            if self._over and not self._events and self._state is None:
                return
            if not self._events and self._state is None:
                self._news.clear()
                await self._news.wait()


class Stream:
    """Hands texts to every listener; `on_count` is called with how many there are when that changes."""

    def __init__(self, on_count: Callable[[int], None] = lambda _: None) -> None:
        self._listeners: set[Listener] = set()
        self._on_count = on_count
        self._all_left = asyncio.Event()

    def event(self, text: str) -> None:
        """Hand on an event, which nobody misses."""
        for listener in self._listeners:
            listener.put_event(text)

    def state(self, text: str) -> None:
        """Hand on a state, which stands in for the one before."""
        for listener in self._listeners:
            listener.put_state(text)

    @contextmanager
    def listen(self) -> Iterator[Listener]:
        """Listen inside a with block."""
        listener = Listener()
        self._listeners.add(listener)
        self._on_count(len(self._listeners))
        try:
            yield listener
        finally:
            self._listeners.discard(listener)
            self._on_count(len(self._listeners))
            if not self._listeners:
                self._all_left.set()

    async def end(self, wait_s: float = 1.0) -> None:
        """Tell every listener that it is over, and wait until all have fetched the rest, at most `wait_s`."""
        if not self._listeners:
            return
        self._all_left.clear()
        for listener in self._listeners:
            listener.end()
        with suppress(TimeoutError):
            await asyncio.wait_for(self._all_left.wait(), wait_s)
