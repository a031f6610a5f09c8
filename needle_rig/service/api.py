"""The daemon's API over its socket: compensate, stop, clear, state, stream."""

from __future__ import annotations

import contextlib
import json
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import uvicorn
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from needle_rig.errors import BadInput, NeedleRigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from needle_rig.service.daemon import Daemon

_BODY_LIMIT_BYTES = 1 << 20

Model = TypeVar("Model", bound=BaseModel)


class Order(BaseModel):
    """The body of POST /compensate. `options` are the strategy's own, by name."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    target_deg: float
    strategy: str = "reed2008"
    options: dict[str, Any] = {}
    settle_s: Annotated[float, Field(ge=0.1, le=600)] | None = None
    speed_deg_s: Annotated[float, Field(gt=0, le=360)] | None = None
    lag_left_deg: float | None = None


class Reason(BaseModel):
    """The body of POST /stop."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    reason: Annotated[str, Field(min_length=1, max_length=200)] = "stopped by a person"


def application(daemon: Daemon) -> Starlette:
    """The web application; its handlers share the daemon's event loop and are short."""

    async def compensate(request: Request) -> Response:
        return _answer(await daemon.compensate(await _body(request, Order)), 202)

    async def stop(request: Request) -> Response:
        daemon.stop((await _body(request, Reason)).reason)
        return _answer({"stopping": True}, 202)

    async def clear(request: Request) -> Response:
        daemon.clear()
        return _answer({"clearing": True}, 202)

    async def state(request: Request) -> Response:
        return _answer({**daemon.describe(), "ticks": daemon.describe_timing()})

    async def stream(socket: WebSocket) -> None:
        await socket.accept()
        with daemon.stream.listen() as listener, contextlib.suppress(WebSocketDisconnect):
            listener.put_event(json.dumps(daemon.describe(), allow_nan=False))
            async for text in listener.messages():
                await socket.send_text(text)
            await socket.close()

    async def refuse(request: Request, error: Exception) -> Response:
        assert isinstance(error, NeedleRigError)
        status = 422 if isinstance(error, BadInput) else 409
        return _answer({"error": str(error), "exit_code": error.exit_code}, status)

    return Starlette(
        routes=[
            Route("/compensate", compensate, methods=["POST"]),
            Route("/stop", stop, methods=["POST"]),
            Route("/clear", clear, methods=["POST"]),
            Route("/state", state),
            WebSocketRoute("/stream", stream),
        ],
        exception_handlers={NeedleRigError: refuse},
    )


def server(daemon: Daemon) -> uvicorn.Server:
    """A server for the application that leaves signals, sockets and logs to the daemon."""
    return _Server(
        uvicorn.Config(
            application(daemon),
            lifespan="off",
            access_log=False,
            log_config=None,
            ws="websockets-sansio",
            timeout_graceful_shutdown=1,
        )
    )


class _Server(uvicorn.Server):
    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def _body(request: Request, model: type[Model]) -> Model:
    """The request's JSON body as `model`; an empty body stands for all defaults."""
    content = bytearray()
    try:
        async for chunk in request.stream():
            content += chunk
            if len(content) > _BODY_LIMIT_BYTES:
                raise BadInput(f"the request is longer than {_BODY_LIMIT_BYTES} bytes")
    except ClientDisconnect:
        raise BadInput("the request broke off") from None
    try:
        return model.model_validate_json(bytes(content) or b"{}")
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the request"
        raise BadInput(f"{place}: {first['msg'].lower()}") from None


def _answer(document: dict[str, Any], status: int = 200) -> Response:
    return JSONResponse(document, status)
