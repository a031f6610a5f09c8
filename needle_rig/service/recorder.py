"""The daemon's end of the recorder: hands rows to another process through a pipe, and never waits for it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import pickle
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, RigFault
from needle_rig.records import Sample

BACKLOG_LIMIT_BYTES = 64 * 2**20
_BATCH_S = 0.05
_REPLY_TIMEOUT_S = 10.0

Row = tuple[float, ...]


class Recorder:
    """Writes one run file at a time in a process of its own, which ends when this one does.

    `on_failure` receives one sentence when the record can no longer be kept (disk full, writer gone).
    """

    def __init__(self, on_failure: Callable[[str], None]) -> None:
        self._on_failure = on_failure
        self._process: asyncio.subprocess.Process | None = None
        self._listening: asyncio.Task[None] | None = None
        self._reply: asyncio.Future[dict[str, Any]] | None = None
        self._rows: dict[str, list[Any]] = {}
        self._sent_s = 0.0
        self._open = False
        self.lost_rows = 0
        """Rows of the present run that were thrown away because the writer was too slow."""

    async def start(self) -> None:
        """Start the writing process; it gets ready while the daemon goes on."""
        self._process = process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "needle_rig.service.recorder_process"),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
        )
        self._listening = asyncio.create_task(self._listen(process), name="recorder replies")

    async def begin(self, directory: Path, config: RigConfig, request: Mapping[str, Any]) -> Path:
        """Begin a run file in `directory` and return its path; BadInput when it cannot be made there.

        `request` has what `recording.run_attributes` wants beside the config.
        """
        self.lost_rows = 0
        path = Path((await self._ask("begin", directory, config, dict(request)))["opened"])
        self._open = True
        return path

    def sample(self, sample: Sample) -> None:
        """Record one tick."""
        if self._open:
            self._rows.setdefault("ticks", []).append(sample)
            now_s = time.monotonic()
            if now_s - self._sent_s >= _BATCH_S:
                self._sent_s = now_s
                self._send_rows()

    def raw(self, source: str, row: Row) -> None:
        """Record one raw reading (see `rig.RawReadings`)."""
        if self._open:
            self._rows.setdefault(source, []).append(row)

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Note one event of the open run."""
        if self._open:
            self._send("event", time_s, kind, text)

    async def finish(self, result: Mapping[str, Any], time_s: float) -> None:
        """Write what is left and the result, and wait until the file is whole; RigFault when it cannot be."""
        if not self._open:
            return
        self._send_rows()
        if self.lost_rows:
            self.event(time_s, "lost", f"{self.lost_rows} rows: the writer was too slow")
        self._open = False
        await self._ask("finish", dict(result), time_s)

    async def discard(self) -> None:
        """Remove the open run: it never began."""
        self._open = False
        self._rows = {}
        await self._ask("discard")

    async def close(self) -> None:
        """Let the writer finish and end it; safe to call twice."""
        process, self._process = self._process, None
        if process is None or process.stdin is None:
            return
        process.stdin.close()
        try:
            await asyncio.wait_for(process.wait(), _REPLY_TIMEOUT_S)
        except TimeoutError:
            process.kill()
            await process.wait()
        if self._listening is not None:
            await self._listening

    def _send_rows(self) -> None:
        rows, self._rows = self._rows, {}
        if self._backlog_bytes() > BACKLOG_LIMIT_BYTES:
            self.lost_rows += sum(map(len, rows.values()))
        else:
            self._send("rows", rows)

    def _backlog_bytes(self) -> int:
        if self._process is None or self._process.stdin is None:
            return 0
        return self._process.stdin.transport.get_write_buffer_size()

    def _send(self, *message: Any) -> None:
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.write(pickle.dumps(message, protocol=pickle.HIGHEST_PROTOCOL))

    async def _ask(self, *message: Any) -> dict[str, Any]:
        self._reply = asyncio.get_running_loop().create_future()
        if self._listening is None or self._listening.done():
            raise RigFault("the recorder has ended; start the daemon again")
        self._send(*message)
        try:
            reply = await asyncio.wait_for(self._reply, _REPLY_TIMEOUT_S)
        except TimeoutError:
            raise RigFault(
                f"the recorder did not answer within {_REPLY_TIMEOUT_S:g} s; look at the disk of the runs"
            ) from None
        finally:
            self._reply = None
        if "error" in reply:
            raise (BadInput if reply["exit_code"] == BadInput.exit_code else RigFault)(reply["error"])
        return reply

    async def _listen(self, process: asyncio.subprocess.Process) -> None:
        assert process.stdout is not None
        async for line in process.stdout:
            self._take(json.loads(line))
        if self._open or self._reply is not None:
            self._take({"error": "the recorder ended before the run did", "exit_code": RigFault.exit_code})

    def _take(self, reply: dict[str, Any]) -> None:
        if self._reply is not None:
            with contextlib.suppress(asyncio.InvalidStateError):
                self._reply.set_result(reply)
        elif "error" in reply:
            self._open = False
            self._on_failure(reply["error"])
