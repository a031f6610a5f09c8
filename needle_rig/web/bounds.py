"""What one job may take of this computer, and what is said of one that wanted more."""

from __future__ import annotations

import os
import resource
import signal

RUNNING = 2
"""Jobs at a time; each takes the cores that the tick leaves. Others wait."""
READING = frozenset({"guess", "import", "open", "show", "export"})
"""Kinds that read what a person dropped; the others compute for as long as a person waits."""
READING_CPU_S = 120
"""The largest drop as text is read in a tenth of it; what takes longer was made to."""
_NEXT = "give less data, or a text file of it"


def memory_bytes() -> int:
    """The share of one job: all together leave this computer its memory."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // (RUNNING + 1)


def bound(kind: str) -> None:
    """Bound this process, and those that it starts, each by itself."""
    # what a library in Rust says of its end is its reason, and not where it stood
    os.environ["RUST_BACKTRACE"] = "0"
    share = memory_bytes()
    resource.setrlimit(resource.RLIMIT_DATA, (share, share))
    if kind in READING:
        resource.setrlimit(resource.RLIMIT_CPU, (READING_CPU_S, READING_CPU_S))


def too_large() -> str:
    """Of a job that asked for more memory than its share."""
    return f"this takes more than {memory_bytes() / 1e9:.1f} GB of memory; {_NEXT}"


def told(code: int | None, complaints: list[str]) -> str:
    """Of a process that ended without a word to the page."""
    if code in (-signal.SIGXCPU, -signal.SIGKILL):
        return f"this takes more than {READING_CPU_S} s of processor time; {_NEXT}"
    if any("memory allocation of" in line for line in complaints):
        return too_large()
    return f"the work ended by itself: {complaints[-1] if complaints else 'it said nothing'}"
