"""The API's server without a daemon behind it: what passes, what waits, what is refused, who is dropped."""

import asyncio
import json
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from websockets.frames import Frame, Opcode

from needle_rig.service.api import api, connections
from needle_rig.service.api.api import Answer, application
from needle_rig.service.api.connections import Connections
from needle_rig.service.api.serving import server
from needle_rig.service.api.stream import Stream

Reply = tuple[int, dict[str, Any]]


class Service:
    """The server at `path`; `asked` is what came through, an order in `slow` is not answered until set."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stream = Stream()
        self.asked: list[str] = []
        self.slow: dict[str, asyncio.Event] = {}
        self.clients: list[Client] = []

    async def ask(self, order: str, content: Mapping[str, Any], begun_s: float, lease: str | None) -> Answer:
        self.asked.append(order)
        if order in self.slow:
            await self.slow[order].wait()
        return Answer(0, {"order": order, **content, "got_lease": lease, "number": len(self.asked)})

    async def connect(self) -> "Client":
        self.clients.append(Client(*await asyncio.open_unix_connection(str(self.path))))
        return self.clients[-1]

    async def post(self, path: str, content: bytes = b"", method: str = "POST", **headers: str) -> Reply:
        client = await self.connect()
        client.send(method, path, content, **headers)
        return await client.reply()


class Client:
    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    def send(self, method: str, path: str, content: bytes = b"", **headers: str) -> None:
        lines = [f"{method} {path} HTTP/1.1", "Host: d", f"Content-Length: {len(content)}"]
        lines += [f"{name}: {value}" for name, value in headers.items()]
        self.writer.write("\r\n".join(lines).encode() + b"\r\n\r\n" + content)

    async def reply(self) -> Reply:
        head = await self.reader.readuntil(b"\r\n\r\n")
        length = next(
            int(line.split()[1]) for line in head.splitlines() if line.startswith(b"content-length")
        )
        return int(head.split()[1]), json.loads(await self.reader.readexactly(length))

    async def dropped(self, within_s: float) -> bool:
        try:
            async with asyncio.timeout(within_s):
                while await self.reader.read(1 << 16):
                    pass
        except TimeoutError:
            return False
        except ConnectionError:
            pass
        return True


@asynccontextmanager
async def serving(tmp_path: Path, limit: int = 50) -> AsyncIterator[Service]:
    service = Service(tmp_path / "s")
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(service.path))
        listener.listen()
        listener.setblocking(False)
        held = Connections(listener, limit)
        running = server(application(service.ask, service.stream, held), held, lifespan="off")
        tasks = [asyncio.create_task(running.serve()), asyncio.create_task(held.sweep())]
        try:
            yield service
        finally:
            for client in service.clients:
                client.writer.transport.abort()
            await service.stream.end(0.1)
            running.should_exit = True
            await tasks[0]
            tasks[1].cancel()
            with suppress(asyncio.CancelledError):
                await tasks[1]


async def until(true: Callable[[], bool]) -> None:
    async with asyncio.timeout(10):
        while not true():
            await asyncio.sleep(0.001)


async def test_an_order_passes_with_its_lease(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        status, told = await service.post("/jog", b'{"by_deg": 5}', Lease="abc")
        assert (status, told["order"], told["by_deg"], told["got_lease"]) == (202, "jog", 5.0, "abc")
        assert (await service.post("/lease", b'{"holder": "anna"}'))[0] == 201
        assert (await service.post("/lease", method="DELETE"))[1]["order"] == "return_lease"


HEAD, BODY = b"POST /jog HTTP/1.1\r\nHost: d\r\nContent-Length: 13\r\n\r\n", b'{"by_deg": 5}'


@pytest.mark.parametrize("sent_bytes", [1, 20, len(HEAD), len(HEAD) + 5])
async def test_what_began_before_a_stop_was_acknowledged_is_refused(tmp_path: Path, sent_bytes: int) -> None:
    async with serving(tmp_path) as service:
        early, late = await service.connect(), await service.connect()
        early.writer.write((HEAD + BODY)[:sent_bytes])
        assert (await service.post("/stop"))[0] == 202
        early.writer.write((HEAD + BODY)[sent_bytes:])
        status, told = await early.reply()
        assert (status, told["exit_code"]) == (409, 4)
        late.send("POST", "/jog", b'{"by_deg": 5}')
        assert (await late.reply())[0] == 202
        # the same connection is as good as new
        early.send("POST", "/jog", b'{"by_deg": 5}')
        assert (await early.reply())[0] == 202
        assert service.asked == ["stop", "jog", "jog"]


async def test_bytes_that_nobody_read_before_the_stop_count_as_begun(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        known = await service.connect()
        known.send("GET", "/state")
        await known.reply()
        stopper = await service.connect()
        stopper.send("GET", "/state")
        await stopper.reply()
        service.slow["stop"] = asyncio.Event()
        stopper.send("POST", "/stop")
        await until(lambda: "stop" in service.asked)
        # all in one turn of the loop: the daemon answers, and before the server may read again these come
        service.slow["stop"].set()
        known.send("POST", "/jog", b'{"by_deg": 5}')
        unknown = socket.socket(socket.AF_UNIX)
        unknown.connect(str(service.path))
        unknown.send(HEAD + BODY)
        assert (await stopper.reply())[0] == 202
        assert (await known.reply())[0] == 409
        newcomer = Client(*await asyncio.open_unix_connection(sock=unknown))
        service.clients.append(newcomer)
        assert (await newcomer.reply())[0] == 409
        assert "jog" not in service.asked


async def test_orders_wait_while_a_stop_is_on_its_way_and_it_waits_for_none(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        service.slow = {"compensate": asyncio.Event(), "stop": asyncio.Event()}
        starting = asyncio.create_task(service.post("/compensate", b'{"target_deg": 5}'))
        await until(lambda: service.asked == ["compensate"])
        stopping = asyncio.create_task(service.post("/stop", b'{"reason": "now"}'))
        await until(lambda: service.asked == ["compensate", "stop"])
        during = asyncio.create_task(service.post("/hold"))
        await asyncio.sleep(0.1)
        assert service.asked == ["compensate", "stop"]
        service.slow["stop"].set()
        assert (await stopping)[0] == 202
        assert (await during)[0] == 409
        service.slow["compensate"].set()
        await starting
        assert service.asked == ["compensate", "stop"]


async def test_many_who_ask_for_the_state_cost_the_daemon_few_questions(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        replies = await asyncio.gather(*(service.post("/state", method="GET") for _ in range(40)))
        assert {status for status, _ in replies} == {200}
        assert len(service.asked) < 20
        before = len(service.asked)
        assert (await service.post("/state", method="GET"))[1]["number"] > before


async def test_more_orders_than_the_daemon_should_hear_are_refused_but_never_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api, "PATIENCE_S", 0.05)
    async with serving(tmp_path) as service:
        several = [asyncio.create_task(service.post("/clear")) for _ in range(40)]
        await until(lambda: "clear" in service.asked)
        assert (await service.post("/stop"))[0] == 202
        statuses = [(await each)[0] for each in several]
        assert 429 in statuses
        assert set(statuses) <= {202, 409, 429}


async def test_a_new_connection_always_gets_in(tmp_path: Path) -> None:
    async with serving(tmp_path, limit=5) as service:
        idle = [await service.connect() for _ in range(20)]
        assert (await service.post("/stop"))[0] == 202
        assert await idle[0].dropped(5)
        watchers = [await watch(service) for _ in range(20)]
        assert (await service.post("/stop"))[0] == 202
        assert await watchers[0].dropped(5)


async def test_who_has_asked_nothing_pushes_out_nobody_who_has(tmp_path: Path) -> None:
    async with serving(tmp_path, limit=5) as service:
        watcher = await watch(service)
        service.slow["jog"] = asyncio.Event()
        asking = asyncio.create_task(service.post("/jog", b'{"by_deg": 5}'))
        await until(lambda: "jog" in service.asked)
        for _ in range(40):
            (await service.connect()).writer.write(HEAD[:20])
        assert (await service.post("/stop"))[0] == 202
        service.slow["jog"].set()
        assert (await asking)[0] == 202
        assert not await watcher.dropped(0.2)


CROWDS = {
    "idle": b"",
    "half open": HEAD[:20],
    "endless": b"POST /jog HTTP/1.1\r\nHost: d\r\nTransfer-Encoding: chunked\r\n\r\n5\r\n{",
}


@pytest.mark.parametrize("said", CROWDS.values(), ids=CROWDS.keys())
async def test_no_crowd_keeps_a_stop_off(tmp_path: Path, said: bytes) -> None:
    async with serving(tmp_path) as service:
        for _ in range(150):
            (await service.connect()).writer.write(said)
        async with asyncio.timeout(1.0):
            assert (await service.post("/stop"))[0] == 202


@pytest.mark.parametrize("parts", [[b"\xff\xfe"], [b"\xc3", b"\xa9\xff"]], ids=["whole", "in parts"])
async def test_a_text_that_is_no_utf8_closes_a_watcher_with_1007(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, parts: list[bytes]
) -> None:
    async with serving(tmp_path) as service:
        watcher = await watch(service)
        opcodes = [Opcode.TEXT, *[Opcode.CONT] * (len(parts) - 1)]
        for k, (opcode, part) in enumerate(zip(opcodes, parts, strict=True)):
            frame = Frame(opcode, part, fin=k == len(parts) - 1)
            watcher.writer.write(frame.serialize(mask=True, extensions=[]))
        async with asyncio.timeout(5):
            told = await watcher.reader.read()
        assert told.endswith(
            Frame(Opcode.CLOSE, (1007).to_bytes(2, "big")).serialize(mask=False, extensions=[])
        )
        assert (await service.post("/stop"))[0] == 202
    assert "Traceback" not in caplog.text


@pytest.mark.parametrize("sent", [b"", HEAD + BODY[:3]], ids=["silent", "half"])
async def test_a_request_that_does_not_come_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, sent: bytes
) -> None:
    monkeypatch.setattr(connections, "REQUEST_S", 0.2)
    async with serving(tmp_path) as service:
        client = await service.connect()
        client.writer.write(sent)
        assert await client.dropped(3)


async def test_a_client_that_dribbles_is_dropped_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "REQUEST_S", 0.2)
    async with serving(tmp_path) as service:
        client = await service.connect()

        async def dribble() -> None:
            with suppress(ConnectionError):
                for byte in b"GET /state HTTP/1.1\r\nX: " + b"y" * 1000:
                    client.writer.write(bytes([byte]))
                    await client.writer.drain()
                    await asyncio.sleep(0.01)

        dribbling = asyncio.create_task(dribble())
        assert await client.dropped(3)
        await dribbling


def dropped(deaf: socket.socket) -> bool:
    try:
        deaf.send(b"x")
    except OSError:
        return True
    return False


async def watch(service: Service) -> Client:
    client = await service.connect()
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"} | {
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="
    }
    client.send("GET", "/stream", b"", **upgrade)
    assert b" 101 " in await client.reader.readuntil(b"\r\n\r\n")
    return client


async def test_a_watcher_gets_the_state_first_and_one_that_does_not_read_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "UNREAD_S", 0.3)
    async with serving(tmp_path) as service:
        reads = await watch(service)
        with socket.socket(socket.AF_UNIX) as deaf:
            deaf.connect(str(service.path))
            deaf.send(
                b"GET /stream HTTP/1.1\r\nHost: d\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
            )
            first = await reads.reader.readexactly(30)
            assert b'"order": "state"' in first
            for _ in range(40):
                service.stream.state("x" * 60_000)
                await reads.reader.read(1 << 20)
                await asyncio.sleep(0.01)
            await asyncio.sleep(1.0)
            deaf.settimeout(1)
            assert dropped(deaf)
        service.stream.event("still here")
        async with asyncio.timeout(5):
            while b"still here" not in await reads.reader.read(1 << 20):
                pass


async def test_too_much_and_nowhere_are_sentences(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        for path, method, content, status in (
            ("/jog", "POST", b"[" * (api.BODY_LIMIT_BYTES + 1), 413),
            ("/jog", "POST", b"[" * api.BODY_LIMIT_BYTES, 422),
            ("/nowhere", "GET", b"", 404),
            ("/stop", "GET", b"", 405),
            ("/stream", "GET", b"", 404),
        ):
            got, told = await service.post(path, content, method)
            assert (got, told["exit_code"]) == (status, 2), path
            assert told["error"].isprintable()
        assert service.asked == []


async def test_a_refusal_links_to_the_description(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        for path in ("/nowhere", "/jog"):
            client = await service.connect()
            client.send("POST", path, b'{"to_deg": "far"}')
            head = await client.reader.readuntil(b"\r\n\r\n")
            assert b'</openapi.json>; rel="service-desc"' in head


async def test_the_openapi_document_has_every_path(tmp_path: Path) -> None:
    async with serving(tmp_path) as service:
        status, told = await service.post("/openapi.json", method="GET")
        assert status == 200
        assert set(told["paths"]) == {
            *("/state", "/stop", "/lease", "/compensate", "/jog", "/home", "/hold", "/release", "/clear")
        }  # fmt: skip
        speed = told["components"]["schemas"]["Jog"]["properties"]["speed_deg_s"]["anyOf"][0]
        assert speed == {"maximum": 360.0, "minimum": 0.1, "type": "number"}


@pytest.mark.parametrize(("given_mb", "kept_mb"), [(768, 768), (4096, 1024)])
def test_a_memory_limit_that_was_given_is_kept_and_never_raised(given_mb: int, kept_mb: int) -> None:
    code = (
        "import resource; from needle_rig.service.api.api_process import limit_memory;"
        f" resource.setrlimit(resource.RLIMIT_AS, ({given_mb} << 20,) * 2); limit_memory();"
        " print(resource.getrlimit(resource.RLIMIT_AS)[0] >> 20)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == f"{kept_mb}\n", done.stderr
