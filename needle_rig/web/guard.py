"""Who may ask the page's server: a browser, from the page itself, with the token or with that of watchers.

A loopback address alone keeps nobody out who runs a page in the same browser: a foreign page may post to it
or open a WebSocket (its Origin tells), and a foreign name may be pointed at it (DNS rebinding; its Host
tells).
"""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import re
from collections.abc import Iterable
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
"""With every answer; one that may be kept says so itself."""


READING = frozenset({"GET", "HEAD"})
READ_BY_POST = frozenset({"/api/session", "/api/estimate", "/api/lesson", "/api/jobs"})
"""Paths whose questions stand in a body and change nothing; of jobs watchers begin `WATCHED_JOBS` alone."""
WATCHED_JOBS = frozenset({"show"})
"""Kinds of work that only read what is there."""
WATCHES = "this address may watch and order nothing; open the other address that needle-rig web printed"
_HOST = re.compile(r"[a-z0-9]([a-z0-9.-]{0,251}[a-z0-9])?(:[0-9]{1,5})?")


def checked_host(text: str) -> str:
    """A further name that browsers call this server by, as their Host header has it. Raises BadInput."""
    if not _HOST.fullmatch(text.lower()):
        raise BadInput(f"--allow-host {text[:80]}: give a name and its port, such as rig.example.org:8443")
    return text.lower()


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
    watches: bool = False
    """Whether it may see everything and order nothing."""


@dataclass(frozen=True)
class Keys:
    """The token that may order, and that of watchers; empty for none."""

    token: str
    watchers: str = ""


def session(token: str, port: int, watches: bool = False) -> Session:
    """The session of this server: it ends with the token."""

    def half(name: str) -> str:
        return hmac.new(token.encode(), name.encode(), hashlib.sha256).hexdigest()

    name = f"needle-rig-watch-{port}" if watches else f"needle-rig-{port}"
    return Session(name, half("cookie"), half("page"), watches)


def over_tls(headers: Headers) -> bool:
    """Whether the browser that asks speaks TLS, to a proxy before this server.

    It says so itself, with the Origin of every POST, which the guard lets in from names that were allowed
    alone. A header of the proxy's is not needed, so none is trusted.
    """
    return headers.get("origin", "").startswith("https://")


class Guard:
    """Lets into `app` what comes from the page at `port`, to its API what has a token or its session."""

    def __init__(self, app: ASGIApp, port: int, keys: Keys, hosts: Iterable[str] = ()) -> None:
        """`hosts` are further names of this server, for a tunnel or a proxy before it."""
        self._app = app
        self._sessions = {keys.token: session(keys.token, port)}
        if keys.watchers:
            self._sessions[keys.watchers] = session(keys.watchers, port, watches=True)
        own, further = (f"{LOOPBACK}:{port}", f"localhost:{port}"), tuple(map(checked_host, hosts))
        self._hosts = frozenset({*own, *further})
        # a proxy may speak TLS to the browser
        self._origins = frozenset(
            {*(f"http://{host}" for host in (*own, *further)), *(f"https://{host}" for host in further)}
        )

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """See ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        found = self._session_of(headers) if scope["path"].startswith(API) else None
        refusal = self.refusal(scope["path"], headers, found, scope.get("method", "GET"))
        if refusal is None and found is not None:
            scope["state"][LET_IN]()
            scope["state"][SESSION] = found
        if scope["type"] == "websocket":
            if refusal is not None:
                await WebSocketClose(code=1008, reason=refusal.sentence[:120])(scope, receive, send)
                return
            await self._app(scope, receive, send)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                given = MutableHeaders(scope=message)
                kept = given.get("cache-control")
                given.update(HEADERS if kept is None else {**HEADERS, "cache-control": kept})
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

    def refusal(self, path: str, headers: Headers, found: Session | None, method: str) -> Refusal | None:
        """Why a request for `path` with these headers, of this session, is not let in; None when it is."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return Refusal(
                421, "this server has another name; open the printed address, or allow this one: --allow-host"
            )
        origin = headers.get("origin")
        if origin is not None and origin not in self._origins:
            return Refusal(403, "another site asked for this; open the printed address")
        if path.startswith(API) and found is None:
            return Refusal(401, "the token is missing or wrong; open the address that needle-rig web printed")
        reads = method in READING or (method == "POST" and path in READ_BY_POST)
        return Refusal(403, WATCHES) if found is not None and found.watches and not reads else None

    def _session_of(self, headers: Headers) -> Session | None:
        """The session whose token, or whose halves, these headers show."""
        given = [text for name, text in headers.items() if name == "authorization"]
        tokens = [text.removeprefix("Bearer ") for text in given if text.startswith("Bearer ")]
        tokens += _offered(headers, WEBSOCKET_TOKEN)
        if tokens or given:
            given_one = tokens[0].encode() if len(tokens) == 1 else b""
            known = self._sessions.items()
            matching = [one for token, one in known if hmac.compare_digest(given_one, token.encode())]
            return matching[0] if matching else None
        return next((one for one in self._sessions.values() if _in_session(one, headers)), None)


def _in_session(known: Session, headers: Headers) -> bool:
    """Both halves, from the page itself: another port of this computer counts as the same site."""
    cookies = SimpleCookie()
    with contextlib.suppress(CookieError):
        cookies.load("; ".join(headers.getlist("cookie")))
    cookie = cookies.get(known.cookie_name)
    pages = [*headers.getlist(PAGE_HEADER), *_offered(headers, WEBSOCKET_PAGE)]
    if cookie is None or len(pages) != 1 or headers.get("sec-fetch-site", "same-origin") != "same-origin":
        return False
    both = hmac.compare_digest(cookie.value.encode(), known.cookie.encode())
    return both & hmac.compare_digest(pages[0].encode(), known.page.encode())


def _offered(headers: Headers, prefix: str) -> list[str]:
    """What the subprotocols of a WebSocket carry behind this prefix."""
    names = [name.strip() for text in headers.getlist("sec-websocket-protocol") for name in text.split(",")]
    return [name.removeprefix(prefix) for name in names if name.startswith(prefix)]
