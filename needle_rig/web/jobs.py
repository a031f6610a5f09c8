"""Long work in processes of its own, which can be ended at any time: what runs, how far, what came.

A job is of its data, its model and its question, by their hashes: whoever asks the same gets the same job, in
another tab, after a reload, and after a restart of the server.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import re
import secrets
import shutil
import signal
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from needle_rig.config.places import show_path
from needle_rig.errors import BadInput
from needle_rig.model import parameter_sets
from needle_rig.web.bounds import RUNNING, told
from needle_rig.web.places import DATASET_KINDS, SCRATCH_KINDS
from needle_rig.web.sources import free_name
from needle_rig.web.store import Store, seal

Document = dict[str, Any]
WAITING = 20
KEPT = 300
"""Results that are kept; models, imports and laws are kept until a person removes them."""
TOLD = 30
"""Jobs that the page hears of without asking for them."""
LINE_BYTES = 64 << 20
"""A line of a job's answer: a comparison of 12 trials of 9 channels takes 3 MB."""
CLOSED = "needle-rig web was closed while this ran; start it again"
MODELS = frozenset({"adopt", "add_effect", "take_values", "open", "undo"})
"""Kinds whose result is a model; that of an undo may be the null model, which has no name."""
LASTING = MODELS | DATASET_KINDS | {"learn"}

State = Literal["waiting", "running", "done", "failed", "cancelled"]


@dataclass(frozen=True)
class Subject:
    """What a job is of: data by key and name, a model by key and name, and what was asked of them."""

    kind: str
    data: tuple[tuple[str, str], ...] = ()
    model: tuple[str, str] | None = None
    question: str = ""
    """What was asked, as one text: the same text of the same data and model is the same job."""
    hashes: tuple[str, str] = ("", "")
    """Of data and model."""
    asked: Mapping[str, Any] = field(default_factory=dict)
    """The fields of the request that the page shows again."""
    drafts: tuple[str, ...] = ()
    """Jobs whose learnt laws the model needs."""


@dataclass
class Job:
    """One piece of work: its progress while it runs; its result lies in the store."""

    key: str
    of: Subject
    folder: Path
    state: State = "waiting"
    step: str = "waiting for the work before it"
    done: int = 0
    total: int = 0
    begun_utc_s: float = field(default_factory=time.time)
    asked_utc_s: float = field(default_factory=time.time)
    step_begun_s: float = field(default_factory=time.monotonic)
    ended_utc_s: float | None = None
    name: str = ""
    """Of the model or the dataset that it made."""
    added: list[str] = field(default_factory=list)
    """Effects of that model."""
    error: str = ""
    result: Document | None = None
    process: asyncio.subprocess.Process | None = None

    @property
    def alive(self) -> bool:
        """Whether it will still say something."""
        return self.state in ("waiting", "running")

    def as_json(self) -> Document:
        """What the page shows; the time left is that of the present step, None where it is unknown."""
        left_s = None
        if self.state == "running" and 0 < self.done < self.total:
            spent_s = time.monotonic() - self.step_begun_s
            left_s = round(spent_s / self.done * (self.total - self.done), 1)
        return {
            "key": self.key,
            "kind": self.of.kind,
            "data": [{"key": key, "name": name} for key, name in self.of.data],
            "model": None if self.of.model is None else {"key": self.of.model[0], "name": self.of.model[1]},
            "asked": dict(self.of.asked),
            "state": self.state,
            "step": self.step,
            "done": self.done,
            "total": self.total,
            "begun_utc_s": self.begun_utc_s,
            "asked_utc_s": self.asked_utc_s,
            "elapsed_s": round((self.ended_utc_s or time.time()) - self.begun_utc_s, 1),
            "left_s": left_s,
            "name": self.name,
            "added": self.added,
            "error": self.error,
        }

    def kept(self) -> Document:
        """What the store keeps of it."""
        told = {
            n: getattr(self, n) for n in ("state", "begun_utc_s", "ended_utc_s", "name", "added", "error")
        }
        return told | {"of": {n: v for n, v in asdict(self.of).items() if n != "hashes"}}

    def hear(self, said: Mapping[str, Any]) -> None:
        """Take in one line of the worker."""
        match said:
            case {"step": str(step)}:
                self.step, self.done, self.total, self.step_begun_s = step, 0, 0, time.monotonic()
            case {"done": int(done), "total": int(total)}:
                self.done, self.total = done, total
            case {"result": dict(result)}:
                self.result = result  # it is done once its result is kept
            case {"error": str(error)}:
                self.state, self.error = "failed", error


class Jobs:
    """All jobs of one server; those before its start are read from the `store`. `scratch` ends with it."""

    def __init__(self, store: Store, scratch: Path) -> None:
        self._store, self.scratch = store, scratch
        self._jobs: dict[str, Job] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._free = asyncio.Semaphore(RUNNING)
        for key, hashes, asked_utc_s, kept in store.jobs():
            of = kept.pop("of")
            model = None if of["model"] is None else (of["model"][0], of["model"][1])
            data = tuple((pair[0], pair[1]) for pair in of["data"])
            subject = Subject(
                **{**of, "data": data, "model": model, "hashes": hashes, "drafts": tuple(of["drafts"])}
            )
            job = Job(key, subject, self._folder(subject.kind, key), asked_utc_s=asked_utc_s, **kept)
            if job.alive:
                job.state, job.error, job.ended_utc_s = "failed", CLOSED, job.begun_utc_s
            self._jobs[key] = job

    def _folder(self, kind: str, key: str) -> Path:
        """A place of its own: what pickle wrote is never read from a folder that outlives this server."""
        return (self.scratch if kind in SCRATCH_KINDS else self._store.folder) / "jobs" / key

    def new(self, of: Subject) -> tuple[str, Path]:
        """A key and the folder of a job to come."""
        key = secrets.token_hex(8)
        return key, self._folder(of.kind, key)

    def same(self, of: Subject) -> Job | None:
        """The job of this very subject that runs or has its result."""
        for job in reversed(self._jobs.values()):
            if (
                job.of.question == of.question
                and job.of.hashes == of.hashes
                and job.state in ("waiting", "running", "done")
            ):
                if job.state == "done" and not job.folder.is_dir() and of.kind not in SCRATCH_KINDS:
                    continue
                job.asked_utc_s = time.time()
                self._store.touch_job(job.key, job.asked_utc_s)
                return job
        return None

    def start(self, key: str, of: Subject, request: Mapping[str, Any]) -> Job:
        """Begin one in its folder. Raises BadInput when too many wait."""
        waiting = sum(job.state == "waiting" for job in self._jobs.values())
        if waiting >= WAITING:
            raise BadInput(f"{waiting} computations wait already; cancel one")
        self._prune()
        folder = self._folder(of.kind, key)
        folder.mkdir(parents=True, exist_ok=True)
        job = Job(key, of, folder)
        self._store.keep_job(key, of.hashes, job.asked_utc_s, job.kept(), None)
        self._jobs[key] = job
        told = {"kind": of.kind, **request, "out": str(folder)}
        task = asyncio.get_running_loop().create_task(self._run(job, told))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return job

    def _prune(self) -> None:
        ended = [job for job in self._jobs.values() if not job.alive and job.of.kind not in LASTING]
        for job in sorted(ended, key=lambda one: one.asked_utc_s)[: -KEPT or None]:
            self.forget(job.key)

    def forget(self, key: str) -> None:
        """Remove an ended job with its files."""
        job = self._jobs.pop(key)
        self._store.forget_job(key)
        shutil.rmtree(job.folder, ignore_errors=True)

    def all(self) -> list[Job]:
        """In the order in which they began."""
        return list(self._jobs.values())

    def newest_asked(self) -> list[Job]:
        """Those that run, and those that were asked last; the newest last."""
        ordered = sorted(self._jobs.values(), key=lambda job: (job.alive, job.asked_utc_s))
        return ordered[-TOLD:]

    def find(self, key: object) -> Job | None:
        """The job of this key, if there is one."""
        return self._jobs.get(key) if isinstance(key, str) else None

    def get(self, key: str) -> Job:
        """The job of this key; raises BadInput."""
        if key not in self._jobs:
            raise BadInput("this computation is not there any more; start it again")
        return self._jobs[key]

    def newest(self, hashes: tuple[str, str]) -> dict[str, Job]:
        """Of these data and this model, the newest of each kind that runs or has its result."""
        of = [
            job
            for job in self._jobs.values()
            if job.of.hashes == hashes and (job.alive or job.state == "done")
        ]
        return {job.of.kind: job for job in sorted(of, key=lambda one: one.asked_utc_s)}

    def models(self) -> list[Job]:
        """Those that made a model, oldest first."""
        return [
            job for job in self._jobs.values() if job.of.kind in MODELS and job.state == "done" and job.name
        ]

    async def result(self, job: Job) -> bytes:
        """What it found, as JSON."""
        return await asyncio.to_thread(self._store.result, job.key)

    def cancel(self, key: str) -> Job:
        """End a job now, with every process that it started."""
        job = self.get(key)
        if job.alive:
            job.state, job.error, job.ended_utc_s = "cancelled", "cancelled by a person", time.time()
            _kill(job)
        return job

    async def close(self) -> None:
        """End all; what ran can be started again."""
        for job in self._jobs.values():
            if job.alive:
                self.cancel(job.key)
                job.state, job.error = "failed", CLOSED
        if self._tasks:
            await asyncio.wait(self._tasks)

    async def _run(self, job: Job, request: Mapping[str, Any]) -> None:
        async with self._free:
            if job.alive:
                job.state, job.step, job.begun_utc_s = "running", "starting", time.time()
                await self._work(job, request)
        if job.ended_utc_s is None:
            job.ended_utc_s = time.time()
        result, job.result = job.result, None
        if job.state != "running":
            result = None  # it was cancelled at its end
        elif result is not None and job.of.kind in LASTING:
            if job.of.kind != "undo" or result["model"] is not None:
                job.name = self._unique(str(result.get("model") or result.get("name") or job.of.kind), job)
            job.added = list(result.get("added", []))
            if job.of.kind == "learn":
                seal(job.folder)
        state: State = job.state if result is None else "done"
        kept = job.kept() | {"state": state}
        try:
            await asyncio.to_thread(
                self._store.keep_job, job.key, job.of.hashes, job.asked_utc_s, kept, result
            )
            job.state = state
        except BadInput as error:
            job.state, job.error = "failed", str(error)

    def _unique(self, name: str, job: Job) -> str:
        models = job.of.kind in MODELS
        taken = {
            other.name for other in self._jobs.values() if (other.of.kind in MODELS) == models and other.name
        }
        return free_name(name, taken | (parameter_sets().keys() if models else set()))

    async def _work(self, job: Job, request: Mapping[str, Any]) -> None:
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
        if not job.alive:
            _kill(job)
        complaints = asyncio.create_task(process.stderr.read())
        with contextlib.suppress(ConnectionError):
            process.stdin.write(json.dumps(request).encode() + b"\n")
            await process.stdin.drain()
        with contextlib.suppress(ValueError):  # a line beyond the limit
            while line := await process.stdout.readline():
                if job.state == "running":
                    job.hear(self._told(json.loads(line)))
        if job.state == "running" and job.result is None:
            said = (await complaints).decode("utf-8", "replace").strip().splitlines()
            job.state, job.error = "failed", self._inner(told(await process.wait(), said))
        _kill(job)
        await process.wait()
        await complaints

    def _told(self, said: Document) -> Document:
        """Files that a person dropped are named as they were dropped, not where this server keeps them."""
        for name in ("step", "error"):
            if isinstance(said.get(name), str):
                said[name] = self._inner(said[name])
        return said

    def _inner(self, text: str) -> str:
        for root in (self._store.folder, self.scratch):
            for shown in (str(root.absolute()), show_path(root)):
                text = re.sub(rf"{re.escape(shown)}/(uploads|jobs)/[0-9a-f]+(/data)?/?", "", text)
        return text


def _kill(job: Job) -> None:
    """The worker and its children: they are a session of their own."""
    if job.process is not None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(job.process.pid, signal.SIGKILL)
