"""Whether a stop holds: stops at random instants against a daemon in virtual time, by what the rig was told.

Half of the stops fall into a start's window: its first byte is out, the disk is slow (making the run's file
takes up to 50 ms) and the rest of the request comes before or after the stop's acknowledgement, or between.
The others fall at random instants of a motion. Starts are runs, jogs, homings and holds, half with a lease.
A stop holds when, after its acknowledgement, nothing that enables the drive goes to the rig until a new
start. Exit code 1 when one did not.
"""

from __future__ import annotations

import asyncio
import collections
import dataclasses
import json
import logging
import random
import select
import socket
import tempfile
import threading
import time
from argparse import Namespace
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog

from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.assembly import build_daemon
from needle_rig.config.loader import load_rig_config
from needle_rig.records import Command, Firmware, JsonObject, Measurement
from needle_rig.rig import Rig
from needle_rig.service.api.endpoint import listening
from needle_rig.service.tick.daemon import Daemon

STOPS = 200
"""Of a row."""
SLOW_DISK_S = 0.05
MOTION_S = 0.3
WATCHED_S = 0.01
"""After the acknowledgement; virtual ticks take a fifth of a millisecond."""
ANSWER_S = 20.0
STARTS: dict[str, list[JsonObject]] = {
    "compensate": [
        {"target_deg": 30, "settle_s": 0.2},
        {"target_deg": -30, "strategy": "none", "settle_s": 0.2},
    ],
    "jog": [{"by_deg": 5}, {"to_deg": -20, "speed_deg_s": 20}],
    "home": [{}],
    "hold": [{}],
}


class Tapped:
    """A rig that remembers when it was last told to enable the drive."""

    def __init__(self, rig: Rig) -> None:
        self._rig = rig
        self.enabled_s: list[float] = []

    async def open(self) -> None:
        await self._rig.open()

    def read(self) -> Measurement:
        return self._rig.read()

    def write(self, command: Command) -> None:
        if command.enable:
            self.enabled_s.append(time.monotonic())
        self._rig.write(command)

    def firmware(self) -> dict[str, Firmware]:
        return self._rig.firmware()

    async def close(self) -> None:
        await self._rig.close()


def slow_disk(daemon: Daemon, chance: random.Random) -> None:
    """Make a run's file as slowly as a busy disk would, before it is made or after."""
    recorder = daemon._recorder
    begin = recorder.begin

    async def slowly(*arguments: Any) -> Path:
        await asyncio.sleep(chance.uniform(0, SLOW_DISK_S))
        path = await begin(*arguments)
        await asyncio.sleep(chance.uniform(0, SLOW_DISK_S))
        return path

    recorder.begin = slowly  # type: ignore[assignment, method-assign]


class Connection:
    """One HTTP connection, byte by byte."""

    def __init__(self, path: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(ANSWER_S)
        self._socket.connect(str(path))

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def has_come(self) -> bool:
        return bool(select.select([self._socket], [], [], 0)[0])

    def answer(self) -> tuple[int, JsonObject]:
        data = b""
        while b"\r\n\r\n" not in data:
            more = self._socket.recv(65536)
            if not more:
                raise ConnectionError("the daemon closed the connection")
            data += more
        head, _, body = data.partition(b"\r\n\r\n")
        length = int(
            next(line for line in head.splitlines() if line.startswith(b"content-length")).split()[1]
        )
        while len(body) < length:
            body += self._socket.recv(65536)
        return int(head.split()[1]), json.loads(body)

    def close(self) -> None:
        self._socket.close()


def request(path: str, content: JsonObject, lease: str | None = None) -> bytes:
    body = json.dumps(content).encode()
    head = f"POST {path} HTTP/1.1\r\nHost: d\r\nContent-Length: {len(body)}\r\n"
    if lease is not None:
        head += f"Lease: {lease}\r\n"
    return head.encode() + b"\r\n" + body


class Stops:
    """Stops one after the other, and what became of each."""

    def __init__(self, path: Path, rig: Callable[[], Tapped], chance: random.Random) -> None:
        self._path, self._rig, self._chance = path, rig, chance
        self.ends: collections.Counter[str] = collections.Counter()
        self.broken: list[JsonObject] = []
        self.anew = self.asked_twice = 0
        self.acknowledged_ms: list[float] = []

    def one(self, number: int) -> None:
        window = number % 2 == 0
        name = self._chance.choice(list(STARTS))
        lease = self._lease() if self._chance.random() < 0.5 else None
        sent = request(f"/{name}", self._chance.choice(STARTS[name]), lease)
        start, stop = Connection(self._path), Connection(self._path)
        kind = (self._in_window if window else self._in_motion)(start, stop, sent)
        enabled_s = self._rig().enabled_s
        before = len(enabled_s)
        status, told = start.answer()
        time.sleep(WATCHED_S)
        late = enabled_s[before:]
        ended = "run aborted" if status == 202 else "start refused"
        if kind == "start sent while the stop was answered" and status == 202:
            # its first byte may have come after the acknowledgement: then it is a start anew, which a busy
            # machine begins after the watch
            ended, late = "started anew" if late else ended, []
            self._ask("/stop", {})
        if late or status not in (202, 409):
            case = {"number": number, "kind": kind, "name": name, "lease": lease is not None}
            self.broken.append({**case, "status": status, "told": told, "late": len(late)})
            self._ask("/stop", {})
        self.ends[f"{kind}: {ended}"] += 1
        start.close()
        stop.close()
        if number % 10 == 0:
            self._anew()

    def _in_window(self, start: Connection, stop: Connection, sent: bytes) -> str:
        """The start's first byte, the stop and the start's rest in every order."""
        first = self._chance.randint(1, len(sent))
        while_answered = self._chance.random() < 0.3
        if not while_answered:
            start.send(sent[:first])
            time.sleep(self._chance.uniform(0, 2 * SLOW_DISK_S) if first == len(sent) else 0)
        asked_s = time.monotonic()
        stop.send(request("/stop", {"reason": "campaign"}))
        kind = "start begun before the stop"
        if while_answered:
            time.sleep(self._chance.uniform(0, 0.006))
            before = stop.has_come()
            start.send(sent[:first])
            after = stop.has_come()
            kind = "start begun before the acknowledgement"
            if before or after:
                kind = "start sent while the stop was answered"
        rest_early = self._chance.random() < 0.5
        if rest_early:
            start.send(sent[first:])
        self._acknowledged(stop, asked_s)
        if not rest_early:
            start.send(sent[first:])
        return kind

    def _in_motion(self, start: Connection, stop: Connection, sent: bytes) -> str:
        start.send(sent)
        time.sleep(self._chance.uniform(0, MOTION_S))
        asked_s = time.monotonic()
        stop.send(request("/stop", {"reason": "campaign"}))
        self._acknowledged(stop, asked_s)
        return "stop in a motion"

    def _acknowledged(self, stop: Connection, asked_s: float) -> None:
        status, told = stop.answer()
        assert status == 202, told
        self.acknowledged_ms.append(round(1e3 * (time.monotonic() - asked_s), 1))

    def _anew(self) -> None:
        """A start right after the stop must work, and move."""
        before = len(self._rig().enabled_s)
        answer = self._anew_asked("/jog", {"by_deg": self._chance.choice([-1, 1])})
        if answer[0] != 202:
            self.broken.append({"kind": "start anew", "told": answer})
            return
        time.sleep(0.05)
        if len(self._rig().enabled_s) == before:
            self.broken.append({"kind": "start anew", "told": "accepted, and nothing moved"})
        self._ask("/stop", {})

    def _lease(self) -> str:
        return str(self._anew_asked("/lease", {"holder": "campaign"})[1]["lease"])

    def _anew_asked(self, path: str, content: JsonObject) -> tuple[int, JsonObject]:
        self.anew += 1
        answer = self._ask(path, content)
        if answer[0] == 409:  # it came in the very instant of the acknowledgement
            self.asked_twice += 1
            return self._ask(path, content)
        return answer

    def _ask(self, path: str, content: JsonObject) -> tuple[int, JsonObject]:
        connection = Connection(self._path)
        connection.send(request(path, content))
        try:
            return connection.answer()
        finally:
            connection.close()


def run(stops: int, seed: int, folder: Path) -> Stops:
    chance = random.Random(seed)
    config = load_rig_config(None, {"simulation.drive_droop_deg_s_per_nmm": 0.0})
    daemon = build_daemon(config, virtual=True, runs=folder / "runs")
    rigs: list[Tapped] = []

    def tapped(raw: Any) -> Tapped:
        rigs.append(Tapped(make_rig(raw)))
        return rigs[-1]

    make_rig = daemon._parts.make_rig
    daemon._parts = dataclasses.replace(daemon._parts, make_rig=tapped)
    slow_disk(daemon, random.Random(seed + 1))
    ready = threading.Event()
    made = Stops(folder / "s", lambda: rigs[0], chance)
    failure: list[BaseException] = []
    loop: asyncio.AbstractEventLoop

    def stop_again_and_again() -> None:
        try:
            ready.wait(120)
            for number in range(stops):
                made.one(number)
        except BaseException as error:  # noqa: BLE001 - raised again in the main thread
            failure.append(error)
        finally:
            loop.call_soon_threadsafe(daemon.end)

    async def serve() -> None:
        nonlocal loop
        loop = asyncio.get_running_loop()
        await daemon.run(listener, ready.set)

    with listening(folder / "s", None) as listener:
        clients = threading.Thread(target=stop_again_and_again, daemon=True)
        clients.start()
        asyncio.run(serve())
        clients.join(ANSWER_S)
    if failure:
        raise failure[0]
    return made


def plan(given: Namespace) -> list[Row]:
    return [{"seed": given.first_seed + number, "stops": STOPS} for number in range(given.size)]


def ask(task: Row, _: Namespace) -> Row:
    """One daemon, stopped again and again."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    with tempfile.TemporaryDirectory(prefix="stops-") as folder:
        made = run(task["stops"], task["seed"], Path(folder))
    told = ("ends", "acknowledged_ms", "anew", "asked_twice", "broken")
    return {name: getattr(made, name) for name in told}


def table(rows: list[Row], _: Namespace) -> str:
    """How stops ended, and those that did not hold."""
    found = answered(rows)
    ends: collections.Counter[str] = collections.Counter()
    for row in found:
        ends.update(row["ends"])
    broken = [case for row in found for case in row["broken"]]
    lines = [markdown(("stop: ended", "stops"), sorted(ends.items())), ""]
    lines += [f"- {ends.total()} stops, {len(broken)} did not hold."]
    if times := sorted(each for row in found for each in row["acknowledged_ms"]):
        lines.append(f"- Acknowledged after {times[len(times) // 2]} ms (median), {times[-1]} ms at most.")
    anew, twice = (sum(row[name] for row in found) for name in ("anew", "asked_twice"))
    lines.append(f"- {anew} orders right after a stop, {twice} had to be asked twice.")
    return "\n".join([*lines, *(f"- `{case}`" for case in broken[:10])])


def failed(rows: list[Row]) -> bool:
    return any(row["broken"] for row in answered(rows))


CAMPAIGN = Campaign(__doc__, plan, ask, table, 10, f"rows of {STOPS} stops (10)", failed=failed, jobs=1)
