"""Damages files and requests of every kind and counts how the commands that read them end.

fuzz_files                        the whole campaign: some 4,000 mutations, ten minutes of one core
fuzz_files --share 0.1 --seed 5   a tenth of it, others than those of seed 1
fuzz_files --only "run: a bit"    one kind

Each command runs in a process of its own. Bad is an exit code other than 0 to 4, a traceback, more than 60 s,
more than 2 GB, and a signal; each is printed with the file that did it, and the exit code is then 1.
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
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from campaigns import ROOT
from campaigns.files import fuzz_kinds

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


@dataclass
class Count:
    """What came of a kind."""

    mutations: int = 0
    codes: Counter[int] = field(default_factory=Counter)
    wall_s: float = 0.0
    memory_mb: float = 0.0

    def add(self, end: End) -> None:
        self.codes[end.code] += 1
        self.wall_s, self.memory_mb = max(self.wall_s, end.wall_s), max(self.memory_mb, end.memory_mb)


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


def campaign(only: list[str], share: float, seed: int, work: Path, keep: Path) -> bool:
    """Runs it and prints the table; True when nothing was bad."""
    seeds = fuzz_kinds.Seeds(work / "seeds", EFFECT)

    def make_seeds() -> int:
        seeds.make()
        return 0

    made = isolated(make_seeds, work / "out.txt", FIRST_START_S)
    if made.code != 0:
        sys.exit(f"the undamaged files could not be made (exit {made.code}): {made.said}")
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()) as said:
        if not seeds.warm(work / "warm"):
            sys.exit(said.getvalue())
    good = True
    counts: dict[str, Count] = {}
    for kind, (whole, make) in fuzz_kinds.kinds().items():
        if only and kind not in only:
            continue
        count = counts[kind] = Count()
        for number in range(max(1, round(whole * share))):
            here = work / "here"
            here.mkdir()
            how, actions = make(seeds, here, random.Random(f"{seed} {kind} {number}"), number)
            count.mutations += 1
            for name, action in actions:
                end = isolated(action, work / "out.txt")
                count.add(end)
                if end.bad:
                    good = False
                    kept = keep / f"{seed}-{kind}-{number}".replace(" ", "_").replace(":", "")
                    shutil.rmtree(kept, ignore_errors=True)
                    shutil.copytree(here, kept, symlinks=True, ignore=_special)
                    told = end.said.strip().splitlines()[-1:] or [""]
                    print(f"BAD {kind} {number} ({how!r}) {name}: {end.code}, {end.wall_s:.1f} s,"
                          f" {end.memory_mb:.0f} MB: {told[0][:200]} ({kept})", flush=True)  # fmt: skip
            shutil.rmtree(here)
        print(f"{kind}: {count.mutations} done", file=sys.stderr, flush=True)
    print(table(counts))
    return good


def _special(folder: str, names: list[str]) -> list[str]:
    return [
        name
        for name in names
        if not os.path.isdir(f"{folder}/{name}") and not os.path.isfile(f"{folder}/{name}")
    ]


def table(counts: dict[str, Count]) -> str:
    """One line a kind."""
    codes = sorted({*CODES, *(code for count in counts.values() for code in count.codes)})
    heads = "".join(f"{f'exit {code}':>8}" for code in codes)
    lines = [f"{'kind':<18}{'mutations':>10}{'commands':>10}{heads}{'worst s':>9}{'MB':>7}"]
    for kind, count in counts.items():
        ends = "".join(f"{count.codes[code]:>8}" for code in codes)
        head = f"{kind:<18}{count.mutations:>10}{count.codes.total():>10}"
        lines.append(f"{head}{ends}{count.wall_s:>9.1f}{count.memory_mb:>7.0f}")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", action="append", default=[], choices=list(fuzz_kinds.kinds()))
    parser.add_argument("--share", type=float, default=1.0, help="of all mutations")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, default=Path("fuzz_files.bad"), help="where bad files are kept")
    given = parser.parse_args()
    keep = given.keep.absolute()
    with tempfile.TemporaryDirectory(prefix="needle-rig-fuzz-") as folder:
        os.chdir(folder)
        good = campaign(given.only, given.share, given.seed, Path(folder), keep)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
