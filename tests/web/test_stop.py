"""Stop from the page: no crowd without a token keeps it off, and its confirmation is the daemon's."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.frames import Frame, Opcode
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.closed_loop.shell import Shell
from tests.web.conftest import started
from tests.web.crowds import CROWDS, HEAD, Crowd, connected
from tests.web.looking import IN_BROWSER, Open, pictured
from tests.web.served import Served

STOP_S = 1.0


@pytest.fixture(scope="module")
def rig_server(shell: Shell) -> Iterator[Served]:
    """With a simulated rig in virtual time."""
    yield from started(shell, "--rig", "simulated", "--fast", "--dir", str(shell.folder / "stop_runs"))


@contextmanager
def watching(served: Served) -> Iterator[ClientConnection]:
    with connect(
        f"ws://127.0.0.1:{served.port}/api/live", subprotocols=[Subprotocol(f"token.{served.token}")]
    ) as stream:
        until(stream, "state")
        yield stream


def until(stream: ClientConnection, kind: str, within_s: float = 30.0) -> dict[str, Any]:
    """The next document of this kind."""
    deadline_s = time.monotonic() + within_s
    while True:
        document: dict[str, Any] = json.loads(stream.recv(timeout=deadline_s - time.monotonic()))
        if document["type"] == kind:
            return document


def stop_on(stream: ClientConnection, key: int = 1, within_s: float = STOP_S) -> dict[str, Any]:
    stream.send(json.dumps({"key": key, "reason": "stopped by a test"}))
    return until(stream, "stop", within_s)


def daemon_of(served: Served) -> int:
    (pid,) = (pid for pid, line in served.shell.processes().items() if "--private" in line)
    return pid


@contextmanager
def hanging(pid: int) -> Iterator[None]:
    os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGCONT)


@pytest.mark.real_time
@pytest.mark.parametrize("crowd", CROWDS, ids=lambda crowd: crowd.__name__)
def test_a_crowd_without_a_token_keeps_no_stop_off(rig_server: Served, crowd: Crowd) -> None:
    with watching(rig_server) as stream, crowd(rig_server):
        begun_s = time.monotonic()
        answer = rig_server.ask("POST", "/api/rig/stop", json={})
        assert (answer.status_code, time.monotonic() - begun_s < STOP_S) == (202, True)
        assert stop_on(stream) == {"type": "stop", "key": 1}
        with watching(rig_server) as newcomer:
            assert stop_on(newcomer) == {"type": "stop", "key": 1}


@pytest.mark.whole
def test_a_head_that_does_not_come_is_dropped_within_some_seconds(rig_server: Served) -> None:
    with connected(rig_server, 3, HEAD) as crowd:
        for each in crowd:
            each.settimeout(8)
            assert each.recv(100) == b""


@pytest.mark.whole
def test_an_upload_may_take_longer_than_a_head(served: Served) -> None:
    key = served.ask("POST", "/api/uploads", json={"name": "slow"}).json()["upload"]
    head = (
        f"PUT /api/uploads/{key}/a.csv HTTP/1.1\r\nHost: 127.0.0.1:{served.port}\r\n"
        f"Authorization: Bearer {served.token}\r\nContent-Length: 8\r\nConnection: close\r\n\r\n"
    )
    with socket.create_connection(("127.0.0.1", served.port), 20) as slow:
        slow.sendall(head.encode())
        for part in (b"a,b\n", b"1,2\n"):
            time.sleep(3.5)
            slow.sendall(part)
        assert slow.recv(100).startswith(b"HTTP/1.1 201")


@pytest.mark.real_time
def test_a_daemon_that_hangs_confirms_nothing_and_is_told_within_a_second_or_so(rig_server: Served) -> None:
    with watching(rig_server) as stream:
        with hanging(daemon_of(rig_server)):
            begun_s = time.monotonic()
            told = stop_on(stream, 7, 3.0)
            assert time.monotonic() - begun_s < STOP_S + 0.5
            assert told["key"] == 7
            assert "emergency stop" in told["error"]
            answer = rig_server.ask("POST", "/api/rig/stop", json={})
            assert answer.status_code == 503
            assert "emergency stop" in answer.json()["error"]
        assert stop_on(stream, 8, 10.0) == {"type": "stop", "key": 8}


def test_a_stop_on_the_websocket_for_no_daemon_is_refused_in_a_sentence(served: Served) -> None:
    with connect(
        f"ws://127.0.0.1:{served.port}/api/live", subprotocols=[Subprotocol(f"token.{served.token}")]
    ) as stream:
        assert "needle-rig daemon" in stop_on(stream)["error"]


BAD: list[tuple[str | bytes, int]] = [
    ("no JSON", 1008),
    ("[" * 500, 1008),
    ("[1]", 1008),
    ('{"reason": "x"}', 1008),
    ('{"key": 1, "by_deg": 5}', 1008),
    (b"\x00", 1008),
    ("x" * 2000, 1009),
]


@pytest.mark.parametrize(("text", "code"), BAD, ids=[str(k) for k in range(len(BAD))])
def test_what_is_no_stop_closes_the_websocket(rig_server: Served, text: str | bytes, code: int) -> None:
    with watching(rig_server) as stream:
        stream.send(text)
        with pytest.raises(ConnectionClosed) as closed:
            until(stream, "stop")
        assert closed.value.rcvd is not None
        assert closed.value.rcvd.code == code
    with watching(rig_server) as another:
        assert stop_on(another, within_s=10.0) == {"type": "stop", "key": 1}


@pytest.mark.whole
def test_a_text_that_is_no_utf8_closes_the_websocket_and_leaves_no_traceback(
    shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--dir", str(tmp_path)):
        with connect(
            f"ws://127.0.0.1:{served.port}/api/live", subprotocols=[Subprotocol(f"token.{served.token}")]
        ) as stream:
            bad = Frame(Opcode.TEXT, b'{"key": 1, "reason": "\xff\xfe"}')
            stream.socket.sendall(bad.serialize(mask=True, extensions=[]))
            with pytest.raises(ConnectionClosed) as closed:
                until(stream, "stop")
            assert closed.value.rcvd is not None
            assert closed.value.rcvd.code == 1007
        assert served.ask("GET", "/").status_code == 200
        served.process.terminate()
        _, log = served.process.communicate(timeout=30)
        assert "Traceback" not in log


browser_only = [*IN_BROWSER, pytest.mark.real_time]


def in_browser(test: Any) -> Any:
    for mark in browser_only:
        test = mark(test)
    return test


@in_browser
@pytest.mark.parametrize("how", ["mouse", "Escape"])
def test_a_stop_that_the_daemon_does_not_confirm_is_said_large_within_a_second(
    visit: Open, rig_server: Served, how: str
) -> None:
    page = visit("live", served=rig_server)
    page.wait_for_selector(".live:not(.grey)")

    def press() -> None:
        if how == "mouse":
            page.get_by_role("button", name="Stop", exact=True).click()
        else:
            page.keyboard.press(how)

    with hanging(daemon_of(rig_server)):
        press()
        page.wait_for_selector(".stopped.open", timeout=1500)
        alert = page.get_by_role("alert").filter(has_text="Stop NOT confirmed: use the emergency stop")
        alert.wait_for(timeout=500)
        assert alert.locator("strong").evaluate("e => parseFloat(getComputedStyle(e).fontSize)") >= 24.0
        pictured(page, f"stop-not-confirmed-{how}")
    page.wait_for_selector(".live:not(.grey)")
    press()
    page.wait_for_selector(".stopped.confirmed")
    said = page.locator(".stopped").inner_text()
    assert re.match(r"Stop sent … confirmed after \d\.\d\d s", said)
    assert alert.count() == 0
    pictured(page, f"stop-confirmed-{how}")


@in_browser
@pytest.mark.parametrize("crowd", CROWDS, ids=lambda crowd: crowd.__name__)
def test_a_crowd_keeps_no_stop_of_the_pages_button_off(visit: Open, rig_server: Served, crowd: Crowd) -> None:
    page = visit("live", served=rig_server)
    page.wait_for_selector(".live:not(.grey)")
    with crowd(rig_server):
        page.get_by_role("button", name="Stop", exact=True).click()
        page.wait_for_selector(".stopped.confirmed", timeout=5000)
        said = re.search(r"confirmed after ([\d.]+) s", page.locator(".stopped").inner_text())
        assert said is not None
        assert float(said[1]) < STOP_S


@in_browser
@pytest.mark.parametrize("left", ["websocket", "request"])
def test_either_way_alone_brings_the_stop_and_its_confirmation(
    visit: Open, rig_server: Served, left: str
) -> None:
    page = visit("live", served=rig_server)
    page.wait_for_selector(".live:not(.grey)")
    if left == "websocket":
        page.route("**/api/rig/stop", lambda _: None)  # it hangs
    else:
        page.add_init_script("WebSocket.prototype.send = () => {}")
        page.reload()
        page.wait_for_selector(".live:not(.grey)")
    page.keyboard.press("Escape")
    page.wait_for_selector(".stopped.confirmed", timeout=1500)


@in_browser
def test_a_stop_without_the_pages_server_is_said_not_confirmed_at_once(
    visit: Open, shell: Shell, tmp_path: Path
) -> None:
    for served in started(shell, "--rig", "simulated", "--fast", "--dir", str(tmp_path)):
        page = visit("live", served=served)
        page.wait_for_selector(".live:not(.grey)")
        os.kill(served.process.pid, signal.SIGKILL)
        page.wait_for_selector(".live.grey", timeout=1500)
        page.keyboard.press("Escape")
        page.wait_for_selector(".stopped.open", timeout=500)
