"""Sends what happens to all who listen; a slow listener gets the newest state, not a queue of old ones."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

_EVENT_LIMIT = 1000

Document = dict[str, Any]


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
    """Turns documents into text once and hands it to every listener. States are thinned out to `rate_hz`."""

    def __init__(self, rate_hz: float = 25.0) -> None:
        self._listeners: set[Listener] = set()
        self._all_left = asyncio.Event()
        self._period_s = 1 / rate_hz
        self._next_state_s = 0.0

    def event(self, document: Document) -> None:
        """Send an event at once."""
        if self._listeners:
            text = json.dumps(document, allow_nan=False)
            for listener in self._listeners:
                listener.put_event(text)

    def state(self, now_s: float, describe: Callable[[], Document]) -> None:
        """Send the state that `describe` gives, if somebody listens and it is time; `now_s` is wall time."""
        if self._listeners and now_s >= self._next_state_s:
            self._next_state_s = now_s + self._period_s
            text = json.dumps(describe(), allow_nan=False)
            for listener in self._listeners:
                listener.put_state(text)

    @contextmanager
    def listen(self) -> Iterator[Listener]:
        """Listen inside a with block."""
        listener = Listener()
        self._listeners.add(listener)
        try:
            yield listener
        finally:
            self._listeners.discard(listener)
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
