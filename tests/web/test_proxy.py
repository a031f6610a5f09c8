"""The reverse proxy of docs/how-to/remote.md before the page: what is written there is what runs here."""

from __future__ import annotations

import json
import re
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import httpx
import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from needle_rig.web.uploads import FILE_BYTES
from tests.closed_loop.shell import ROOT, Shell
from tests.web.conftest import started
from tests.web.looking import CHROMIUM
from tests.web.served import Served

NGINX = shutil.which("nginx") or shutil.which("nginx", path="/usr/sbin")
NAME = "rig.example.org"
pytestmark = [
    pytest.mark.skipif(NGINX is None, reason="no nginx here: apt-get install nginx-light"),
    pytest.mark.skipif(shutil.which("openssl") is None, reason="no openssl here: apt-get install openssl"),
    pytest.mark.whole,
]

Proxied = tuple[Served, int]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


def configured(folder: Path, port: int, served: int) -> Path:
    """The server of the documentation with the ports and the certificate of this test."""
    text = (ROOT / "docs" / "how-to" / "remote.md").read_text()
    found = re.search(r"```nginx\n(.*?)```", text, re.DOTALL)
    assert found is not None
    server = found[1]
    for documented, own in (
        ("443 ssl", f"127.0.0.1:{port} ssl"),
        ("/etc/ssl/", f"{folder}/"),
        ("127.0.0.1:8800", f"127.0.0.1:{served}"),
    ):
        assert documented in server
        server = server.replace(documented, own)
    path = folder / "nginx.conf"
    kinds = ("client_body", "proxy", "fastcgi", "uwsgi", "scgi")
    places = " ".join(f"{kind}_temp_path {folder}/{kind};" for kind in kinds)
    path.write_text(
        f"daemon off; pid {folder}/pid; error_log {folder}/errors; events {{}}\n"
        f"http {{ access_log off; {places}\n{server}}}\n"
    )
    return path


@pytest.fixture(scope="module")
def proxied(shell: Shell, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxied]:
    """The page's server and the port of the proxy before it."""
    assert NGINX is not None
    port, folder = free_port(), tmp_path_factory.mktemp("nginx")
    certificate = ["-x509", "-newkey", "rsa:2048", "-nodes", "-subj", f"/CN={NAME}"]
    files = ["-keyout", str(folder / "rig.key"), "-out", str(folder / "rig.pem")]
    subprocess.run(["openssl", "req", *certificate, *files], check=True, capture_output=True)
    for served in started(
        shell, "--dir", str(shell.folder / "proxied"), "--watchers", "--allow-host", f"{NAME}:{port}"
    ):
        command = [NGINX, "-p", str(folder), "-c", str(configured(folder, port, served.port))]
        with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
            try:
                listens(process, port)
                yield served, port
            finally:
                process.terminate()
                process.wait(timeout=10)


def listens(process: subprocess.Popen[str], port: int) -> None:
    """Wait until it does."""
    deadline_s = time.monotonic() + 20
    while True:
        try:
            socket.create_connection(("127.0.0.1", port)).close()
        except OSError:
            assert process.poll() is None, process.communicate()[1]
            assert time.monotonic() < deadline_s, "nginx does not listen"
            time.sleep(0.05)
        else:
            return


@pytest.fixture
def ask(proxied: Proxied) -> Callable[..., httpx.Response]:
    served, port = proxied

    def asked(
        method: str, path: str, host: str = NAME, token: str = served.token, **more: object
    ) -> httpx.Response:
        headers = {"host": f"{host}:{port}", "authorization": f"Bearer {token}"}
        headers["origin"] = f"https://{host}:{port}"
        with httpx.Client(verify=False, timeout=60.0) as client:
            return client.request(method, f"https://127.0.0.1:{port}{path}", headers=headers, **more)  # type: ignore[arg-type]

    return asked


def test_the_page_and_its_session_come_through(ask: Callable[..., httpx.Response]) -> None:
    assert "<title>" in ask("GET", "/").text
    opened = ask("POST", "/api/session")
    assert opened.json()["watches"] is False
    flags = opened.headers["set-cookie"].lower().split("; ")
    assert {"httponly", "secure", "samesite=strict"} <= set(flags)


def test_another_name_is_refused_with_one_sentence(ask: Callable[..., httpx.Response]) -> None:
    answer = ask("GET", "/", host="evil.example")
    assert answer.status_code == 421
    assert answer.json()["error"].endswith("or allow this one: --allow-host")


def test_a_watcher_stops_nothing(ask: Callable[..., httpx.Response], proxied: Proxied) -> None:
    token = proxied[0].watching.split("token=")[1]
    assert ask("GET", "/api/about", token=token).status_code == 200
    assert ask("POST", "/api/rig/stop", token=token, json={}).status_code == 403


def test_a_large_file_is_taken_and_one_too_large_told_in_the_servers_sentence(
    ask: Callable[..., httpx.Response],
) -> None:
    key = ask("POST", "/api/uploads", json={"name": "large"}).json()["upload"]
    line = b"0.000000000,1.000000000,2.000000\n"
    assert (
        ask("PUT", f"/api/uploads/{key}/a.csv", content=line * (FILE_BYTES // len(line))).status_code == 201
    )
    refused = ask("PUT", f"/api/uploads/{key}/b.csv", content=line * (FILE_BYTES // len(line) + 1))
    assert (refused.status_code, "thin it out" in refused.json()["error"]) == (413, True)


def test_what_the_rig_does_and_a_stop_go_over_the_websocket(proxied: Proxied) -> None:
    served, port = proxied
    trusting = ssl.create_default_context()
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    with connect(
        f"wss://{NAME}:{port}/api/live",
        sock=socket.create_connection(("127.0.0.1", port)),
        ssl=trusting,
        subprotocols=[Subprotocol(f"token.{served.token}")],
    ) as stream:
        stream.send(json.dumps({"key": 7, "reason": "a test"}))
        while (told := json.loads(stream.recv(timeout=10)))["type"] != "stop":
            pass
    assert told["key"] == 7
    assert "daemon" in told["error"]  # none runs here


@pytest.mark.browser
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium")
def test_a_browser_keeps_the_cookie_for_tls_and_a_second_tab_is_let_in_by_it(proxied: Proxied) -> None:
    playwright = pytest.importorskip("playwright.sync_api")
    served, port = proxied
    base = f"https://{NAME}:{port}"
    with playwright.sync_playwright() as started_:
        arguments = ["--no-sandbox", f"--host-resolver-rules=MAP {NAME} 127.0.0.1"]
        browser = started_.chromium.launch(executable_path=CHROMIUM, args=arguments)
        context = browser.new_context(ignore_https_errors=True)
        page = context.new_page()
        page.goto(f"{base}/#token={served.token}")
        page.get_by_role("heading", name="No rig").wait_for()
        page.wait_for_function("localStorage.getItem('needle-rig-page')")
        (cookie,) = context.cookies(base)
        assert (cookie["secure"], cookie["httpOnly"], cookie["sameSite"]) == (True, True, "Strict")
        assert context.cookies(f"http://{NAME}:{port}") == []
        second = context.new_page()
        second.goto(f"{base}/#/runs")
        second.get_by_text("Nothing is recorded yet").wait_for()
        browser.close()
