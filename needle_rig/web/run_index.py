"""An index of the recorded runs: a run file is read once, and again when it changed."""

from __future__ import annotations

import math
import threading
import time
from pathlib import Path
from typing import Any

from needle_rig.recording import changed_in, run_summary
from needle_rig.web.store import Store

READ_S = 0.3
"""So long one answer reads files that the index lacks; a thread reads the others."""
BATCH = 50
READ_AS = 2
"""What is kept of a run: another number reads all again."""

Document = dict[str, Any]


class RunIndex:
    """Documents of runs by name, with the time and the size of the file that each was read from."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._known = store.runs()
        self._alone = threading.Lock()
        self._reading: threading.Thread | None = None
        self._closed = threading.Event()

    def documents(self, folder: Path) -> tuple[list[Document], int]:
        """Those that were read, and how many are still to be read. Raises BadInput.

        The documents are the index's own: whoever adds to one makes another.
        """
        with self._alone:
            stamps = {
                name: f"{READ_AS}:{changed_ns:020d}:{size}"
                for name, (changed_ns, size) in changed_in(folder).items()
            }
            gone = [name for name in self._known if name not in stamps]
            for name in gone:
                del self._known[name]
            if gone:
                self._store.keep_runs({}, gone)
            # what was recorded last is looked at first
            lacking = sorted(
                (name for name, stamp in stamps.items() if self._known.get(name, ("",))[0] != stamp),
                key=lambda name: stamps[name],
                reverse=True,
            )
            lacking = self._read(folder, {name: stamps[name] for name in lacking}, time.monotonic() + READ_S)
            if lacking and (self._reading is None or not self._reading.is_alive()):
                left = {name: stamps[name] for name in lacking}
                self._reading = threading.Thread(target=self._read_all, args=(folder, left), daemon=True)
                self._reading.start()
            return [document for _, document in self._known.values()], len(lacking)

    def lags(self, folder: Path) -> dict[str, float]:
        """By run, how far the tip lags at its end; without those that are not known yet. Raises BadInput."""
        documents, _ = self.documents(folder)
        return {one["name"]: abs(one["tip_lag_deg"]) for one in documents if one["tip_lag_deg"] is not None}

    def _read(self, folder: Path, wanted: dict[str, str], until_s: float) -> list[str]:
        """Read until then; the names that are left."""
        left, read = list(wanted), {}
        while left and time.monotonic() < until_s and not self._closed.is_set():
            name = left.pop(0)
            stamp, document = wanted[name], read_document(folder / f"{name}.h5")
            if document["status"] != "running":  # it changes without its file's time
                read[name] = (stamp, document)
            self._known[name] = (stamp if name in read else "", document)
        self._store.keep_runs(read, [])
        return left

    def _read_all(self, folder: Path, wanted: dict[str, str]) -> None:
        names = list(wanted)
        for begin in range(0, len(names), BATCH):
            some = {name: wanted[name] for name in names[begin : begin + BATCH]}
            with self._alone:
                self._read(folder, some, math.inf)
            time.sleep(0.01)  # whoever asks meanwhile goes first
            if self._closed.is_set():
                return

    def close(self) -> None:
        """End the reading."""
        self._closed.set()
        if self._reading is not None:
            self._reading.join()


def read_document(path: Path) -> Document:
    """What is listed of one run file."""
    run = run_summary(path)
    return {
        "name": run.name,
        "simulated": run.simulated,
        "started_utc": run.started_utc,
        "target_deg": None if math.isnan(run.target_deg) else run.target_deg,
        "strategy": run.strategy,
        "parameters": run.parameters,
        "status": run.status,
        "duration_s": round(run.duration_s, 1),
        "tip_lag_deg": None if math.isnan(run.tip_lag_deg) else round(run.tip_lag_deg, 2),
    }
