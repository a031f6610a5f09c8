"""Who is let in: this computer's browser, from the page itself, with the token."""

import ast
import http.client
import socket
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from needle_rig.web import guard
from needle_rig.web.static_files import place
from tests.web.served import Served

COMMANDS = [
    ("POST", "/api/rig/stop"),
    ("POST", "/api/rig/jog"),
    ("POST", "/api/jobs"),
    ("DELETE", "/api/jobs/x"),
    ("POST", "/api/uploads"),
    ("PUT", "/api/uploads/x/a.csv"),
    ("PUT", "/api/runs/x/notes"),
    ("GET", "/api/runs"),
    ("GET", "/api/about"),
    ("POST", "/api/lesson"),
]


WRONG = [None, "Bearer", "Bearer wrong", "Bearer {}x", "{}", "Basic {}"]


@pytest.mark.parametrize(("method", "path"), COMMANDS)
def test_nothing_of_the_api_is_told_without_the_token(served: Served, method: str, path: str) -> None:
    for token in WRONG:
        headers = {} if token is None else {"authorization": token.format(served.token)}
        assert served.ask(method, path, headers, content=b"{}").status_code == 401, token


@pytest.mark.parametrize("host", ["evil.example", "evil.example:{}", "127.0.0.1", "127.0.0.1:1", "[::1]:{}"])
def test_a_name_that_was_pointed_at_this_computer_is_refused(served: Served, host: str) -> None:
    headers = served.authorised | {"host": host.format(served.port)}
    assert served.ask("GET", "/", headers).status_code == 421
    assert served.ask("POST", "/api/rig/stop", headers, content=b"{}").status_code == 421


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:{}", "http://127.0.0.1:81"]
)
def test_a_post_from_another_site_is_refused(served: Served, origin: str) -> None:
    headers = served.authorised | {"origin": origin.format(served.port)}
    assert served.ask("POST", "/api/rig/stop", headers, content=b"{}").status_code == 403


def greeting(served: Served, host: str, origin: str, token: str) -> str:
    """The first words of the WebSocket, or why there are none."""
    own = socket.create_connection(("127.0.0.1", served.port))
    try:
        with connect(
            f"ws://{host.format(served.port)}/api/live",
            sock=own,
            origin=Origin(origin.format(served.port)),
            subprotocols=[Subprotocol(f"token.{token.format(served.token)}")],
        ) as stream:
            return str(stream.recv(timeout=10))
    except (InvalidHandshake, ConnectionClosed) as refused:
        return f"refused: {refused}"


OWN = ("127.0.0.1:{}", "http://127.0.0.1:{}", "{}")


@pytest.mark.parametrize(
    ("host", "origin", "token"),
    [
        (OWN[0], "http://evil.example", OWN[2]),
        ("evil.example:{}", OWN[1], OWN[2]),
        (OWN[0], OWN[1], "wrong"),
        (OWN[0], OWN[1], "{}x"),
    ],
)
def test_a_websocket_from_elsewhere_or_without_the_token_is_refused(
    served: Served, host: str, origin: str, token: str
) -> None:
    assert "no daemon answers" in greeting(served, *OWN)
    assert greeting(served, host, origin, token).startswith("refused")


def test_the_token_is_compared_in_constant_time() -> None:
    tree = ast.parse(Path(guard.__file__).read_text(encoding="utf-8"))
    compared = [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare)
        and any("_token" in ast.dump(part) for part in (node.left, *node.comparators))
    ]
    assert not compared
    assert "hmac.compare_digest" in [ast.unparse(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)]


@pytest.mark.parametrize("path", ["/", f"{place()}/app.js", "/glossary.html", "/api/about", "/nothing"])
def test_every_answer_forbids_inline_script_and_other_hosts(served: Served, path: str) -> None:
    policy = served.ask("GET", path, {}).headers["content-security-policy"]
    parts = dict(part.split(" ", 1) for part in policy.split("; "))
    assert parts["default-src"] == "'none'"
    assert parts["script-src"] == "'self'"
    assert parts["connect-src"] == "'self'"
    assert "unsafe" not in policy
    assert "http" not in policy


def test_no_page_has_inline_script_or_loads_from_elsewhere() -> None:
    static = Path(guard.__file__).parent / "static"
    page = (static / "index.html").read_text(encoding="utf-8")
    assert page.count("<script") == page.count('<script type="module" src="')
    for path in (path for path in static.iterdir() if path.is_file()):
        text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
        for word in ("http:", "https:", "innerHTML", "eval("):
            assert word not in text, path.name


def test_it_listens_at_the_loopback_address_alone(served: Served) -> None:
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    local = {
        row[1].split(":")[0]
        for row in rows
        if row[3] == "0A" and int(row[1].split(":")[1], 16) == served.port
    }
    assert local == {"0100007F"}


@pytest.mark.parametrize(
    "path",
    [
        *("/../guard.py", "/%2e%2e/guard.py", "/..%2fguard.py"),
        *(
            f"{place()}/{up}"
            for up in ("../guard.py", "%2e%2e/guard.py", "..%2fguard.py", "vendor/../../guard.py")
        ),
    ],
)
def test_no_file_outside_the_static_folder_is_served(served: Served, path: str) -> None:
    raw = http.client.HTTPConnection("127.0.0.1", served.port, timeout=10)
    raw.request("GET", path)
    answer = raw.getresponse()
    assert answer.status == 404
    assert b"Guard" not in answer.read()
    raw.close()


def test_a_stop_for_no_daemon_is_refused_in_a_sentence(served: Served) -> None:
    answer = served.ask("POST", "/api/rig/stop", json={})
    assert answer.status_code == 503
    assert "needle-rig daemon" in answer.json()["error"]


BAD: list[tuple[str, Any, str]] = [
    ("/api/jobs", {"kind": "rm"}, "no computation"),
    ("/api/jobs", {"kind": "compare", "data": []}, "no data was chosen"),
    ("/api/jobs", {"kind": "compare", "data": ["/etc/passwd"]}, "no such data"),
    ("/api/jobs", {"kind": "compare", "data": ["run:../../etc/passwd"]}, "no such run"),
    ("/api/jobs", {"kind": "compare", "data": "shipped:reed2008"}, "no data was chosen"),
    ("/api/jobs", {"kind": "diagnose", "data": ["shipped:reed2008"], "model": "../x"}, "not there any more"),
    ("/api/jobs", {"kind": "undo"}, "no step"),
    ("/api/jobs", {"kind": "strategies", "targets_deg": "45", "seeds": 1}, "targets"),
    ("/api/jobs", [1], "no JSON object"),
    ("/api/lesson", {"effect": "tip_friction", "values": {"torque_nmm": "1"}}, "number"),
    ("/api/rig/jog", {"by_deg": "x"}, "by_deg"),
    ("/api/rig/jog", {"by_deg": 5, "to_deg": 5}, "either"),
]


@pytest.mark.parametrize(("path", "content", "said"), BAD)
def test_what_cannot_be_done_is_refused_in_a_sentence(
    served: Served, path: str, content: Any, said: str
) -> None:
    answer = served.ask("POST", path, json=content)
    assert 400 <= answer.status_code < 500
    assert said in answer.json()["error"]


def test_a_long_command_is_refused_before_it_is_read_whole(served: Served) -> None:
    answer = served.ask("POST", "/api/rig/jog", content=b"x" * (65 << 10))
    assert answer.status_code == 413
    answer = served.ask("POST", "/api/jobs", content=b"x" * (513 << 10))
    assert answer.status_code == 413


@pytest.fixture(scope="module")
def halves(served: Served) -> tuple[str, str]:
    """Cookie and page half of a session that was opened with the token."""
    answer = served.ask("POST", "/api/session")
    cookie, *flags = answer.headers["set-cookie"].split("; ")
    assert {flag.lower() for flag in flags} >= {"httponly", "samesite=strict"}
    assert served.token not in answer.headers["set-cookie"] + answer.text
    return cookie, answer.json()["page"]


def test_both_halves_of_a_session_let_a_new_tab_in_and_each_alone_lets_nobody_in(
    served: Served, halves: tuple[str, str]
) -> None:
    cookie, page = halves
    both = {"cookie": cookie, "x-needle-rig-page": page}
    assert served.ask("GET", "/api/session", both).status_code == 200
    alone = [{"cookie": cookie}, {"x-needle-rig-page": page}]
    wrong = [
        both | {"cookie": cookie + "x"},
        both | {"x-needle-rig-page": page + "x"},
        both | {"cookie": "a=b"},
    ]
    for headers in (*alone, *wrong, both | {"authorization": "Bearer wrong"}):
        assert served.ask("GET", "/api/session", headers).status_code == 401, headers


@pytest.mark.parametrize("site", ["same-site", "cross-site", "none"])
def test_a_page_of_another_port_of_this_computer_has_no_session(
    served: Served, halves: tuple[str, str], site: str
) -> None:
    cookie, page = halves
    headers = {"cookie": cookie, "x-needle-rig-page": page, "sec-fetch-site": site}
    assert served.ask("GET", "/api/runs", headers).status_code == 401
    own = {**headers, "sec-fetch-site": "same-origin"}
    assert served.ask("GET", "/api/runs", own).status_code == 200
    other = {**own, "origin": f"http://127.0.0.1:{served.port + 1}"}
    assert served.ask("POST", "/api/rig/stop", other, content=b"{}").status_code == 403


def test_a_session_is_opened_by_the_token_and_by_nothing_else(served: Served) -> None:
    assert served.ask("POST", "/api/session", {}).status_code == 401


def test_a_websocket_is_let_in_by_both_halves_alone(served: Served, halves: tuple[str, str]) -> None:
    cookie, page = halves

    def greeted(cookies: str, name: str) -> bool:
        own = socket.create_connection(("127.0.0.1", served.port))
        try:
            with connect(
                f"ws://127.0.0.1:{served.port}/api/live",
                sock=own,
                origin=Origin(f"http://127.0.0.1:{served.port}"),
                subprotocols=[Subprotocol(name)],
                additional_headers={"cookie": cookies},
            ) as stream:
                return "no daemon answers" in str(stream.recv(timeout=10))
        except (InvalidHandshake, ConnectionClosed):
            return False

    assert greeted(cookie, f"page.{page}")
    assert not greeted("a=b", f"page.{page}")
    assert not greeted(cookie, "page.wrong")


@pytest.mark.parametrize(
    ("path", "content"),
    [
        ("/api/estimate", b"[["),
        ("/api/jobs", b'{"kind": "strategies", "targets_deg": [true], "seeds": true, "parameters": ["x"]}'),
        ("/api/jobs", b'{"kind": "strategies", "targets_deg": [45], "seeds": 1, "parameters": ["x"]}'),
        (
            "/api/jobs",
            b'{"kind": "strategies", "targets_deg": [Infinity], "seeds": 1, "parameters": "rig_soft"}',
        ),
        (
            "/api/jobs",
            b'{"kind": "strategies", "targets_deg": [45], "seeds": 1000000000, "parameters": "rig_soft"}',
        ),
        ("/api/lesson", b'{"effect": "tip_friction", "values": {"torque_nmm": 1' + b"0" * 400 + b"}}"),
        ("/api/jobs", b"[" * 60000),
    ],
)
def test_what_is_malformed_is_a_sentence_and_no_defect(served: Served, path: str, content: bytes) -> None:
    answer = served.ask("POST", path, content=content)
    assert answer.status_code == 422
    assert answer.json()["exit_code"] == 2


def test_a_websocket_with_a_header_and_no_subprotocol_is_let_in(served: Served) -> None:
    with connect(f"ws://127.0.0.1:{served.port}/api/live", additional_headers=served.authorised) as stream:
        assert "no daemon answers" in str(stream.recv(timeout=10))
