"""Runs on disk: one HDF5 file a run, a journal while it goes on; both are read alike."""

from needle_rig.recording.catalogue import (
    RunSummary,
    changed_in,
    find_run,
    is_run_file,
    list_runs,
    remove_empty_runs,
    run_summary,
    runs_in,
    runs_in_journals,
    unfinished_runs,
)
from needle_rig.recording.journal import journal_path
from needle_rig.recording.liveness import being_written
from needle_rig.recording.reader import Event, RunFile
from needle_rig.recording.retention import kept_text, mark_read, retain, size_bytes, to_remove
from needle_rig.recording.tables import run_attributes, run_tables, sample_row
from needle_rig.recording.writer import NotWritten, RunWriter, new_run

__all__ = [
    "Event",
    "NotWritten",
    "RunFile",
    "RunSummary",
    "RunWriter",
    "being_written",
    "changed_in",
    "find_run",
    "is_run_file",
    "journal_path",
    "kept_text",
    "list_runs",
    "mark_read",
    "new_run",
    "remove_empty_runs",
    "retain",
    "run_attributes",
    "run_summary",
    "run_tables",
    "runs_in",
    "runs_in_journals",
    "sample_row",
    "size_bytes",
    "to_remove",
    "unfinished_runs",
]
