"""Runs on disk: one HDF5 file a run, readable while it is written and after its writer was killed."""

from needle_rig.recording.catalogue import RunSummary, find_run, list_runs
from needle_rig.recording.reader import Event, RunFile
from needle_rig.recording.tables import run_attributes, run_tables, sample_row
from needle_rig.recording.writer import RunWriter, new_run

__all__ = [
    "Event",
    "RunFile",
    "RunSummary",
    "RunWriter",
    "find_run",
    "list_runs",
    "new_run",
    "run_attributes",
    "run_tables",
    "sample_row",
]
