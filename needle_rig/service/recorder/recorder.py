"""The daemon's end of the recorder: hands rows to another process through a pipe, and never waits for it."""

from __future__ import annotations

import asyncio
import datetime
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import structlog

from needle_rig.config.schema import RigConfig
from needle_rig.errors import NeedleRigError, RigFault
from needle_rig.recording import being_written, journal_path, runs_in_journals
from needle_rig.records import Sample
from needle_rig.service.recorder.recorder_link import Gone, RecorderLink, Reply

log = structlog.get_logger("recorder")

BACKLOG_LIMIT_BYTES = 64 * 2**20
SLOWEST_DISK_BYTES_S = 10e6
"""A disk that takes less than this is as good as none: how long a long run may take to close."""

_BATCH_S = 0.05
_CHECK_S = 1.0
_REPLY_TIMEOUT_S = 10.0
_LAST_WORDS_S = 5.0
"""A recorder whose daemon is gone ends at once, but for what a slow disk makes of its last sync."""

Row = tuple[float, ...]


class Recorder:
    """Writes one run file at a time in a process of its own, which ends when this one does.

    `on_failure` receives one sentence when the record of the open run can no longer be kept (disk full,
    process gone or stalled); `finish` closes the run all the same. A process that is gone is replaced when it
    is needed.
    """

    def __init__(self, on_failure: Callable[[str], None]) -> None:
        self._on_failure = on_failure
        self._links: list[RecorderLink] = []
        self._asking = asyncio.Lock()
        self._checking: asyncio.Task[None] | None = None
        self._closing_left: asyncio.Task[None] | None = None
        self._rows: dict[str, list[Any]] = {}
        self._sent_s = self._checked_s = 0.0
        self._path: Path | None = None
        self._recording = False
        self._lost: str | None = None
        self._run_bytes = 0
        self.lost_rows = 0
        """Rows of the present run that were thrown away because the writer was too slow."""
        self.crowded: str | None = None
        """Why runs take more room than they may, for a person."""
        self.unfinished: list[dict[str, str]] = []
        """Runs that were found cut off: `run`, `found_utc` and `text`, which is empty until it is closed."""

    async def start(self, directory: Path) -> None:
        """Start the process, and let it close the runs in `directory` that were left unfinished."""
        await self._linked()
        left = runs_in_journals(directory)
        if left:
            self._closing_left = asyncio.create_task(self._close_left(left), name="close unfinished runs")

    async def begin(self, directory: Path, config: RigConfig, request: Mapping[str, Any]) -> Path:
        """Begin a run in `directory` and return the path of its file.

        `request` has what `recording.run_attributes` wants beside the config. Raises BadInput when it or the
        folder cannot be used, before a file is made, and RigFault when the disk or the process fails.
        """
        self._path = Path((await self._ask("begin", directory, config, dict(request)))["opened"])
        self._recording = True
        self._lost = None
        self._rows = {}
        self._run_bytes = self.lost_rows = 0
        self._checked_s = time.monotonic()
        return self._path

    def sample(self, sample: Sample) -> None:
        """Record one tick."""
        if self._recording:
            self._rows.setdefault("ticks", []).append(sample)
            now_s = time.monotonic()
            if now_s - self._sent_s >= _BATCH_S:
                self._sent_s = now_s
                self._send_rows()
            if now_s - self._checked_s >= _CHECK_S and (self._checking is None or self._checking.done()):
                self._checked_s = now_s
                self._checking = asyncio.create_task(self._check(), name="check recorder")

    def raw(self, source: str, row: Row) -> None:
        """Record one raw reading (see `rig.RawReadings`)."""
        if self._recording:
            self._rows.setdefault(source, []).append(row)

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Note one event of the open run."""
        if self._path is not None and self._link is not None:
            self._link.send("event", time_s, kind, text)

    async def finish(self, result: Mapping[str, Any], time_s: float) -> None:
        """Write the rest and the result, and wait until the file is whole; RigFault when it cannot be.

        A run whose process is gone is closed by another one, as far as it came.
        """
        if self._path is None:
            return
        if self._recording:
            self._send_rows()
            if self.lost_rows:
                self.event(time_s, "lost", f"{self.lost_rows} rows: the writer was too slow")
        path, self._path, self._recording = self._path, None, False
        if self._lost is None:
            try:
                closed = await self._ask("finish", dict(result), time_s, work_bytes=self._run_bytes)
                self._tell_kept(closed["removed"], closed["unread_bytes"])
            except Gone as gone:
                answer = await self._recover(path, str(gone), result)
                if not answer["complete"]:
                    raise RigFault(f"{gone}; what it had written is in {path}") from None
        else:
            await self._recover(path, self._lost, result)

    def _tell_kept(self, removed: list[str], unread_bytes: int) -> None:
        if removed:
            log.info("old runs removed", runs=removed)
        self.crowded = (
            f"runs take {unread_bytes / 1e9:.3g} GB more than recording.keep_gb, and nobody read them:"
            " needle-rig export"
            if unread_bytes
            else None
        )

    async def discard(self) -> None:
        """Remove the open run: it never began."""
        self._path, self._recording, self._rows = None, False, {}
        with suppress(Gone):  # the next start removes a run without a row
            await self._ask("discard")

    async def close(self) -> None:
        """Let the writer finish and end it; safe to call twice."""
        self._recording = False
        for task in (self._checking, self._closing_left):
            if task is not None:
                task.cancel()
                await asyncio.gather(task, return_exceptions=True)
        links, self._links = self._links, []
        for link in links:
            await link.close()

    @property
    def _link(self) -> RecorderLink | None:
        return self._links[-1] if self._links else None

    async def _linked(self) -> RecorderLink:
        if not self._links or self._links[-1].gone:
            # one that was given up may hang on its disk for long: it is waited for at the end alone
            self._links = [link for link in self._links if not link.ended]
            self._links.append(await RecorderLink.start(self._fail, self._on_gone))
        return self._links[-1]

    async def _ask(self, *message: Any, work_bytes: int = 0) -> Reply:
        timeout_s = _REPLY_TIMEOUT_S + work_bytes / SLOWEST_DISK_BYTES_S
        async with self._asking:
            return await (await self._linked()).ask(timeout_s, *message)

    async def _check(self) -> None:
        """Ask whether the rows are on the disk; a process that stalls is killed for it."""
        try:
            await self._ask("sync")
        except NeedleRigError as error:
            self._fail(str(error))

    async def _recover(self, path: Path, text: str, result: Mapping[str, Any] | None = None) -> Reply:
        try:
            size_bytes = journal_path(path).stat().st_size
        except OSError:
            size_bytes = 0
        return await self._ask("recover", path, text, result, work_bytes=size_bytes)

    async def _close_left(self, left: list[Path]) -> None:
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        # the recorder of a daemon that was killed may still write down its last rows; others write their own
        until_s = time.monotonic() + _LAST_WORDS_S
        while time.monotonic() < until_s and any(map(being_written, left)):
            await asyncio.sleep(_BATCH_S)
        left = [path for path in left if journal_path(path).exists() and not being_written(path)]
        self.unfinished += [{"run": str(path), "found_utc": now, "text": ""} for path in left]
        for path, told in zip(left, list(self.unfinished), strict=True):
            log.warning("unfinished run", run=str(path))
            try:
                answer = await self._recover(path, "the daemon or its computer went before the run ended")
                told["text"] = answer["text"]
            except NeedleRigError as error:
                told["text"] = str(error)
            log.warning("unfinished run", run=str(path), text=told["text"])

    def _send_rows(self) -> None:
        rows, self._rows = self._rows, {}
        if self._link is None or self._link.backlog_bytes > BACKLOG_LIMIT_BYTES:
            self.lost_rows += sum(map(len, rows.values()))
        else:
            self._run_bytes += self._link.send("rows", rows)

    def _fail(self, sentence: str) -> None:
        if self._recording:
            self._recording = False
            self._on_failure(sentence)

    def _on_gone(self, sentence: str) -> None:
        if self._path is not None:
            self._lost = self._lost or sentence
        self._fail(sentence)
