"""Holds the tick beside cyclictest: 1 kHz, the bench behind slcan, two busy processes, the same minutes.

`real_time [--minutes 10]` needs root, rt-tests and a machine with nothing else to do. It prints how
late ticks come beside cyclictest's thread of the same priority, how long the kernel takes to deliver a frame
of the rig and the daemon to answer it with a command, and where in the kernel late ticks had waited.
cyclictest does not count the cycles that it skips; so the tick is shown as it counts, and with them.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import numpy.typing as npt

from needle_rig.config.files import find_config_file
from needle_rig.numerics import Array
from needle_rig.recording import RunFile
from needle_rig.service.client import DaemonClient, find_daemon

PERIOD_S = 1e-3
PRIORITY = 50
"""Of the daemon, as in service.realtime."""
MOTIONS = 5
"""Of the plain sequence, each followed by its settling."""
MOST_US = 50_000
TRACING = Path("/sys/kernel/tracing")
TRACE_S = 30.0
LATE_S = 250e-6
"""Ticks later than this are looked at in the trace: twice what cyclictest's p99.9 is on an idle machine."""
NEWEST = 4096
"""Ticks over which the daemon tells how late they came."""
START_S = 180.0
QUANTILES = (0.5, 0.99, 0.999, 1.0)
_EVENT = re.compile(
    r"^\s*(?P<comm>.+)-(?P<pid>\d+)\s+\[\d+\]\s+\S+\s+(?P<time>\d+\.\d+): (?P<event>\S+): (?P<rest>.*)$"
)
CALLS = ("syscalls/sys_enter_read", "syscalls/sys_enter_write")
WOKEN, SWITCHED = "sched/sched_wakeup", "sched/sched_switch"
FILTERS = {
    **dict.fromkeys(CALLS, "common_pid == {}"),
    WOKEN: "pid == {}",
    SWITCHED: "prev_pid == {0} || next_pid == {0}",
}
"""What of each event of the kernel's trace is of a thread."""
_PID = re.compile(r"\bpid=(\d+) ")
_CALL = re.compile(r"sys_(read|write)\(fd: (?:0x)?([0-9a-f]+), buf: \S+ count: (?:0x)?([0-9a-f]+)")
ACKNOWLEDGEMENT_BYTES = 8
"""What the bench writes after a command of the daemon is shorter, a frame longer."""
_SCHEDULING = (
    "schedule",
    "__schedule",
    "__traceiter",
    "trace_event",
    "preempt_schedule",
    "asm_",
    "irqentry_exit",
)


def main() -> int:
    """Measure, then print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--busy", type=int, default=2, help="processes that compute for nothing")
    options = parser.parse_args()
    if os.geteuid() != 0:
        print("run it as root: real-time priority and the kernel's trace", file=sys.stderr)
        return 2
    seconds = options.minutes * 60.0
    with tempfile.TemporaryDirectory(prefix="needle-rig-real-time-") as place:
        folder = Path(place)
        with daemon_of(folder) as (client, pid), busy(options.busy):
            settle_s = min((seconds + 2 * TRACE_S + 20.0) / MOTIONS, 600.0)
            cyclic = subprocess.Popen(
                ["cyclictest", f"-p{PRIORITY}", "-m", "-q", "-i1000", f"-h{MOST_US}", f"-D{seconds:g}"],
                stdout=subprocess.PIPE,
                text=True,
            )
            order = {"target_deg": 45.0, "strategy": "reed2008", "settle_s": settle_s}
            run = client.compensate(order)["run"]
            told = cyclic.communicate()[0]
            # not before: the trace costs time too
            untraced_s = time.monotonic()
            everybody = [thread for each in pids_of(pid) for thread in threads_of(each)]
            calls = traced([*CALLS, WOKEN], everybody, folder)
            frames = frame_calls(calls, pid)
            switches = traced([SWITCHED], [pid], folder)
            while client.state()["run"] is not None:
                time.sleep(1.0)
            late_p50_s = (client.state()["ticks"]["late_p50_ms"] or 0.0) * 1e-3
        file = RunFile(run)
        if file.result is not None and file.result["status"] == "fault":
            raise SystemExit(f"the run ended too early: {file.result['fault_name']}; leave the machine alone")
        time_s = file.table("ticks")["time_s"]
        delivered_s, answered_s = answer_times(*frames, time_s)
        zero_s = deadline_zero_s(time_s, late_p50_s)
        late_s, served = lateness(time_s[time_s < untraced_s], zero_s)
        beside_s = histogram(told)
        came_s, cycles = late_s[served], round(seconds / PERIOD_S)
        columns = {
            "tick, late by": came_s,
            "cyclictest, late by": beside_s,
            "tick, late by, skipped deadlines counted until the next": late_s,
            "frame written → delivered by the kernel": delivered_s,
            "frame delivered → command out": answered_s - delivered_s,
            "frame written → command out": answered_s,
        }
        ratio = np.quantile(came_s, 0.999) / np.quantile(beside_s, 0.999)
        print(table(columns, options.busy, seconds))
        print(f"p99.9 of the tick is {ratio:.1f} × cyclictest's. Deadlines skipped: {np.sum(~served)} of")
        print(f"{len(late_s)} by the tick, {max(cycles - len(beside_s), 0)} of {cycles} by cyclictest.\n")
        print(waited(switches, pid, time_s, zero_s))
    return 0


@contextlib.contextmanager
def daemon_of(folder: Path) -> Iterator[tuple[DaemonClient, int]]:
    """A daemon with a tick of 1 kHz, its bench behind slcan."""
    text = find_config_file("rig.yaml").read_text(encoding="utf-8")
    (folder / "rig.yaml").write_text(re.sub(r"tick_hz: \d+", "tick_hz: 1000", text))
    socket = folder / "daemon.sock"
    command = [sys.executable, "-m", "needle_rig", "daemon", "--config", str(folder / "rig.yaml")]
    command += ["--out", str(folder / "runs"), "--socket", str(socket)]
    with (folder / "log").open("w") as log, subprocess.Popen(command, stderr=log) as daemon:
        try:
            deadline_s = time.monotonic() + START_S
            client = None
            while client is None or client.state()["sensors"] is None:
                if time.monotonic() > deadline_s:
                    raise SystemExit(f"no daemon within {START_S:g} s: {(folder / 'log').read_text()}")
                time.sleep(0.2)
                client = find_daemon(socket)
            with client.lease("real_time"):
                yield client, daemon.pid
        finally:
            daemon.terminate()
            daemon.wait(60.0)


@contextlib.contextmanager
def busy(count: int) -> Iterator[None]:
    """Processes of ordinary priority that compute for nothing."""
    running = [subprocess.Popen(["sh", "-c", "while :; do :; done"]) for _ in range(count)]
    try:
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def deadline_zero_s(time_s: Array, late_p50_s: float) -> float:
    """A deadline, from the times of the ticks (n,) and the median of the newest's lateness in its status."""
    phase_s = np.mod(time_s - time_s[0], PERIOD_S)
    counts, edges_s = np.histogram(phase_s, 100, (0.0, PERIOD_S))
    mode_s = edges_s[np.argmax(counts)]
    around_s = np.mod(phase_s[-NEWEST:] - mode_s + PERIOD_S / 2, PERIOD_S) - PERIOD_S / 2
    return float(time_s[0] + mode_s + np.median(around_s) - late_p50_s)


def lateness(time_s: Array, zero_s: float) -> tuple[Array, npt.NDArray[np.bool_]]:
    """How late each deadline was served, s, and whether by a tick of its own, from the ticks' times (n,)."""
    tick = np.floor((time_s - zero_s) / PERIOD_S + 1e-6).astype(int)
    deadlines = np.arange(tick[0], tick[-1] + 1)
    served = np.searchsorted(tick, deadlines)
    late_s = time_s[served] - zero_s - deadlines * PERIOD_S
    return late_s, np.isin(deadlines, tick)


def histogram(told: str) -> Array:
    """cyclictest's latencies, one a line of its histogram, in seconds."""
    rows = [line.split() for line in told.splitlines() if re.match(r"\d{6} ", line)]
    over = re.search(r"# Histogram Overflows:\s*(\d+)", told)
    at_us = np.array([int(row[0]) for row in rows] + [MOST_US])
    counts = np.array([int(row[1]) for row in rows] + [int(over[1]) if over else 0])
    return np.repeat(at_us * 1e-6, counts)


def pids_of(pid: int) -> list[int]:
    """The daemon and its bench."""
    children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    bench = [each for each in children if "simulation.bench" in Path(f"/proc/{each}/cmdline").read_text()]
    return [pid, *map(int, bench)]


def threads_of(pid: int) -> list[int]:
    """The threads of a process, the first included."""
    return sorted(int(folder.name) for folder in Path(f"/proc/{pid}/task").iterdir())


def traced(events: list[str], pids: list[int], folder: Path) -> list[str]:
    """Lines of the kernel's trace of these events in these processes, for TRACE_S."""
    if not (TRACING / "events").is_dir():
        subprocess.run(["mount", "-t", "tracefs", "none", str(TRACING)], check=True)
    scheduling = events == [SWITCHED]
    kept = folder / "trace"
    (TRACING / "trace_clock").write_text("mono")
    (TRACING / "buffer_size_kb").write_text("32768")
    (TRACING / "options/stacktrace").write_text(str(int(scheduling)))
    for event in events:
        ours = " || ".join(FILTERS[event].format(pid) for pid in pids)
        (TRACING / "events" / event / "filter").write_text(ours)
        (TRACING / "events" / event / "enable").write_text("1")
    with kept.open("wb") as out, subprocess.Popen(["cat", str(TRACING / "trace_pipe")], stdout=out) as reader:
        time.sleep(TRACE_S)
        for event in events:
            (TRACING / "events" / event / "enable").write_text("0")
            (TRACING / "events" / event / "filter").write_text("0")
        time.sleep(2.0)
        reader.kill()
    (TRACING / "options/stacktrace").write_text("0")
    return kept.read_text(errors="replace").splitlines()


def frame_calls(lines: list[str], pid: int) -> tuple[Array, Array, Array, Array]:
    """When the bench wrote frames, when the kernel woke the daemon's thread that reads its CAN port, when
    that began to read, and when the daemon wrote to the port, s."""
    daemon_fds, threads = port_descriptors(pid), threads_of(pid)
    wrote_s: list[float] = []
    read_s: list[float] = []
    sent_s: list[float] = []
    woken_s: dict[int, list[float]] = defaultdict(list)
    readers: Counter[int] = Counter()
    bench_fds = {child: hub_descriptor(child) for child in pids_of(pid)[1:]}
    for line in lines:
        event = _EVENT.match(line)
        if event is None:
            continue
        who, at_s = int(event["pid"]), float(event["time"])
        if woken := event["event"] == "sched_wakeup" and _PID.search(event["rest"]):
            woken_s[int(woken[1])].append(at_s)
        elif (call := _CALL.search(line)) is not None:
            fd = int(call[2], 16)
            if who in threads and fd in daemon_fds and call[1] == "read":
                read_s.append(at_s)
                readers[who] += 1
            elif who in threads and fd in daemon_fds:
                sent_s.append(at_s)
            elif call[1] == "write" and bench_fds.get(who) == fd and int(call[3], 16) > ACKNOWLEDGEMENT_BYTES:
                wrote_s.append(at_s)
    reader = readers.most_common(1)[0][0]
    return np.array(wrote_s), np.array(woken_s[reader]), np.array(read_s), np.array(sent_s)


def answer_times(
    wrote_s: Array, woken_s: Array, read_s: Array, sent_s: Array, tick_s: Array
) -> tuple[Array, Array]:
    """From each write of frames by the bench until the kernel has woken the daemon's reader for them, and
    until the command of the first tick that begins after they were read, s."""
    wrote_s = wrote_s[(wrote_s > woken_s[0]) & (wrote_s < sent_s[-1] - 0.1)]
    taken_s = read_s[np.searchsorted(read_s, wrote_s)]
    # a reader that was awake already had them at once
    delivered_s = np.maximum(woken_s[np.searchsorted(woken_s, taken_s) - 1], wrote_s)
    began_s = tick_s[np.searchsorted(tick_s, taken_s)]
    return delivered_s - wrote_s, sent_s[np.searchsorted(sent_s, began_s)] - wrote_s


def port_descriptors(pid: int) -> set[int]:
    """The daemon's descriptors of its CAN port, the bench's pseudo-terminal `can`; the lock's included."""
    return descriptors(pid, str(Path(can_link(pid)).resolve()))


def descriptors(pid: int, target: str) -> set[int]:
    """Those of a process that are open on `target`."""
    found = set()
    for entry in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(OSError):
            if os.readlink(entry) == target:
                found.add(int(entry.name))
    return found


def hub_descriptor(bench: int) -> int:
    """The bench's end of the same."""
    number = Path(can_link(bench)).resolve().name
    for entry in Path(f"/proc/{bench}/fdinfo").iterdir():
        if re.search(rf"(?m)^tty-index:\s*{number}$", entry.read_text()):
            return int(entry.name)
    raise SystemExit("the bench has no CAN port")


def can_link(pid: int) -> str:
    """Path of the name of the CAN port."""
    bench = pid if "simulation.bench" in Path(f"/proc/{pid}/cmdline").read_text() else pids_of(pid)[1]
    words = Path(f"/proc/{bench}/cmdline").read_text().split("\0")
    return str(Path(words[words.index("--child-in") + 1]) / "can")


def waited(lines: list[str], pid: int, time_s: Array, zero_s: float) -> str:
    """Where the daemon was between a deadline and a tick that came more than LATE_S after it, as a table."""
    spells = list(away(lines, pid))
    tick = np.floor((time_s - zero_s) / PERIOD_S + 1e-6)
    # since the first deadline that no tick before had served
    late_s = time_s - zero_s - PERIOD_S * np.r_[tick[0], tick[:-1] + 1]
    if not spells:
        return "the kernel's trace is empty"
    begin_s, end_s = spells[0][0], spells[-1][1]
    seen = (time_s > begin_s) & (time_s < end_s)
    chosen = seen & (late_s > LATE_S)
    spent_s: dict[str, float] = defaultdict(float)
    times: Counter[str] = Counter()
    starts = np.array([spell[0] for spell in spells])
    total_s = 0.0
    for wake_s, lag_s in zip(time_s[chosen], late_s[chosen], strict=True):
        deadline_s = wake_s - lag_s
        total_s += lag_s
        left_s = lag_s
        first = max(int(np.searchsorted(starts, deadline_s)) - 1, 0)
        for out_s, in_s, why in spells[first:]:
            if out_s > wake_s:
                break
            overlap_s = min(in_s, wake_s) - max(out_s, deadline_s)
            if overlap_s > 0:
                spent_s[why] += overlap_s
                times[why] += 1
                left_s -= overlap_s
        spent_s["on the processor: work of this tick and the one before"] += max(left_s, 0.0)
    rows = sorted(spent_s.items(), key=lambda item: -item[1])
    told = [
        f"| {why} | {spent / total_s:.0%} | {times[why] or ''} |"
        for why, spent in rows
        if spent > 0.01 * total_s
    ]
    over_us = LATE_S * 1e6
    head = (
        f"{chosen.sum()} of {seen.sum()} ticks of {end_s - begin_s:.0f} s came over {over_us:.0f} µs late."
        " Where the daemon was meanwhile:"
    )
    return "\n".join([head, "", "| place | share of the time | times |", "|---|---|---|", *told])


def away(lines: list[str], pid: int) -> Iterator[tuple[float, float, str]]:
    """When the daemon's thread was off the processor: from, until, and where in the kernel it went there."""
    out_s, why, stack = 0.0, "", list[str]()
    for line in [*lines, ""]:
        if line.startswith((" => ", "=> ")):
            stack.append(line.split("=>")[1].strip())
            continue
        event = _EVENT.match(line)
        if event is None or event["event"] != "sched_switch":
            continue
        if f"next_pid={pid} " in event["rest"] + " ":
            if out_s:
                yield out_s, float(event["time"]), place(why, stack if why != "R" else [])
            out_s, stack = 0.0, []
        elif f"prev_pid={pid} " in event["rest"]:
            state = re.search(r"prev_state=(\S)", event["rest"])
            out_s, why, stack = float(event["time"]), state[1] if state else "?", []


def place(state: str, stack: list[str]) -> str:
    """What a person calls it."""
    if state == "R":
        return "runnable: others had the processor"
    called = [name for name in stack if not name.startswith(_SCHEDULING)]
    if any("epoll" in name for name in called) and not any("flush_work" in name for name in called):
        return "asleep until its timer: the wake-up itself"
    return "waits in the kernel: " + " ← ".join(f"`{name}`" for name in called[:4])


def table(columns: Mapping[str, Array], busy_processes: int, seconds: float) -> str:
    """Quantiles of times in seconds, by what they are of, as Markdown in milliseconds."""
    rows = []
    for name, values_s in columns.items():
        cells = [f"{np.quantile(values_s, q, method='higher') * 1e3:.3f}" for q in QUANTILES]
        rows.append("| " + " | ".join([name, str(len(values_s)), *cells]) + " |")
    return "\n".join(
        [
            f"{seconds / 60:g} minutes, {1 / PERIOD_S:g} Hz, {busy_processes} busy processes,"
            f" {os.cpu_count()} cores, Linux {os.uname().release}, load {os.getloadavg()[1]:.1f}.",
            "",
            "| | times | p50 ms | p99 ms | p99.9 ms | most ms |",
            "|---|---|---|---|---|---|",
            *rows,
            "",
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
