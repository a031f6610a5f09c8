"""Long work in processes of its own, which can be ended at any time: what runs, how far, what came."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from needle_rig.errors import BadInput

Document = dict[str, Any]
RUNNING = 2
"""Jobs at a time; each takes the cores that the tick leaves."""
KEPT = 50
LINE_BYTES = 64 << 20
"""A line of a job's answer: a comparison of 12 trials of 9 channels takes 3 MB."""
CRASHED = "the work ended by itself"


@dataclass
class Job:
    """One piece of work: its progress while it runs, its result or why there is none."""

    kind: str
    state: Literal["running", "done", "failed", "cancelled"] = "running"
    step: str = "starting"
    done: int = 0
    total: int = 0
    begun_s: float = field(default_factory=time.monotonic)
    step_begun_s: float = field(default_factory=time.monotonic)
    ended_s: float | None = None
    result: Document | None = None
    error: str = ""
    process: asyncio.subprocess.Process | None = None

    def as_json(self) -> Document:
        """What the page shows; the time left is that of the present step, None where it cannot be told."""
        now_s = self.ended_s if self.ended_s is not None else time.monotonic()
        left_s = None
        if self.state == "running" and 0 < self.done < self.total:
            left_s = round((now_s - self.step_begun_s) / self.done * (self.total - self.done), 1)
        return {
            "kind": self.kind,
            "state": self.state,
            "step": self.step,
            "done": self.done,
            "total": self.total,
            "elapsed_s": round(now_s - self.begun_s, 1),
            "left_s": left_s,
            "error": self.error,
            "result": self.result,
        }

    def hear(self, said: Mapping[str, Any]) -> None:
        """Take in one line of the worker."""
        match said:
            case {"step": str(step)}:
                self.step, self.done, self.total, self.step_begun_s = step, 0, 0, time.monotonic()
            case {"done": int(done), "total": int(total)}:
                self.done, self.total = done, total
            case {"result": dict(result)}:
                self.state, self.result = "done", result
            case {"error": str(error)}:
                self.state, self.error = "failed", error


class Jobs:
    """All jobs of one server."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}
        self._tasks: set[asyncio.Task[None]] = set()

    def start(self, kind: str, request: Mapping[str, Any]) -> str:
        """Begin one: its key. Raises BadInput when others run."""
        running = sum(job.state == "running" for job in self._jobs.values())
        if running >= RUNNING:
            raise BadInput(f"{running} computations run already; wait for one, or cancel it")
        for old in [key for key, job in self._jobs.items() if job.state != "running"][: -KEPT or None]:
            del self._jobs[old]
        key = secrets.token_hex(8)
        job = self._jobs[key] = Job(kind)
        task = asyncio.get_running_loop().create_task(self._run(job, {"kind": kind, **request}))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return key

    def get(self, key: str) -> Job:
        """The job of this key; raises BadInput."""
        if key not in self._jobs:
            raise BadInput("this computation is not there any more; start it again")
        return self._jobs[key]

    def cancel(self, key: str) -> Job:
        """End a job now, with every process that it started."""
        job = self.get(key)
        if job.state == "running":
            job.state, job.error, job.ended_s = "cancelled", "cancelled by a person", time.monotonic()
            _kill(job)
        return job

    async def close(self) -> None:
        """End all."""
        for key in self._jobs:
            self.cancel(key)
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _run(self, job: Job, request: Mapping[str, Any]) -> None:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "needle_rig.web.worker"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
            limit=LINE_BYTES,
            start_new_session=True,
        )
        job.process = process
        assert process.stdin is not None
        assert process.stdout is not None
        assert process.stderr is not None
        if job.state != "running":
            _kill(job)
        complaints = asyncio.create_task(process.stderr.read())
        with contextlib.suppress(ConnectionError):
            process.stdin.write(json.dumps(request).encode() + b"\n")
            await process.stdin.drain()
        with contextlib.suppress(ValueError):  # a line beyond the limit
            while line := await process.stdout.readline():
                if job.state == "running":
                    job.hear(json.loads(line))
        if job.state == "running":
            said = (await complaints).decode("utf-8", "replace").strip().splitlines()
            job.state, job.error = "failed", f"{CRASHED}: {said[-1] if said else 'it said nothing'}"
        if job.ended_s is None:
            job.ended_s = time.monotonic()
        _kill(job)
        await process.wait()
        await complaints


def _kill(job: Job) -> None:
    """The worker and its children: they are a session of their own."""
    if job.process is not None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(job.process.pid, signal.SIGKILL)
