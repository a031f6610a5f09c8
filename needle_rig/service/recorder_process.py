"""The recorder: reads rows from its standard input and keeps the run file, in a process of its own.

Messages are pickled tuples from the daemon that started it: begin, rows, event, finish, discard; of
these begin, finish and discard are answered by a JSON line. When the daemon dies the pipe ends, and the run
is closed with an event that says so.
"""

from __future__ import annotations

import json
import pickle
import signal
import sys
from pathlib import Path
from typing import Any, BinaryIO, TextIO

from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.recording import RunWriter, new_run, run_attributes, run_tables, sample_row


class Keeper:
    """Works off messages; at most one run is open."""

    def __init__(self, replies: TextIO) -> None:
        self._replies = replies
        self._writer: RunWriter | None = None
        self._last_s = 0.0

    def take(self, what: str, *content: Any) -> None:
        """One message. A failure is answered, and ends the run's record."""
        try:
            getattr(self, what)(*content)
        except (OSError, NeedleRigError) as error:
            self._writer = None
            bad = what == "begin" and isinstance(error, BadInput)
            self._answer(
                error=str(error) if bad else f"the run cannot be recorded: {error}",
                exit_code=(BadInput if bad else RigFault).exit_code,
            )

    def begin(self, directory: Path, config: RigConfig, request: dict[str, Any]) -> None:
        """Open a new run."""
        tables = run_tables(len(config.layout.hall_sensors))
        self._writer = new_run(directory, run_attributes(config, **request), tables)
        self._answer(opened=str(self._writer.path))

    def rows(self, rows: dict[str, list[Any]]) -> None:
        """Add rows by table: samples to `ticks`, flat tuples to the others."""
        if self._writer is None:
            return
        for table, new in rows.items():
            if table == "ticks":
                self._last_s = new[-1].time_s
                new = [sample_row(sample) for sample in new]
            self._writer.append(table, new)

    def event(self, time_s: float, kind: str, text: str) -> None:
        """Note an event."""
        if self._writer is not None:
            self._writer.event(time_s, kind, text)

    def finish(self, result: dict[str, Any], time_s: float) -> None:
        """Close the run whole."""
        writer, self._writer = self._writer, None
        if writer is None:
            raise RigFault("its file is not open any more")
        writer.close(result, time_s=time_s)
        self._answer(closed=str(writer.path))

    def discard(self) -> None:
        """Take the run away."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()
            writer.path.unlink()
        self._answer(discarded=True)

    def orphaned(self) -> None:
        """The daemon is gone."""
        if self._writer is not None:
            self._writer.event(self._last_s, "recorder", "the daemon ended without closing the run")
            self._writer.close(time_s=self._last_s)

    def _answer(self, **content: Any) -> None:
        print(json.dumps(content), file=self._replies, flush=True)


def main(messages: BinaryIO, replies: TextIO) -> None:
    """Work off messages until the pipe ends."""
    keeper = Keeper(replies)
    while True:
        try:
            keeper.take(*pickle.load(messages))
        except (EOFError, pickle.UnpicklingError):  # a daemon killed in mid-message leaves half of one
            break
    keeper.orphaned()


if __name__ == "__main__":
    # the daemon decides when the record ends, not a Ctrl-C or a signal to the whole group
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    main(sys.stdin.buffer, sys.stdout)
