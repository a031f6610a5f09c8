"""Who may ask the page's server: this computer's browser, from the page itself, with the token.

A loopback address alone keeps nobody out who runs a page in the same browser: a foreign page may post to it
or open a WebSocket (its Origin tells), and a foreign name may be pointed at it (DNS rebinding; its Host
tells).
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
from dataclasses import dataclass
from http.cookies import CookieError, SimpleCookie
from typing import TYPE_CHECKING

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.websockets import WebSocketClose

from needle_rig.errors import BadInput
from needle_rig.service.api.connections import LET_IN

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = "127.0.0.1"
API = "/api/"
SESSION = "session"
"""Key of a scope's state: the halves of a browser's session, for whoever showed the token."""
PAGE_HEADER = "x-needle-rig-page"
WEBSOCKET_PAGE = "page."
"""As the token's: the page's half of a session."""
WEBSOCKET_TOKEN = "token."
"""A browser cannot give a WebSocket a header, but it can name subprotocols: `token.` and the token."""
POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "img-src 'self' data: blob:",
        "connect-src 'self'",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
    )
)
HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""With every answer."""


@dataclass(frozen=True)
class Refusal:
    """Why a request is not let in."""

    status: int
    sentence: str


@dataclass(frozen=True)
class Session:
    """What lets other tabs of a browser in without the token: two halves, each of no use alone.

    A browser sends a cookie to every port of this computer, but shows no page of another port what this one
    stored; a script can read what is stored, but not the cookie.
    """

    cookie_name: str
    cookie: str
    page: str


def session(token: str, port: int) -> Session:
    """The session of this server: it ends with the token."""

    def half(name: str) -> str:
        return hmac.new(token.encode(), name.encode(), hashlib.sha256).hexdigest()

    return Session(f"needle-rig-{port}", half("cookie"), half("page"))


class Guard:
    """Lets into `app` what comes from the page at `port`, to its API what has `token` or its session."""

    def __init__(self, app: ASGIApp, port: int, token: str) -> None:
        self._app = app
        self._token = token.encode()
        self._session = session(token, port)
        self._hosts = frozenset({f"{LOOPBACK}:{port}", f"localhost:{port}"})
        self._origins = frozenset(f"http://{host}" for host in self._hosts)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        refusal = self.refusal(scope["path"], Headers(scope=scope))
        if refusal is None and scope["path"].startswith(API):
            scope["state"][LET_IN]()
            scope["state"][SESSION] = self._session
        if scope["type"] == "websocket":
            if refusal is not None:
                await WebSocketClose(code=1008, reason=refusal.sentence[:120])(scope, receive, send)
                return
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        if refusal is None:
            await self._app(scope, receive, with_headers)
            return
        answer = JSONResponse(
            {"error": refusal.sentence, "exit_code": BadInput.exit_code},
            refusal.status,
            {"connection": "close"},
        )
        await answer(scope, receive, with_headers)

    def refusal(self, path: str, headers: Headers) -> Refusal | None:
        """Why a request for `path` with these headers is not let in; None when it is."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return Refusal(421, "this server answers at its loopback address alone; open the printed address")
        origin = headers.get("origin")
        if origin is not None and origin not in self._origins:
            return Refusal(403, "another site asked for this; open the printed address")
        if path.startswith(API) and not self._has_token(headers):
            return Refusal(401, "the token is missing or wrong; open the address that needle-rig web printed")
        return None

    def _has_token(self, headers: Headers) -> bool:
        given = [text for name, text in headers.items() if name == "authorization"]
        tokens = [text.removeprefix("Bearer ") for text in given if text.startswith("Bearer ")]
        tokens += _offered(headers, WEBSOCKET_TOKEN)
        if tokens or given:
            return len(tokens) == 1 and hmac.compare_digest(tokens[0].encode(), self._token)
        return self._in_session(headers)

    def _in_session(self, headers: Headers) -> bool:
        """Both halves, from the page itself: another port of this computer counts as the same site."""
        cookies = SimpleCookie()
        with contextlib.suppress(CookieError):
            cookies.load("; ".join(headers.getlist("cookie")))
        cookie = cookies.get(self._session.cookie_name)
        pages = [*headers.getlist(PAGE_HEADER), *_offered(headers, WEBSOCKET_PAGE)]
        if cookie is None or len(pages) != 1 or headers.get("sec-fetch-site", "same-origin") != "same-origin":
            return False
        both = hmac.compare_digest(cookie.value.encode(), self._session.cookie.encode())
        return both & hmac.compare_digest(pages[0].encode(), self._session.page.encode())


def _offered(headers: Headers, prefix: str) -> list[str]:
    """What the subprotocols of a WebSocket carry behind this prefix."""
    names = [name.strip() for text in headers.getlist("sec-websocket-protocol") for name in text.split(",")]
    return [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
