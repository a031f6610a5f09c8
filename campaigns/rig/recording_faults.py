"""Kills, full disks and power cuts while runs are recorded: what is left on the disk is judged row by row.

`--where fault=kills` kills the daemon's end or the recorder process with -9 at random instants, from the
start of the processes to the end of the run. `full` records on disks of random sizes: tmpfs where it may be
mounted, else (and for every other one) a limit to the file size. `cuts` cuts the power at random instants: of
what was written since the last fsync a random choice of pages and names reaches the disk, one page torn
between sectors. Exit code 1 when a row is wrong or a file does not open.
"""

from __future__ import annotations

import asyncio
import dataclasses
import io
import json
import mmap
import os
import random
import re
import resource
import select
import shutil
import signal
import statistics
import struct
import subprocess
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np

from campaigns.run import Campaign, Row, answered, markdown
from needle_rig.config.loader import load_rig_config
from needle_rig.errors import NeedleRigError
from needle_rig.recording import RunFile, RunWriter, list_runs, run_tables, unfinished_runs
from needle_rig.records import DriveFault, DriveState, Phase, Sample
from needle_rig.service.recorder.recorder import Recorder
from needle_rig.service.recorder.recorder_link import Reply
from needle_rig.service.recorder.recorder_process import Keeper

TICK_S, RAW_PER_TICK = 0.005, 5
LOSS_LIMIT_S = 0.25
PAGE_BYTES, SECTOR_BYTES = 4096, 512
ADDRESS = re.compile(r"\b0x[0-9a-f]{6}")
RUN_S = 0.6


@dataclasses.dataclass
class Tally:
    """What a campaign found."""

    tried: int = 0
    lost_s: list[float] = dataclasses.field(default_factory=list)
    zero_rows: int = 0
    foreign_rows: int = 0
    backward_rows: int = 0
    missing_rows: int = 0
    unopened: int = 0
    torn_seen: int = 0
    wrong: list[str] = dataclasses.field(default_factory=list)
    counts: dict[str, int] = dataclasses.field(default_factory=dict)

    def count(self, what: str) -> None:
        self.counts[what] = self.counts.get(what, 0) + 1

    def add(self, other: Tally) -> None:
        for field in dataclasses.fields(self):
            mine, others = getattr(self, field.name), getattr(other, field.name)
            if isinstance(mine, dict):
                self.counts = {what: mine.get(what, 0) + others.get(what, 0) for what in {*mine, *others}}
            else:
                setattr(self, field.name, mine + others)

    @property
    def good(self) -> bool:
        rows = self.zero_rows + self.foreign_rows + self.backward_rows + self.missing_rows
        return not (rows or self.unopened or self.wrong) and max(self.lost_s, default=0.0) <= LOSS_LIMIT_S


def sample_at(time_s: float, run: int) -> Sample:
    return Sample(
        *(
            time_s,
            TICK_S,
            Phase.MOVING,
            "rotate",
            0.5,
            run * 1e-3,
            (0.1, 0.2, 0.3, 0.4),
            0.7,
            0.2,
            True,
            False,
        ),
        *(DriveState.RUNNING, DriveFault.NONE, 0.001, 0.002, 0.003),
    )


def raw_at(time_s: float, number: int, run: int) -> tuple[float, ...]:
    return (time_s, time_s % 60, number, run * 1e-3)


def judge(path: Path, run: int, tally: Tally) -> float:
    """Count what is wrong with the rows of the run at `path`; the time of the last one, nan without any."""
    try:
        file = RunFile(path)
        torque, ticks = file.table("torque"), file.table("ticks")
        _ = file.events, file.result
    except NeedleRigError as error:
        tally.unopened += 1
        tally.wrong.append(str(error))
        return float("nan")
    for rows in (torque, ticks):
        zero = rows["time_s"] == 0.0
        tally.zero_rows += int(zero.sum())
        tally.foreign_rows += int((rows["torque_nm"][~zero] != run * 1e-3).sum())
        tally.backward_rows += int((np.diff(rows["time_s"]) <= 0).sum())
    tally.missing_rows += int((torque["counter"] != np.arange(len(torque))).sum())
    if abs(len(torque) - RAW_PER_TICK * len(ticks)) > RAW_PER_TICK * 0.06 / TICK_S:
        tally.wrong.append(f"{path}: {len(torque)} torque rows beside {len(ticks)} ticks")
    return float(torque["time_s"][-1]) if len(torque) else float("nan")


def close_left(folder: Path, tally: Tally) -> None:
    """Do what the next daemon does, and hold the closed files against the journals they are made of."""
    for path in unfinished_runs(folder):
        before = rows_of(path)
        answers = io.StringIO()
        Keeper(answers).take(1, "recover", path, "it was cut off", None)
        answer: Reply = json.loads(answers.getvalue())
        if "error" in answer:
            tally.wrong.append(answer["error"])
        elif answer.get("torn_bytes"):
            tally.torn_seen += 1
        if path.exists() and before is not None and before != rows_of(path):
            tally.wrong.append(f"{path}: other rows than its journal had")
    if left := [one.name for one in folder.iterdir() if one.suffix != ".h5" or one.name.startswith(".")]:
        tally.wrong.append(f"left behind: {left}")
    for summary in list_runs(folder):
        if summary.status == "unreadable":
            tally.unopened += 1


def rows_of(path: Path) -> list[bytes] | None:
    with suppress(NeedleRigError):
        file = RunFile(path)
        return [file.table(name).tobytes() for name in file.tables]
    return None


# kills


class Shared:
    """Numbers that a process leaves to the one that kills it: time of the newest row, pid of the recorder."""

    def __init__(self) -> None:
        self._memory = mmap.mmap(-1, 32)

    def put(self, place: int, value: float) -> None:
        struct.pack_into("<d", self._memory, 8 * place, value)

    def get(self, place: int) -> float:
        return float(struct.unpack_from("<d", self._memory, 8 * place)[0])


HANDED_S, PID, ENDED, FIRST_S = 0, 1, 2, 3


async def one_daemon(folder: Path, run: int, run_s: float, shared: Shared) -> None:
    """Record one run in real time, close it, and one more when its record was lost."""
    failures: list[str] = []
    recorder = Recorder(failures.append)
    config = load_rig_config()
    await recorder.start(folder)
    shared.put(PID, recorder._links[-1].process.pid)
    about = {"strategy": f"run{run}", "target_deg": 45.0, "parameters": "rig_rigid"}
    for attempt in range(3):
        try:
            await recorder.begin(folder, config, about)
        except NeedleRigError:
            continue
        begin_s, number, count = time.monotonic(), 0, len(failures)
        while (now_s := time.monotonic()) - begin_s < run_s and len(failures) == count:
            while begin_s + number * TICK_S / RAW_PER_TICK <= now_s:
                at_s = begin_s + number * TICK_S / RAW_PER_TICK
                recorder.raw("torque", raw_at(at_s, number, run))
                if number % RAW_PER_TICK == 0:
                    recorder.sample(sample_at(at_s, run))
                number += 1
                if attempt == 0:
                    shared.put(HANDED_S, at_s)
                    shared.put(FIRST_S, begin_s)
            await asyncio.sleep(0.002)
        lost = len(failures) > count
        try:
            await recorder.finish({"status": "fault" if lost else "aligned"}, time.monotonic())
        except NeedleRigError:
            lost = True
        shared.put(ENDED, 1.0)
        if not lost:
            break
    await recorder.close()


def start_daemon(folder: Path, run: int, run_s: float, shared: Shared) -> int:
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
            asyncio.run(asyncio.wait_for(one_daemon(folder, run, run_s, shared), 60))
            code = 0
        finally:
            os._exit(code)
    return pid


def kills(count: int, folder: Path, seed: int) -> Tally:
    """Kill -9 at `count` random instants."""
    load_rig_config()
    chance, tally = random.Random(seed), Tally()
    for run in range(1, count + 1):
        _one_kill(folder / f"kill{run}", run, chance, tally)
    return tally


def _one_kill(place: Path, run: int, chance: random.Random, tally: Tally) -> None:
    shared = Shared()
    tally.tried += 1
    place.mkdir()
    whom = chance.choice(("daemon", "recorder"))
    pid = start_daemon(place, run, RUN_S, shared)
    if chance.random() < 0.7:
        while not shared.get(FIRST_S) and not _ends(pid, 0.001):
            pass
        time.sleep(chance.uniform(0.0, RUN_S + 0.1))
    else:
        time.sleep(chance.uniform(0.0, 0.8))
    handed_s, ended, recorder = shared.get(HANDED_S), shared.get(ENDED), int(shared.get(PID))
    watched = _watch(recorder)
    with suppress(ProcessLookupError):
        os.kill(pid if whom == "daemon" else recorder or pid, signal.SIGKILL)
    if not _ends(pid, 60.0):
        os.kill(pid, signal.SIGKILL)
    status = os.waitpid(pid, 0)[1]
    if whom == "recorder" and recorder and status != 0:
        tally.wrong.append(f"{place.name}: the daemon did not survive its recorder: {status}")
    if watched is not None:
        if not select.select([watched], [], [], 20)[0]:
            tally.wrong.append(f"{place.name}: the recorder outlived its daemon")
        os.close(watched)
    when = "at the start" if not handed_s else "after the end" if ended else "in the run"
    tally.count(f"{whom} killed {when}")
    _judge_kill(place, run, shared.get(FIRST_S), handed_s, whom, ended, tally)
    shutil.rmtree(place)


def _watch(pid: int) -> int | None:
    with suppress(OSError):
        return os.pidfd_open(pid) if pid else None
    return None


def _ends(pid: int, within_s: float) -> bool:
    descriptor = os.pidfd_open(pid)
    ended = bool(select.select([descriptor], [], [], within_s)[0])
    os.close(descriptor)
    return ended


def _judge_kill(
    place: Path, run: int, first_s: float, handed_s: float, whom: str, ended: float, tally: Tally
) -> None:
    runs = sorted(list_runs(place), key=lambda one: one.name)
    last_s = [judge(one.path, run, tally) for one in runs]
    if handed_s and not ended:
        missing_s = handed_s - last_s[0] if last_s and last_s[0] == last_s[0] else handed_s - first_s
        tally.lost_s.append(max(0.0, missing_s))
    if whom == "recorder" and runs and runs[-1].status != "aligned":
        tally.wrong.append(f"{place.name}: the run after the kill is {runs[-1].status}")
    close_left(place, tally)
    for one in list_runs(place):
        judge(one.path, run, tally)


# full disks


def full(count: int, folder: Path, seed: int) -> Tally:
    """Record on `count` disks of random size."""
    chance, tally = random.Random(seed), Tally()
    for run in range(1, count + 1):
        place = folder / f"disk{run}"
        place.mkdir()
        size_bytes, rows_s = chance.randrange(60_000, 3_000_000), chance.uniform(0.5, 20.0)
        tally.tried += 1
        with _disk(place, size_bytes, mounted=run % 2 == 0) as (limit_bytes, grow):
            tally.count("tmpfs" if limit_bytes is None else "limit to the file size")
            runs = place / "runs"
            reader, writer = os.pipe()
            pid = os.fork()
            if pid == 0:
                os.close(reader)
                _fill_disk(runs, run, rows_s, limit_bytes, writer)
            os.close(writer)
            with os.fdopen(reader) as told:
                answers: list[Reply] = [json.loads(line) for line in told]
            status = os.waitpid(pid, 0)[1]
            if status != 0:
                tally.wrong.append(f"{place.name}: the recorder ended with {status}")
            errors = [answer for answer in answers if "error" in answer]
            tally.count("run whole" if not errors else "run stopped, or its file not made")
            tally.wrong += [
                f"not one sentence: {one['error']!r}"
                for one in errors
                if "\n" in one["error"] or ADDRESS.search(one["error"])
            ]
            for one in list_runs(runs):
                _judge_full(one.path, run, errors, tally)
            grow()
            close_left(runs, tally) if runs.exists() else None
            for one in list_runs(runs):
                _judge_full(one.path, run, errors, tally)
            after = io.StringIO()
            record(Keeper(after), runs, run, 0.5)
            if any("error" in json.loads(line) for line in after.getvalue().splitlines()):
                tally.wrong.append(f"with room again: {after.getvalue()}")
    return tally


def _judge_full(path: Path, run: int, errors: list[Reply], tally: Tally) -> None:
    judge(path, run, tally)
    with suppress(NeedleRigError):
        file = RunFile(path)
        stopped = any("kept_rows" in one for one in errors)
        rows = len(file.events) + sum(len(file.table(name)) for name in file.tables)
        kept = max((one.get("kept_rows", 0) for one in errors), default=0)
        if rows < kept:
            tally.wrong.append(f"{path}: {rows} rows, told were {kept}")
        if file.result is None or file.complete == stopped:
            tally.wrong.append(f"{path}: complete {file.complete}, result {file.result} after {errors}")


def _fill_disk(runs: Path, run: int, rows_s: float, limit_bytes: int | None, writer: int) -> None:
    code = 1
    try:
        if limit_bytes is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes))
        with os.fdopen(writer, "w") as answers:
            record(Keeper(answers), runs, run, rows_s)
        code = 0
    finally:
        os._exit(code)


def record(keeper: Keeper, runs: Path, run: int, rows_s: float) -> None:
    """A run of `rows_s` in virtual time, as the daemon sends it."""
    keeper.take(
        1, "begin", runs, load_rig_config(), {"strategy": f"run{run}", "target_deg": 1.0, "parameters": ""}
    )
    number, time_s = 0, 1.0
    while time_s < 1.0 + rows_s:
        batch: dict[str, list[Any]] = {"ticks": [], "torque": []}
        for _ in range(10):
            for _ in range(RAW_PER_TICK):
                batch["torque"].append(
                    raw_at(time_s + (number % RAW_PER_TICK) * TICK_S / RAW_PER_TICK, number, run)
                )
                number += 1
            batch["ticks"].append(sample_at(time_s, run))
            time_s += TICK_S
        keeper.take(0, "rows", batch)
    keeper.take(2, "finish", {"status": "aligned", "motions": ["x" * 40] * 30}, time_s)


@contextmanager
def _disk(
    place: Path, size_bytes: int, *, mounted: bool
) -> Iterator[tuple[int | None, Callable[[], object]]]:
    def tmpfs(options: str) -> bool:
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(place)]
        return subprocess.run(command, capture_output=True, check=False).returncode == 0

    if mounted and os.geteuid() == 0 and tmpfs(f"size={size_bytes}"):
        try:
            yield None, lambda: tmpfs("remount,size=64m")
        finally:
            subprocess.run(["umount", str(place)], check=True)
    else:
        yield size_bytes, lambda: None


# power cuts


class PowerCut(BaseException):
    """The power went."""


class Disk:
    """Watches what the recorder asks of the disk in `folder`, and knows what a power cut may leave of it."""

    WATCHED = (
        "open",
        "pwrite",
        "posix_fallocate",
        "ftruncate",
        "fsync",
        "fdatasync",
        "replace",
        "unlink",
        "mkdir",
    )

    def __init__(self, folder: Path, cut_at: int, chance: random.Random, image: Path) -> None:
        self.asked = 0
        self.synced: dict[int, bytes] = {}
        """What of each file, by inode, is on the disk for certain."""
        self.names: dict[str, int] = {}
        self.moves: list[tuple[str, int | None]] = []
        self._folder, self._cut_at, self._chance, self._image = folder, cut_at, chance, image
        self._real = {name: getattr(os, name) for name in self.WATCHED}
        self._files: dict[int, Path] = {}
        self._cut = False

    @contextmanager
    def watched(self) -> Iterator[None]:
        for name in self.WATCHED:
            setattr(os, name, self._asked(name))
        try:
            yield
        finally:
            for name, real in self._real.items():
                setattr(os, name, real)

    def cut(self) -> None:
        """Build the image that the power cut leaves."""
        self._cut = True
        names = dict(self.names)
        for name, inode in self.moves:
            if self._chance.random() < 0.5:
                names = (
                    {**names, name: inode}
                    if inode is not None
                    else {k: v for k, v in names.items() if k != name}
                )
        current = self._contents()
        for name, inode in names.items():
            written = self._mixed(
                self.synced.get(inode, b""), current.get(inode, self.synced.get(inode, b""))
            )
            (self._image / name).write_bytes(written)

    def _contents(self) -> dict[int, bytes]:
        # a file that was deleted may come back with what was on the disk
        return {**self.synced, **{path.stat().st_ino: path.read_bytes() for path in self._folder.iterdir()}}

    def _mixed(self, old: bytes, new: bytes) -> bytes:
        size = self._chance.choice(
            (len(old), len(new), self._chance.randint(min(len(old), len(new)), max(len(old), len(new))))
        )
        mixed = bytearray(max(len(old), len(new)))
        mixed[: len(old)] = old
        share = self._chance.choice((0.0, 0.2, 0.5, 0.8, 1.0))
        changed = [
            at
            for at in range(0, len(new), PAGE_BYTES)
            if new[at : at + PAGE_BYTES] != bytes(mixed[at : at + PAGE_BYTES])
        ]
        for at in changed:
            if self._chance.random() < share:
                mixed[at : at + PAGE_BYTES] = new[at : at + PAGE_BYTES]
        if changed:
            torn = self._chance.choice(changed)
            end = min(torn + self._chance.randrange(0, PAGE_BYTES, SECTOR_BYTES), len(new))
            mixed[torn:end] = new[torn:end]
        return bytes(mixed[:size])

    def _asked(self, name: str) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            if self._cut:
                raise PowerCut
            self.asked += 1
            if self.asked == self._cut_at:
                self.cut()
                raise PowerCut
            before = self._inodes() if name in ("open", "replace", "unlink") else {}
            done = self._real[name](*given, **named)
            if name in ("fsync", "fdatasync"):
                self._synced(given[0])
            elif before or name in ("open", "replace", "unlink"):
                self._moved(before, self._inodes())
            return done

        return call

    def _inodes(self) -> dict[str, int]:
        return {path.name: path.stat().st_ino for path in self._folder.iterdir()}

    def _moved(self, before: dict[str, int], after: dict[str, int]) -> None:
        for name in sorted(before.keys() | after.keys()):
            if before.get(name) != after.get(name):
                self.moves.append((name, after.get(name)))

    def _synced(self, descriptor: int) -> None:
        status = os.fstat(descriptor)
        for path in self._folder.iterdir():
            if path.stat().st_ino == status.st_ino:
                self.synced[status.st_ino] = path.read_bytes()
        if status.st_ino == self._folder.stat().st_ino:
            self.names, self.moves = self._inodes(), []


def cuts(count: int, folder: Path, seed: int) -> Tally:
    """Cut the power at `count` random instants."""
    chance, tally = random.Random(seed), Tally()
    asked = _cut_run(folder / "whole", folder / "none", 1, 0, chance, Tally())
    instants = ((1, asked), (1, 15), (asked - 15, asked))  # anywhere, while it is made, while it is closed
    for run in range(1, count + 1):
        cut_at = chance.randint(*instants[run % 3])
        _cut_run(folder / f"cut{run}", folder / f"image{run}", run, cut_at, chance, tally)
        tally.tried += 1
    return tally


def _cut_run(place: Path, image: Path, run: int, cut_at: int, chance: random.Random, tally: Tally) -> int:
    place.mkdir()
    image.mkdir()
    disk = Disk(place, cut_at, chance, image)
    handed_s = synced_s = 0.0
    number, begun = 0, False
    attributes = {"strategy": f"run{run}", "target_deg": 1.0, "parameters": ""}
    try:
        with disk.watched():
            # one rhythm of syncs in virtual time, kept below instead of by the writer's own thread
            writer = RunWriter(place / "run.h5", attributes, run_tables(4), sync_interval_s=1e6)
            begun, time_s = True, 1.0
            for batch in range(40):
                rows = [raw_at(time_s + n * TICK_S / RAW_PER_TICK, number + n, run) for n in range(50)]
                writer.append("torque", rows)
                ticks = np.zeros(10, run_tables(4)["ticks"])
                ticks["time_s"], ticks["torque_nm"] = time_s + np.arange(10) * TICK_S, run * 1e-3
                writer.append("ticks", ticks)
                number, time_s = number + 50, time_s + 0.05
                handed_s = rows[-1][0]
                if batch % 2:
                    writer.sync()
                    synced_s = handed_s
            writer.close({"status": "aligned"})
    except PowerCut:
        pass
    if cut_at == 0:
        return disk.asked
    tally.count(
        "cut " + ("while it is made" if not begun else "in the run" if number < 2000 else "at the end")
    )
    found = [one.path for one in list_runs(image)]
    if not begun:  # the run was never told to have begun: what is left of it must only do no harm
        close_left(image, tally)
        tally.wrong += [f"{path}: rows of a run that never began" for path in found if path.exists()]
        return disk.asked
    if not found:
        tally.wrong.append(f"{image}: nothing is left of the run")
        return disk.asked
    last_s = judge(found[0], run, tally)
    if synced_s and not last_s >= synced_s:
        tally.wrong.append(f"{image}: ends at {last_s}, but was synced until {synced_s}")
    tally.lost_s.append(max(0.0, handed_s - last_s) if last_s == last_s else handed_s - 1.0)
    close_left(image, tally)
    if last_s == last_s:  # else it had no row, and is taken away
        judge(found[0], run, tally)
    for one in (place, image):
        shutil.rmtree(one)
    return disk.asked


FAULTS = {"kills": (kills, 50), "full": (full, 10), "cuts": (cuts, 10)}


def plan(given: Namespace) -> list[Row]:
    seeds = range(given.first_seed, given.first_seed + given.size)
    return [{"fault": name, "seed": s, "count": count} for s in seeds for name, (_, count) in FAULTS.items()]


def ask(task: Row, _: Namespace) -> Row:
    with tempfile.TemporaryDirectory(prefix="recording-faults-") as folder:
        made, _count = FAULTS[task["fault"]]
        return {"tally": dataclasses.asdict(made(task["count"], Path(folder), task["seed"]))}


def tallies(rows: list[Row]) -> dict[str, Tally]:
    """What each fault did, over all rows."""
    found = {fault: Tally() for fault in FAULTS}
    for row in answered(rows):
        found[row["fault"]].add(Tally(**row["tally"]))
    return found


def table(rows: list[Row], _: Namespace) -> str:
    """What each fault left."""
    heads = ["fault", "tried", "lost s, median", "lost s, at most", "zero rows", "rows of another run"]
    heads += ["rows back in time", "rows missing in between", "files that do not open", "torn ends seen"]
    lines, notes = [], [""]
    for fault, t in tallies(rows).items():
        lost = t.lost_s or [0.0]
        counts = (t.zero_rows, t.foreign_rows, t.backward_rows, t.missing_rows, t.unopened, t.torn_seen)
        times = (f"{statistics.median(lost):.3f}", f"{max(lost):.3f}")
        lines.append((fault, t.tried, *times, *counts, len(t.wrong)))
        notes += [f"- {fault}: {what} {number}" for what, number in sorted(t.counts.items())]
        notes += [f"- {fault}: {what}" for what in t.wrong[:9]]
    return "\n".join([markdown([*heads, "otherwise wrong"], lines), *notes])


def failed(rows: list[Row]) -> bool:
    return not all(tally.good for tally in tallies(rows).values())


# rows mostly wait
SIZE = "rows of 50 kills, of 10 full disks and of 10 power cuts (20)"
CAMPAIGN = Campaign(__doc__, plan, ask, table, 20, SIZE, failed=failed, jobs=8)
