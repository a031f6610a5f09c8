"""Watchers see everything and order nothing; further names of the server are those that were allowed."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from starlette.routing import Route
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from needle_rig.errors import BadInput
from needle_rig.web.guard import READ_BY_POST, READING, WATCHES, Guard, Keys, checked_host
from needle_rig.web.server import Page, Settings, application
from needle_rig.web.store import opened
from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.served import Served

PROXY = "rig.example.org"


@pytest.fixture(scope="module")
def watched(shell: Shell) -> Iterator[Served]:
    runs = str(shell.folder / "watched")
    yield from started(
        shell, "--dir", runs, "--watchers", "--allow-host", PROXY, "--allow-host", "tunnel:9000"
    )


def as_watcher(served: Served) -> dict[str, str]:
    return {"authorization": f"Bearer {served.watching.split('token=')[1]}"}


@pytest.fixture(scope="module")
def guarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Guard]:
    folder = tmp_path_factory.mktemp("guarded")
    with opened(folder / "runs", folder / "otherwise") as (store, _):
        page = Page(Settings(None, (), folder / "runs", (), 1), folder, store)
        yield application(page, 80, Keys("all", "watch"))


def routes(guard: Guard) -> list[tuple[str, str]]:
    """Method and path of everything below /api/."""
    app: Any = guard._app
    found = [r for r in app.routes if isinstance(r, Route) and r.path.startswith("/api/")]
    return sorted((method, route.path) for route in found for method in route.methods or ())


def test_each_route_that_writes_refuses_a_watcher(guarded: Guard, watched: Served) -> None:
    writing = [(m, p) for m, p in routes(guarded) if m not in READING and p not in READ_BY_POST]
    assert len(writing) >= 8
    for method, path in writing:
        asked = path.replace("{order}", "stop").replace("{path:path}", "a.csv").replace("{key}", "k")
        asked = asked.replace("{name}", "n")
        answer = watched.ask(method, asked, as_watcher(watched), content=b"{}")
        assert (answer.status_code, answer.json()["error"]) == (403, WATCHES), (method, path)


def test_what_a_post_reads_is_named_and_is_there(guarded: Guard) -> None:
    assert {("POST", path) for path in READ_BY_POST} <= set(routes(guarded))


@pytest.mark.parametrize("order", ["stop", "jog", "compensate", "home", "hold", "release", "clear"])
def test_a_watcher_orders_nothing_of_the_rig(watched: Served, order: str) -> None:
    answer = watched.ask("POST", f"/api/rig/{order}", as_watcher(watched), json={})
    assert (answer.status_code, answer.json()["error"]) == (403, WATCHES)


@pytest.mark.parametrize(
    "kind", ["compare", "diagnose", "adopt", "learn", "import", "open", "example", "watch", "export", "undo"]
)
def test_a_watcher_begins_no_work(watched: Served, kind: str) -> None:
    asked = {"kind": kind, "data": ["shipped:reed2008"]}
    answer = watched.ask("POST", "/api/jobs", as_watcher(watched), json=asked)
    assert answer.status_code == 403
    assert WATCHES in answer.json()["error"]
    assert watched.ask("GET", "/api/jobs", as_watcher(watched)).json()["jobs"] == []


def test_a_watcher_sees_everything(watched: Served) -> None:
    given = as_watcher(watched)
    for path in ("about", "jobs", "runs", "watch", "results?data=shipped:reed2008"):
        assert watched.ask("GET", f"/api/{path}", given).status_code == 200, path
    # its refusals are those of what is not there, and not those of a watcher
    shown = watched.ask("POST", "/api/jobs", given, json={"kind": "show", "data": ["run:nothing"]})
    assert "no such run" in shown.json()["error"]


def test_a_watchers_session_watches_and_stays_a_watchers(watched: Served) -> None:
    opened_ = watched.ask("POST", "/api/session", as_watcher(watched))
    assert opened_.json()["watches"] is True
    both = {
        "cookie": opened_.headers["set-cookie"].split("; ")[0],
        "x-needle-rig-page": opened_.json()["page"],
    }
    assert watched.ask("GET", "/api/session", both).json() == {"watches": True}
    assert watched.ask("POST", "/api/rig/jog", both, json={"by_deg": 1.0}).status_code == 403
    own = watched.ask("POST", "/api/session")
    assert own.json()["watches"] is False
    mixed = {**both, "cookie": own.headers["set-cookie"].split("; ")[0]}
    assert watched.ask("GET", "/api/session", mixed).status_code == 401


def test_a_stop_of_a_watcher_on_the_websocket_reaches_no_rig(watched: Served) -> None:
    token = watched.watching.split("token=")[1]
    with connect(
        f"ws://127.0.0.1:{watched.port}/api/live", subprotocols=[Subprotocol(f"token.{token}")]
    ) as stream:
        stream.send(json.dumps({"key": 7, "reason": "a watcher"}))
        while (told := json.loads(stream.recv(timeout=10)))["type"] != "stop":
            pass
    assert told == {"type": "stop", "key": 7, "error": WATCHES}


@pytest.mark.parametrize("host", [PROXY, "tunnel:9000", PROXY.upper()])
def test_a_name_that_was_allowed_is_answered(watched: Served, host: str) -> None:
    headers = watched.authorised | {"host": host}
    for scheme in ("http", "https"):
        own = headers | {"origin": f"{scheme}://{host.lower()}"}
        assert watched.ask("GET", "/api/session", own).status_code == 200
    assert watched.ask("GET", "/api/session", headers | {"origin": "https://evil.example"}).status_code == 403


@pytest.mark.parametrize(
    ("host", "origin", "secure"),
    [
        (PROXY, f"https://{PROXY}", True),
        (PROXY, f"http://{PROXY}", False),
        ("tunnel:9000", "http://tunnel:9000", False),
        (PROXY, None, False),
    ],
)
def test_the_cookie_is_for_tls_alone_where_the_browser_came_by_it(
    watched: Served, host: str, origin: str | None, secure: bool
) -> None:
    # what anybody may write into a header of a proxy counts for nothing
    headers = watched.authorised | {"host": host, "x-forwarded-proto": "http" if secure else "https"}
    answer = watched.ask("POST", "/api/session", headers | ({} if origin is None else {"origin": origin}))
    assert answer.status_code == 200
    flags = answer.headers["set-cookie"].lower().split("; ")
    assert ("secure" in flags, "httponly" in flags) == (secure, True)


@pytest.mark.parametrize("host", ["tunnel", "tunnel:9001", "rig.example.org.", "evil.example"])
def test_another_name_is_refused_as_before(watched: Served, host: str) -> None:
    assert watched.ask("GET", "/api/session", watched.authorised | {"host": host}).status_code == 421


@pytest.mark.parametrize(
    "host", ["", "*", "http://rig", "rig/", "rig:http", "rig example", "-rig", "a" * 300]
)
def test_what_is_no_name_of_a_host_is_a_sentence(host: str) -> None:
    with pytest.raises(BadInput, match="--allow-host"):
        checked_host(host)


def test_the_address_of_watchers_is_printed_only_where_it_was_asked_for(
    watched: Served, served: Served
) -> None:
    assert watched.watching.startswith(watched.base)
    assert watched.watching != watched.address
    assert served.watching == ""
    assert Path(watched.shell.folder).is_dir()
