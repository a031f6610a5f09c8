"""A uvicorn server on connections with limits: the daemon's API and the page are served by it alike."""

from __future__ import annotations

import functools
import resource
import socket
from typing import TYPE_CHECKING, Any

import uvicorn

from needle_rig.service.api.connections import (
    LET_IN,
    REQUEST_S,
    SPARE,
    Connections,
    HttpConnection,
    WatcherConnection,
)

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Receive, Scope, Send

STRANGERS_AND_LET_IN = 2
"""Budgets of connections."""


class LetIn:
    """Lets everybody into `app` who sends a whole head: who may connect may ask."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        scope["state"][LET_IN]()
        await self._app(scope, receive, send)


def server(app: ASGIApp, connections: Connections, **uvicorns: Any) -> uvicorn.Server:
    """A server with our connections and their limits; `uvicorns` are its further settings."""
    return _Server(
        uvicorn.Config(
            app,
            http=functools.partial(HttpConnection, connections),  # type: ignore[arg-type]
            ws=functools.partial(WatcherConnection, connections),  # type: ignore[arg-type]
            access_log=False,
            log_config=None,
            timeout_keep_alive=round(REQUEST_S),
            timeout_graceful_shutdown=1,
            **uvicorns,
        ),
        connections,
    )


class _Server(uvicorn.Server):
    def __init__(self, config: uvicorn.Config, connections: Connections) -> None:
        super().__init__(config)
        self._connections = connections

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:  # noqa: ARG002 uvicorn's
        await super().startup([])
        if not self.should_exit:
            self._connections.open(self._make)

    def _make(self) -> HttpConnection:
        config = self.config
        made = config.http_protocol_class(  # type: ignore[call-arg]
            config=config, server_state=self.server_state, app_state=self.lifespan.state
        )
        assert isinstance(made, HttpConnection)
        return made

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._connections.close()
        await super().shutdown(sockets)


def connection_limit(wanted: int, own_descriptors: int) -> int:
    """How many connections of each kind the system gives descriptors for, at most `wanted`.

    Leaves room for the newcomers of one turn and for `own_descriptors`, and raises the soft limit to that.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    beside = SPARE + own_descriptors
    needed = STRANGERS_AND_LET_IN * wanted + beside
    allowed = needed if hard == resource.RLIM_INFINITY else min(hard, needed)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    return max((allowed - beside) // STRANGERS_AND_LET_IN, 1)
