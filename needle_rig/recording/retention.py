"""Which old runs may go: as the rig file says, and never one that nobody read."""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from needle_rig.recording.journal import journal_path

_READ = ".read"
"""Folder of empty files, one named as each run that was read: who may read a run may not change it."""
_DAY_S = 86_400.0


@dataclass(frozen=True)
class Retained:
    """What was removed, and how much is kept beyond the limit because nobody read it, in bytes."""

    removed: tuple[Path, ...] = ()
    unread_bytes: int = 0


def mark_read(run: Path) -> None:
    """Remember that somebody exported or diagnosed the run file at `run`, where its folder takes that."""
    with suppress(OSError):
        (run.parent / _READ / run.stem).touch()


def was_read(run: Path) -> bool:
    """Whether the run file at `run` was exported or diagnosed."""
    return (run.parent / _READ / run.stem).exists()


def kept_text(keep_days: float | None, keep_gb: float | None) -> str:
    """What the limits do, in a sentence for a person."""
    if keep_days is None and keep_gb is None:
        return "every run stays, until the disk is full (recording.keep_gb)"
    limits = [] if keep_days is None else [f"older than {keep_days:g} days"]
    if keep_gb is not None:
        limits.append(f"the oldest while all runs take more than {keep_gb:g} GB")
    return f"runs that were exported or diagnosed are removed: {', and '.join(limits)}"


def to_remove(
    directory: Path, keep_days: float | None, keep_gb: float | None, now_s: float | None = None
) -> list[Path]:
    """The runs that `retain` would remove now, the oldest first."""
    now_s = time.time() if now_s is None else now_s
    runs = sorted(directory.glob("*.h5"), key=lambda run: (_changed_s(run), run.name))
    left_bytes, limit_bytes = sum(map(size_bytes, runs)), _limit_bytes(keep_gb)
    going: list[Path] = []
    for run in runs[:-1]:
        old = keep_days is not None and now_s - _changed_s(run) > keep_days * _DAY_S
        if (old or left_bytes > limit_bytes) and was_read(run) and not journal_path(run).exists():
            going.append(run)
            left_bytes -= size_bytes(run)
    return going


def retain(
    directory: Path, keep_days: float | None, keep_gb: float | None, now_s: float | None = None
) -> Retained:
    """Remove runs of `directory` that were read: those older than `keep_days`, the oldest beyond `keep_gb`.

    Gives what was removed. The newest run stays, and one that is not closed. From the first call with a limit
    on, the folder's group may mark runs as read. `now_s` is the time of day in seconds since 1970.
    """
    if keep_days is None and keep_gb is None:
        return Retained()
    with suppress(OSError):  # where that cannot be, nothing counts as read, and all stays
        (directory / _READ).mkdir(exist_ok=True)
        (directory / _READ).chmod(0o770)
    removed: list[Path] = []
    for run in to_remove(directory, keep_days, keep_gb, now_s):
        with suppress(OSError):
            run.unlink()
            removed.append(run)
            run.with_suffix(".png").unlink(missing_ok=True)
            (directory / _READ / run.stem).unlink()
    left_bytes = sum(map(size_bytes, directory.glob("*.h5")))
    return Retained(tuple(removed), int(max(left_bytes - _limit_bytes(keep_gb), 0)))


def size_bytes(run: Path) -> int:
    """Of a run file with its picture; 0 where it is gone."""
    found = 0
    for path in (run, run.with_suffix(".png")):
        with suppress(OSError):
            found += path.stat().st_size
    return found


def _limit_bytes(keep_gb: float | None) -> float:
    return float("inf") if keep_gb is None else keep_gb * 1e9


def _changed_s(run: Path) -> float:
    with suppress(OSError):
        return run.stat().st_mtime
    return 0.0
