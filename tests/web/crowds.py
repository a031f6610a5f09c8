"""Crowds of clients without a token, who want to keep others from the page's server."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

from tests.web.served import Served

HEAD = b"GET / HTTP/1.1\r\nHost: x\r\nX-a: "
UPGRADE = (
    b"GET /api/live HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
)

Crowd = Callable[[Served], AbstractContextManager[None]]


@contextmanager
def connected(served: Served, count: int, said: bytes) -> Iterator[list[socket.socket]]:
    """So many connections, each of which says this and then waits."""
    with contextlib.ExitStack() as stack:
        crowd = []
        for _ in range(count):
            crowd.append(stack.enter_context(socket.create_connection(("127.0.0.1", served.port), 5)))
            crowd[-1].sendall(said)
        yield crowd


@contextmanager
def meanwhile(act: Callable[[], None]) -> Iterator[None]:
    """Do this again and again in a thread."""
    over = threading.Event()

    def go_on() -> None:
        while not over.is_set():
            with contextlib.suppress(OSError):
                act()

    thread = threading.Thread(target=go_on)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def half_open(served: Served) -> Iterator[None]:
    """150 heads without an end."""
    with connected(served, 150, HEAD):
        yield


@contextmanager
def slow_heads(served: Served) -> Iterator[None]:
    """150 heads that go on by a byte a second."""
    with connected(served, 150, HEAD) as crowd:

        def drip() -> None:
            for each in crowd:
                with contextlib.suppress(OSError):
                    each.send(b"y")
            time.sleep(1.0)

        with meanwhile(drip):
            time.sleep(1.5)
            yield


@contextmanager
def idle(served: Served) -> Iterator[None]:
    """150 that say nothing."""
    with connected(served, 150, b""):
        yield


@contextmanager
def endless_bodies(served: Served) -> Iterator[None]:
    """150 bodies in chunks, without an end."""
    head = b"POST /api/rig/jog HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n{"
    with connected(served, 150, head % served.port):
        yield


@contextmanager
def watchers(served: Served) -> Iterator[None]:
    """200 WebSockets."""
    with connected(served, 200, UPGRADE % served.port):
        yield


@contextmanager
def newcomers(served: Served) -> Iterator[None]:
    """500 connections a second, which stay as long as they may."""
    held: list[socket.socket] = []

    def come() -> None:
        held.append(socket.create_connection(("127.0.0.1", served.port), 1))
        if len(held) > 600:  # descriptors of this process
            held.pop(0).close()
        time.sleep(1 / 500)

    with meanwhile(come):
        time.sleep(1.5)
        yield
    for each in held:
        each.close()


CROWDS: list[Crowd] = [half_open, slow_heads, idle, endless_bodies, watchers, newcomers]
