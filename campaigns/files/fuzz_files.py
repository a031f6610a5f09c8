"""Damages files and requests of every kind and counts how the commands that read them end.

Each command runs in a process of its own. Bad is an exit code other than 0 to 4, a traceback, more than 60 s,
more than 2 GB, and a signal. The file that did it is kept in `--keep`, and the exit code is then 1.
`--where "kind=run: a bit"` asks for one kind.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import random
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import traceback
from argparse import Namespace
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from campaigns import ROOT
from campaigns.files import fuzz_kinds
from campaigns.run import Campaign, Row, answered, markdown

LONGEST_S = 60.0
FIRST_START_S = 600.0
"""For the undamaged files: a fresh checkout compiles its solver first."""
MOST_MB = 2048.0
CODES = (0, 1, 2, 3, 4)
EFFECT = ROOT / "tests/data/effects/slit_membrane.py"
TOLD_BYTES = 4000


@dataclass(frozen=True)
class End:
    """How a command ended."""

    code: int
    wall_s: float
    memory_mb: float
    said: str

    @property
    def bad(self) -> bool:
        broken = self.code not in CODES or "Traceback" in self.said
        return broken or self.wall_s > LONGEST_S or self.memory_mb > MOST_MB


def isolated(action: Callable[[], int], out: Path, longest_s: float | None = None) -> End:
    """Runs `action` in a process of its own, whose end, time, memory and words come back."""
    began_s = time.monotonic()
    child = os.fork()
    if child == 0:
        _be_child(action, out)
    waiting = os.pidfd_open(child)
    try:
        if not select.select([waiting], [], [], longest_s or LONGEST_S)[0]:
            os.killpg(child, signal.SIGKILL)
        _, status, usage = os.wait4(child, 0)
    finally:
        os.close(waiting)
    said = out.read_bytes()[-TOLD_BYTES:].decode("utf-8", "replace")
    # a run that was killed at the limit lasted longer than it
    wall_s = time.monotonic() - began_s
    return End(os.waitstatus_to_exitcode(status), wall_s, usage.ru_maxrss / 1024, said)


def _be_child(action: Callable[[], int], out: Path) -> None:
    code = 99
    try:
        os.setsid()
        written = os.open(out, os.O_CREAT | os.O_TRUNC | os.O_WRONLY)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(written, 1)
        os.dup2(written, 2)
        own_bytes = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        most_bytes = own_bytes + int(2 * MOST_MB) * 2**20
        resource.setrlimit(resource.RLIMIT_AS, (most_bytes, most_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        code = action()
    except BaseException:  # noqa: BLE001 it is what is looked for
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def made_seeds(work: Path) -> fuzz_kinds.Seeds:
    """The undamaged files, made and read once. Raises RuntimeError when that fails."""
    seeds = fuzz_kinds.Seeds(work / "seeds", EFFECT)

    def make_seeds() -> int:
        seeds.make()
        return 0

    made = isolated(make_seeds, work / "out.txt", FIRST_START_S)
    if made.code != 0:
        raise RuntimeError(f"the undamaged files could not be made (exit {made.code}): {made.said}")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        if not seeds.warm(work / "warm"):
            raise RuntimeError(said.getvalue())
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # commands make it a KeyboardInterrupt
    return seeds


def fuzzed(task: Row, seeds: fuzz_kinds.Seeds, work: Path, keep: Path) -> Row:
    """How the commands of a kind's mutations end; files of bad ends are copied to `keep`."""
    kind, seed = task["kind"], task["seed"]
    ends: list[End] = []
    bad: list[str] = []
    for number in range(task["mutations"]):
        here = work / "here"
        here.mkdir()
        how, actions = fuzz_kinds.kinds()[kind][1](
            seeds, here, random.Random(f"{seed} {kind} {number}"), number
        )
        for name, action in actions:
            end = isolated(action, work / "out.txt")
            ends.append(end)
            if end.bad:
                kept = keep / f"{seed}-{kind}-{number}".replace(" ", "_").replace(":", "")
                shutil.rmtree(kept, ignore_errors=True)
                shutil.copytree(here, kept, symlinks=True, ignore=_special)
                told = end.said.strip().splitlines()[-1:] or [""]
                bad.append(f"{kind} {number} ({how!r}) {name}: {end.code}, {end.wall_s:.1f} s,"
                           f" {end.memory_mb:.0f} MB: {told[0][:200]} ({kept})")  # fmt: skip
        shutil.rmtree(here)
    return {
        "codes": Counter(str(end.code) for end in ends),
        "wall_s": max(end.wall_s for end in ends),
        "memory_mb": max(end.memory_mb for end in ends),
        "bad": bad,
    }


def _special(folder: str, names: list[str]) -> list[str]:
    return [
        name
        for name in names
        if not os.path.isdir(f"{folder}/{name}") and not os.path.isfile(f"{folder}/{name}")
    ]


def plan(given: Namespace) -> list[Row]:
    kinds = fuzz_kinds.kinds().items()
    counts = {kind: max(1, round(given.size / 100 * whole)) for kind, (whole, _) in kinds}
    return [{"kind": kind, "seed": given.first_seed, "mutations": count} for kind, count in counts.items()]


def ask(task: Row, given: Namespace) -> Row:
    keep = given.keep.absolute()
    with tempfile.TemporaryDirectory(prefix="needle-rig-fuzz-") as folder, contextlib.chdir(folder):
        return fuzzed(task, made_seeds(Path(folder)), Path(folder), keep)


def table(rows: list[Row], _: Namespace) -> str:
    """One line a kind, and what was bad."""
    found = answered(rows)
    codes = sorted({*map(str, CODES), *(code for row in found for code in row["codes"])}, key=int)
    heads = ["kind", "mutations", "commands", *(f"exit {code}" for code in codes), "worst s", "MB"]
    lines = []
    for row in found:
        ends = [row["codes"].get(code, 0) for code in codes]
        worst = (f"{row['wall_s']:.1f}", f"{row['memory_mb']:.0f}")
        lines.append((row["kind"], row["mutations"], sum(ends), *ends, *worst))
    return "\n".join([markdown(heads, lines), "", *(f"- {bad}" for row in found for bad in row["bad"])])


def failed(rows: list[Row]) -> bool:
    return any(row["bad"] for row in answered(rows))


def options(parser: argparse.ArgumentParser) -> None:
    parser.set_defaults(first_seed=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz_files.bad"), help="where bad files are kept")


CAMPAIGN = Campaign(__doc__, plan, ask, table, 100, "percent of all mutations (100)", options, failed)
