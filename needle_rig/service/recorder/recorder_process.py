"""The recorder: reads rows from its standard input and keeps the run file, in a process of its own.

Messages are pickled tuples from the daemon that started it: a number, what to do, and the content. One whose
number is not 0 is answered by a JSON line with that number; a line with number 0 says that the process is
ready, or what it could not record. When the daemon dies the pipe ends, and the run is left as unfinished.
"""

from __future__ import annotations

import json
import pickle
import signal
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO

from needle_rig.config.schema import RecordingSection, RigConfig
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.recording import (
    NotWritten,
    RunFile,
    RunWriter,
    new_run,
    remove_empty_runs,
    retain,
    run_attributes,
    run_tables,
    sample_row,
    unfinished_runs,
)
from needle_rig.service.recorder.watch_process import WatchProcess

if TYPE_CHECKING:
    from needle_rig.records import JsonObject
    from needle_rig.service.recorder.recorder_link import Reply

_SENTENCE_LETTERS = 2000


class Keeper:
    """Works off messages; at most one run is open."""

    def __init__(self, replies: TextIO) -> None:
        self._replies = replies
        self._writer: RunWriter | None = None
        self._section = RecordingSection()
        self._watch = WatchProcess()
        self._broken: str | None = None
        """Why rows of the open run are missing."""

    def take(self, number: int, what: str, *content: Any) -> None:
        """One message. A failure is answered, and so is every message that has a number."""
        try:
            answer = getattr(self, what)(*content)
        except Exception as error:  # noqa: BLE001 whatever went wrong, the next message is worked off
            self._failed(number, what, error)
        else:
            if number:
                self._answer(number=number, **answer)

    def begin(self, directory: Path, config: RigConfig, request: Mapping[str, Any]) -> Reply:
        """Open a new run; its path."""
        self._leave()
        remove_empty_runs(directory)
        self._section = config.recording
        tables = run_tables(len(config.layout.hall_sensors))
        self._writer = new_run(directory, run_attributes(config, **request), tables)
        self._broken = None
        return {"opened": str(self._writer.path)}

    def rows(self, rows: dict[str, list[Any]]) -> None:
        """Add rows by table: samples to `ticks`, flat tuples to the others."""
        if self._writer is None or self._broken is not None:
            return
        for table, new in rows.items():
            if table == "ticks":
                new = [sample_row(sample) for sample in new]
            self._writer.append(table, new)

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Note an event."""
        if self._writer is not None:
            self._writer.event(time_s, kind, text)

    def sync(self) -> Reply:
        """An empty reply, once every row is on the disk."""
        if self._writer is not None:
            self._writer.sync()
        return {}

    def finish(self, result: JsonObject, time_s: float) -> Reply:
        """Close the run, whole if no row is missing: its path, removed runs, unread bytes over the limit."""
        writer, self._writer = self._writer, None
        if writer is None:
            raise RigFault("its file is not open any more")
        if self._broken is None:
            writer.close(result, time_s=time_s)
        else:
            writer.close_unfinished(self._broken, result)
        kept = retain(writer.path.parent, self._section.keep_days, self._section.keep_gb)
        if self._section.watch is not None:
            self._watch.start(writer.path.parent)
        return {
            "closed": str(writer.path),
            "removed": [run.name for run in kept.removed],
            "unread_bytes": kept.unread_bytes,
        }

    def discard(self) -> Reply:
        """Take the run away; an empty reply."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.discard()
        return {}

    def recover(self, path: Path, text: str, result: JsonObject | None) -> Reply:
        """Close the run at `path` that another recorder left: whether it is complete, and a sentence on it.

        `text` says why the other could not close it.
        """
        if path.exists() and path not in unfinished_runs(path.parent):
            return {"complete": RunFile(path).complete, "text": f"{path} is closed"}
        writer = RunWriter.resume(path)
        if writer.rows == 0 and result is None:
            writer.discard()
            return {"complete": False, "text": f"{path} had no row and is removed"}
        complete, torn_bytes = writer.complete, writer.torn_bytes
        if torn_bytes:
            text += f"; {torn_bytes} bytes at its end are torn and left out"
        writer.close_unfinished(text, result)
        said = f"{path} is closed" if complete else f"{text}: {path}"
        return {"complete": complete, "text": said, "torn_bytes": torn_bytes}

    def orphaned(self) -> None:
        """The daemon is gone: its run is left for the next daemon to find and tell, and the watch ends."""
        if self._writer is not None:
            with suppress(NeedleRigError):  # there is nobody left to tell
                self._writer.event(
                    self._writer.last_s, "recorder", "the daemon ended without closing the run"
                )
                self._writer.sync()
            self._writer.leave()
        self._watch.end()

    def _leave(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.leave()

    def _failed(self, number: int, what: str, error: Exception) -> None:
        known = isinstance(error, OSError | NeedleRigError)
        text = str(error) if known else f"{type(error).__name__}: {error}"
        sentence = " ".join(text.split())[:_SENTENCE_LETTERS]
        bad = what == "begin" and isinstance(error, BadInput)
        if not bad:
            sentence = f"the run cannot be recorded: {sentence}"
        told = self._broken is not None and number == 0
        if what in ("rows", "event", "sync"):
            self._broken = self._broken or sentence
        if not told:
            kept = {"kept_rows": error.kept_rows} if isinstance(error, NotWritten) else {}
            exit_code = (BadInput if bad else RigFault).exit_code
            self._answer(number=number, error=sentence, exit_code=exit_code, **kept)

    def _answer(self, **content: Any) -> None:
        with suppress(BrokenPipeError):  # the daemon is gone: the messages end with the next one
            print(json.dumps(content), file=self._replies, flush=True)


def main(messages: BinaryIO, replies: TextIO) -> None:
    """Work off messages until the pipe ends."""
    keeper = Keeper(replies)
    print(json.dumps({"number": 0, "ready": True}), file=replies, flush=True)
    while True:
        try:
            message = pickle.load(messages)
        except (EOFError, pickle.UnpicklingError):  # a daemon killed in mid-message leaves half of one
            break
        keeper.take(*message)
    keeper.orphaned()


if __name__ == "__main__":
    # the daemon decides when the record ends, not a Ctrl-C or a signal to the whole group
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    main(sys.stdin.buffer, sys.stdout)
