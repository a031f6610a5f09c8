"""What the API costs the tick: lateness and missed ticks with many bad clients, beside windows without.

The daemon is the real one in real time, with the plant of the simulated rig in its own process, a run that
goes on and is recorded. The load: 300 clients that never finish a request, 200 watchers of which 50 never
read, bodies of 1 MB, one after the other, and the state, asked for by four clients at once. In one window
of a round nobody asks anything, in one the load is on the daemon, and in one it is on a bystander: the same
API process, which belongs to a process without a tick. What a window with the bystander differs from a still
one is what a busy machine costs; what the daemon's differs from the bystander's is what the API costs.
"""

from __future__ import annotations

import asyncio
import base64
import contextlib
import dataclasses
import http.client
import json
import logging
import os
import select
import socket
import subprocess
import sys
import tempfile
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import structlog

from campaigns import ROOT
from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.assembly import build_daemon
from needle_rig.config.loader import load_rig_config
from needle_rig.service.api.api_link import STATES_HZ, ApiLink
from needle_rig.service.api.endpoint import listening
from needle_rig.service.tick.clock import TimerClock
from needle_rig.service.tick.realtime import make_steady

HALF_OPEN, WATCHERS, DEAF = 300, 200, 50
BODY = b'{"target_deg": 1, "options": {"a": "' + b"x" * 1_000_000 + b'"}}'
RENEW_S = 0.5
RATES_HZ = (200.0, 1000.0)
WINDOW_S = 8.0
STILL, ASKED, BYSTANDER = ARMS = ("still", "daemon", "bystander")
NICE = 10
"""Clients come after the daemon's processes: what their own work costs is not the API's cost."""


class WatchedClock(TimerClock):
    """Keeps when each tick came, how late, and how many were missed before it."""

    def __init__(self, period_s: float) -> None:
        super().__init__(period_s)
        self.rows: list[tuple[float, float, float]] = []

    async def tick(self, busy: bool) -> int:
        skipped = await super().tick(busy)
        self.rows.append((time.monotonic(), self.lateness_s, skipped))
        return skipped


def serve(folder: Path, hz: float) -> None:
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    config = load_rig_config(None, {"tick_hz": hz})
    daemon = build_daemon(config, virtual=True, runs=folder / "runs")
    clocks: list[WatchedClock] = []
    steady: list[str] = []

    def make_rig(raw: Any) -> Any:
        plant = parts.make_rig(raw)
        read = plant.read

        def moved_on() -> Any:
            plant.advance(1 / hz)  # type: ignore[attr-defined]
            return read()

        plant.read = moved_on  # type: ignore[method-assign]
        return plant

    def make_clock(rig: Any) -> WatchedClock:
        clocks.append(WatchedClock(1 / hz))
        return clocks[-1]

    def be_steady() -> list[str]:
        steady.extend(make_steady())
        return steady

    parts = daemon._parts
    daemon._parts = dataclasses.replace(
        parts, make_rig=make_rig, make_clock=make_clock, make_steady=be_steady
    )

    def on_input() -> None:
        os.read(0, 1)
        daemon.end()

    async def run() -> None:
        asyncio.get_running_loop().add_reader(0, on_input)
        await daemon.run(listener, lambda: print("ready", flush=True))

    with listening(folder / "s", None) as listener:
        asyncio.run(run())
    np.save(folder / "ticks.npy", np.array(clocks[0].rows))
    print("; ".join(steady) or "real-time priority, locked memory", flush=True)


def stand_by(folder: Path, hz: float) -> None:
    """Serve an API whose answers cost nobody a tick, until the standard input ends."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    example = json.loads((folder / "state.json").read_text())

    async def do(name: str, content: Any, claim: Any) -> Any:
        return example

    async def run() -> None:
        over = asyncio.Event()
        asyncio.get_running_loop().add_reader(0, over.set)
        link = ApiLink(do)
        link.start(listener)
        link.serve()
        while not over.is_set():
            link.state(time.monotonic(), lambda: example)
            await asyncio.sleep(1 / STATES_HZ)
        await link.close()

    with listening(folder / "bystander", None) as listener:
        print("ready", flush=True)
        asyncio.run(run())


class Load:
    """The bad clients, between `start` and `stop`."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._over = threading.Event()
        self._threads: list[threading.Thread] = []
        self.bodies = self.states = 0

    def start(self) -> None:
        works = [self._half_open, self._watch, self._deaf, self._bodies, *[self._states] * 4]
        self._threads = [threading.Thread(target=work, daemon=True) for work in works]
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(20)

    def _connect(self, data: bytes) -> socket.socket | None:
        own = socket.socket(socket.AF_UNIX)
        own.settimeout(2)
        try:
            own.connect(str(self._path))
            own.sendall(data)
        except OSError:
            own.close()
            return None
        own.setblocking(False)
        return own

    def _keep(self, count: int, data: bytes, *, read: bool) -> None:
        """So many connections; those that the daemon drops are made again."""
        held: list[socket.socket] = []
        while not self._over.is_set():
            held += [new for _ in range(count - len(held)) if (new := self._connect(data)) is not None]
            until_s = time.monotonic() + RENEW_S
            while time.monotonic() < until_s and not self._over.is_set():
                ready, _, _ = select.select(held if read else [], [], [], 0.1)
                for each in ready:
                    with contextlib.suppress(BlockingIOError):
                        try:
                            if each.recv(1 << 16):
                                continue
                        except ConnectionError:
                            pass
                        held.remove(each)
                        each.close()
            if not read:
                poll = select.poll()
                for each in held:
                    poll.register(each, 0)
                gone = {descriptor for descriptor, _ in poll.poll(0)}
                for each in [one for one in held if one.fileno() in gone]:
                    held.remove(each)
                    each.close()
        for each in held:
            each.close()

    def _half_open(self) -> None:
        head = b"POST /compensate HTTP/1.1\r\nHost: d\r\nContent-Length: 1000\r\n\r\n{"
        self._keep(HALF_OPEN, head, read=False)

    def _watch(self) -> None:
        self._keep(WATCHERS - DEAF, upgrade(), read=True)

    def _deaf(self) -> None:
        self._keep(DEAF, upgrade(), read=False)

    def _bodies(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException):
                ask_api(self._path, "POST", "/compensate", BODY)
                self.bodies += 1

    def _states(self) -> None:
        while not self._over.is_set():
            with contextlib.suppress(OSError, http.client.HTTPException):
                ask_api(self._path, "GET", "/state")
                self.states += 1


def upgrade() -> bytes:
    key = base64.b64encode(os.urandom(16))
    return (
        b"GET /stream HTTP/1.1\r\nHost: d\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: " + key + b"\r\n\r\n"
    )


def ask_api(path: Path, method: str, place: str, body: bytes | None = None) -> tuple[int, bytes]:
    client = http.client.HTTPConnection("d", timeout=10)
    client.sock = socket.socket(socket.AF_UNIX)
    client.sock.settimeout(10)
    try:
        client.sock.connect(str(path))
        client.request(method, place, body)
        answer = client.getresponse()
        return answer.status, answer.read()
    finally:
        client.close()


def judge(ticks: Any, window: tuple[float, float], hz: float) -> tuple[float, float]:
    """The 99 % lateness in ms, and the missed share in per mille."""
    inside = ticks[(ticks[:, 0] >= window[0]) & (ticks[:, 0] < window[1])]
    late_ms = float(np.quantile(inside[:, 1], 0.99) * 1e3)
    return late_ms, float(inside[:, 2].sum() / ((window[1] - window[0]) * hz) * 1e3)


@contextlib.contextmanager
def started(role: str, folder: Path, hz: float) -> Iterator[subprocess.Popen[str]]:
    """A function of this module in a process of its own, ready; told to end afterwards."""
    source = f"import pathlib; from {__name__} import {role}; {role}(pathlib.Path({str(folder)!r}), {hz})"
    command = [sys.executable, "-c", source]
    with subprocess.Popen(
        command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stdout.readline().strip() == "ready"
        try:
            yield process
        finally:
            process.stdin.write("x")
            process.stdin.close()


def plan(given: Namespace) -> list[Row]:
    return [{"hz": hz, "rounds": given.size} for hz in RATES_HZ]


def ask(task: Row, _: Namespace) -> Row:
    """Lateness (ms) and missed ticks (per mille) of each window, by arm, in the order of the rounds."""
    hz = task["hz"]
    windows: list[tuple[str, tuple[float, float]]] = []
    bodies = states = 0
    with tempfile.TemporaryDirectory(prefix="load-") as name:
        folder = Path(name)
        with started("serve", folder, hz) as daemon:
            os.nice(NICE)
            status, _body = ask_api(
                folder / "s", "POST", "/compensate", b'{"target_deg": 45, "settle_s": 600}'
            )
            assert status == 202, status
            (folder / "state.json").write_bytes(ask_api(folder / "s", "GET", "/state")[1])
            with started("stand_by", folder, hz):
                time.sleep(3)
                for turn in range(task["rounds"]):
                    for which in range(len(ARMS)):
                        arm = ARMS[(turn + which) % len(ARMS)]
                        load = None if arm == STILL else Load(folder / ("s" if arm == ASKED else arm))
                        if load is not None:
                            load.start()
                        time.sleep(2)
                        begin_s = time.monotonic()
                        time.sleep(WINDOW_S)
                        windows.append((arm, (begin_s, time.monotonic())))
                        if load is not None:
                            load.stop()
                            if arm == ASKED:
                                bodies, states = bodies + load.bodies, states + load.states
                        time.sleep(1)
            assert daemon.stdin is not None
            assert daemon.stdout is not None
            daemon.stdin.write("x")
            daemon.stdin.flush()
            steady = daemon.stdout.readline().strip()
        ticks = np.load(folder / "ticks.npy")
    told = {arm: [judge(ticks, when, hz) for which, when in windows if which == arm] for arm in ARMS}
    return {"windows": told, "bodies": bodies, "states": states, "steady": steady}


def table(rows: list[Row], _: Namespace) -> str:
    """Medians (least–most) over windows, and ratios of windows in the same round."""
    lines, notes = [], [""]
    for row in answered(rows):
        told = {arm: np.array(windows) for arm, windows in row["windows"].items()}
        rate = f"{row['hz']:g} Hz"
        for arm, values in told.items():
            cells = [f"{np.median(each):.3f} ({each.min():.3f}–{each.max():.3f})" for each in values.T]
            lines.append((rate, arm, *cells))
        notes.append(
            f"- {rate}: {row['rounds']} rounds of {len(ARMS)} windows of {WINDOW_S:g} s; {row['steady']};"
            f" the daemon answered {row['bodies']} bodies of 1 MB and {row['states']} states"
        )
        for one, other in ((ASKED, BYSTANDER), (ASKED, STILL), (BYSTANDER, STILL)):
            low, median, high = np.quantile(told[one][:, 0] / told[other][:, 0], [0.25, 0.5, 0.75])
            notes.append(
                f"- {rate}: lateness, {one} / {other} in the same round: median {median:.2f},"
                f" quartiles {low:.2f} and {high:.2f}"
            )
    heads = ("rate", "windows", "99 % lateness ms", "missed ticks, per mille")
    return "\n".join([markdown(heads, lines), *notes])


CAMPAIGN = Campaign(__doc__, plan, ask, table, 7, "rounds of three windows (7)", rows_a_process=1, jobs=1)
