"""Measures the page in Chromium: paint, frames and memory over minutes, sliders, stops, what watchers cost.

`web_figures [--minutes 10]` needs Chromium, playwright (extra `dev`) and a machine with nothing else
to do. It starts a simulated rig in real time with the page beside it, and prints a table.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Browser, CDPSession, Page, sync_playwright
from websockets.asyncio.client import connect

from needle_rig.service.client import DaemonClient, find_daemon

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
START_S = 180.0
VISITS = 9
WATCHERS = 10
PAIRS = 6
WINDOW_S = 22.0
"""The daemon tells lateness over its newest 4096 ticks: 20 s at 200 Hz."""
SLIDES = 200
STOPS = 5
HEAP_READINGS = 10
FRAMES = """() => {
    window.frames_ = [];
    const count = (now) => { window.frames_.push(now); requestAnimationFrame(count); };
    requestAnimationFrame(count);
}"""
SLIDE = """async (place) => {
    const slider = document.querySelector("input[type=range]");
    const cell = document.querySelector("tbody td");
    const before = cell.innerText;
    const begun = performance.now();
    slider.value = place;
    slider.dispatchEvent(new Event("input", {bubbles: true}));
    const late = () => performance.now() - begun > 3000;
    while (cell.innerText === before && !late()) await new Promise(requestAnimationFrame);
    return performance.now() - begun;
}"""


@dataclass(frozen=True)
class Started:
    """The daemon and the page's server."""

    client: DaemonClient
    address: str
    server: int
    """Its process."""

    @property
    def base(self) -> str:
        return self.address.split("/#")[0]

    @property
    def token(self) -> str:
        return self.address.split("token=")[1]


def main() -> int:
    """Measure, then print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="of the live page")
    options = parser.parse_args()
    if CHROMIUM is None:
        print("no Chromium here: apt-get install chromium", file=sys.stderr)
        return 2
    rows: list[tuple[str, str, str]] = []
    with tempfile.TemporaryDirectory(prefix="nr-") as place, started(Path(place)) as rig:
        rows += watched(rig)
        with sync_playwright() as p:
            browser = p.chromium.launch(
                executable_path=CHROMIUM, args=["--no-sandbox", "--enable-precise-memory-info"]
            )
            rows += visits(browser, rig)
            rows += slides(browser, rig)
            rows += stops(browser, rig)
            rows += live(browser, rig, options.minutes)
            browser.close()
    print(f"Chromium headless, {os.cpu_count()} cores, load {os.getloadavg()[1]:.1f}, 200 Hz tick.\n")
    print("| | measured | aim |\n|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")
    return 0


@contextlib.contextmanager
def started(folder: Path) -> Iterator[Started]:
    """A daemon with its bench in real time, and the page beside it."""
    socket = folder / "daemon.sock"
    program = [sys.executable, "-m", "needle_rig"]
    with (
        (folder / "log").open("w") as log,
        subprocess.Popen(
            [*program, "daemon", "--out", str(folder / "runs"), "--socket", str(socket)], stderr=log
        ) as daemon,
    ):
        try:
            deadline_s, client = time.monotonic() + START_S, None
            while client is None or client.state()["sensors"] is None:
                if time.monotonic() > deadline_s:
                    raise SystemExit(f"no daemon within {START_S:g} s")
                time.sleep(0.2)
                client = find_daemon(socket)
            command = [*program, "web", "--socket", str(socket), "--dir", str(folder / "runs")]
            with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True) as server:
                assert server.stdout is not None
                try:
                    yield Started(client, server.stdout.readline().split("the page: ")[1].strip(), server.pid)
                finally:
                    server.terminate()
                    server.wait(30.0)
        finally:
            daemon.terminate()
            daemon.wait(60.0)


def opened(browser: Browser, rig: Started, where: str) -> Page:
    """One page of the site, in a context of its own."""
    page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
    page.goto(rig.address)
    page.goto(f"{rig.base}/#/{where}")
    return page


def visits(browser: Browser, rig: Started) -> list[tuple[str, str, str]]:
    """First paint, and until the rig is shown and stop can be pressed."""
    paint_ms, ready_ms = [], []
    for _ in range(VISITS):
        page = browser.new_context(viewport={"width": 1440, "height": 900}).new_page()
        page.goto(rig.address)
        page.wait_for_selector(".shaft")
        ready_ms.append(float(page.evaluate("performance.now()")))
        paint_ms.append(
            float(page.evaluate("performance.getEntriesByName('first-contentful-paint')[0].startTime"))
        )
        page.context.close()
    return [
        ("first paint", _spread(paint_ms, "ms"), "1 s"),
        ("the rig is shown and stop can be pressed", _spread(ready_ms, "ms"), "1.5 s"),
    ]


def slides(browser: Browser, rig: Started) -> list[tuple[str, str, str]]:
    """From a slider's move until its figures are new."""
    page = opened(browser, rig, "effects")
    page.get_by_role("link", name="tip friction").click()
    page.wait_for_selector(".plot canvas")
    page.wait_for_timeout(2000)
    took = [float(page.evaluate(SLIDE, 20 + (37 * k) % 61)) for k in range(SLIDES)]
    page.context.close()
    p50, p95 = np.quantile(took, [0.5, 0.95])
    return [("a slider redraws", f"p50 {p50:.0f} ms, p95 {p95:.0f} ms of {SLIDES}", "p95 100 ms")]


def stops(browser: Browser, rig: Started) -> list[tuple[str, str, str]]:
    """From a key or click in motion until the base stands, as the daemon says."""
    page = opened(browser, rig, "live")
    page.wait_for_selector(".shaft")
    rows = []
    for how in ("Stop", "Escape", "Space"):
        took_ms = []
        for k in range(STOPS):
            with rig.client.lease("web_figures"):
                rig.client.command("clear")
                time.sleep(0.5)
                rig.client.command("home", {"by": "here", "angle_deg": 0.0, "speed_deg_s": 10.0})
                time.sleep(0.5)
                rig.client.command("jog", {"by_deg": 300.0 * (-1) ** k, "speed_deg_s": 45.0})
            page.locator(".phase", has_text="moves").wait_for()
            time.sleep(1.0)
            begun_s = time.monotonic()
            if how == "Stop":
                page.get_by_role("button", name="Stop", exact=True).click()
            else:
                page.keyboard.press(how)
            took_ms.append(1e3 * (standing_s(rig.client) - begun_s))
        rows.append((f"stop by {how}, until the base stands", _spread(took_ms, "ms"), "–"))
    page.context.close()
    return rows


def standing_s(client: DaemonClient) -> float:
    """When the base's angle stopped changing, on the monotonic clock."""
    last_deg, since_s, end_s = float("nan"), time.monotonic(), time.monotonic() + 10.0
    while time.monotonic() < end_s:
        sensors = client.state()["sensors"]
        assert sensors is not None
        now_deg = sensors["base_deg"] or 0.0
        if not abs(now_deg - last_deg) < 0.02:
            last_deg, since_s = now_deg, time.monotonic()
        elif time.monotonic() - since_s > 0.4:
            return since_s
    raise SystemExit("the base does not stand 10 s after a stop")


def live(browser: Browser, rig: Started, minutes: float) -> list[tuple[str, str, str]]:
    """Frames, memory and the server's processor time while five traces are drawn."""
    page = opened(browser, rig, "live")
    page.wait_for_selector(".shaft")
    page.wait_for_timeout(45_000)  # until the traces are as long as they get
    session = page.context.new_cdp_session(page)
    session.send("Performance.enable")
    first_mb, begun_s, cpu_s = heap_mb(session), time.monotonic(), processor_s(rig.server)
    page.evaluate(FRAMES)
    page.wait_for_timeout(minutes * 60_000)
    frames_s = np.array(page.evaluate("window.frames_")) * 1e-3
    page.evaluate("window.frames_ = []")
    share = (processor_s(rig.server) - cpu_s) / (time.monotonic() - begun_s)
    last_mb = heap_mb(session)
    rates = np.histogram(frames_s, np.arange(frames_s[0], frames_s[-1], 5.0))[0] / 5.0
    page.context.close()
    return [
        (
            f"frames a second, five traces at 30 Hz, {minutes:g} min",
            f"median {np.median(rates):.0f}, least in 5 s {rates.min():.0f}",
            "55",
        ),
        ("memory of the page after collection", f"{first_mb:.1f} MB, then {last_mb:.1f} MB", "no growth"),
        ("processor of the page's server meanwhile", f"{share:.1%} of a core", "5 %"),
    ]


def heap_mb(session: CDPSession) -> float:
    """What the page's modules hold: the least of some readings, as a live page allocates between a
    collection and its reading."""
    readings = []
    for _ in range(HEAP_READINGS):
        session.send("HeapProfiler.collectGarbage")
        found: dict[str, Any] = session.send("Performance.getMetrics")
        readings.append(next(m["value"] for m in found["metrics"] if m["name"] == "JSHeapUsedSize"))
    return float(min(readings)) / 1e6


def processor_s(pid: int) -> float:
    """Processor time of a process."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


def watched(rig: Started) -> list[tuple[str, str, str]]:
    """Lateness of the tick with and without watchers, in turns."""
    without, beside = [], []
    for _ in range(PAIRS):
        time.sleep(WINDOW_S)
        without.append(rig.client.state()["ticks"]["late_p99_ms"] or 0.0)
        beside.append(asyncio.run(watching(rig)))
    ratio = np.array(beside) / np.array(without)
    told = (
        f"{_spread(beside, 'ms')} beside {_spread(without, 'ms')}; ratio in pairs {_spread(list(ratio), '')}"
    )
    return [(f"tick's p99 lateness with {WATCHERS} watchers, {PAIRS} pairs", told, "within its noise")]


async def watching(rig: Started) -> float:
    """The tick's lateness after a window in which others listen to the page's stream."""
    uri = f"ws://{rig.base.removeprefix('http://')}/api/live"

    async def watch() -> None:
        async with connect(uri, subprotocols=["needle-rig", f"token.{rig.token}"], origin=rig.base) as socket:  # type: ignore[list-item,arg-type]
            async for text in socket:
                json.loads(text)

    tasks = [asyncio.create_task(watch()) for _ in range(WATCHERS)]
    await asyncio.sleep(WINDOW_S)
    ended = [task for task in tasks if task.done()]
    late_ms = (await asyncio.to_thread(rig.client.state))["ticks"]["late_p99_ms"] or 0.0
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
    if ended:
        raise SystemExit(f"{len(ended)} watchers were sent away: {ended[0].exception()!r}")
    return late_ms


def _spread(values: list[float], unit: str) -> str:
    low, middle, high = min(values), float(np.median(values)), max(values)
    digits = 0 if middle >= 100 else 2
    return f"{middle:.{digits}f} {unit} ({low:.{digits}f} to {high:.{digits}f})".replace("  ", " ")


if __name__ == "__main__":
    sys.exit(main())
