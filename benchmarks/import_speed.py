"""Reads ten million rows of text (five columns, 400 MB) as `needle-rig import` does, beside its peers.

Peers are pandas and polars.

import_speed                    prints processor seconds and the peak of memory, each in its own process
import_speed --rows 1e6
import_speed --kind json_lines  one object a line, beside polars
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

LIMIT_S, LIMIT_MB = 10.0, 1000.0
"""Ten million rows are three hours at 1 kHz: what a person waits for before reading anything else. Of
processor time, which a busy machine does not change; what is compiled once is not counted."""

MOST_TIMES = 2.0
"""Of JSON lines: times the plain read of polars, which has no smaller form of its own."""

OWN = {
    "needle-rig": "from needle_rig.importing import read_recording; from pathlib import Path; "
    "n = len(read_recording(Path(p)).columns[0].values)",
}
READERS = {
    "csv": OWN
    | {
        "polars": "import polars; n = polars.read_csv(p).height",
        "pandas": "import pandas; n = len(pandas.read_csv(p))",
    },
    "json_lines": OWN | {"polars": "import polars; n = polars.read_ndjson(p).height"},
}
MEASURED = (
    "import resource, sys, time; p = sys.argv[1]; t = time.process_time(); {}; "
    "print(n, time.process_time() - t, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
)


def write(path: Path, rows: int) -> None:
    import numpy as np
    import polars

    time_s = np.arange(rows) * 1e-3
    base = 45.0 * np.sin(time_s / 5.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, rows)
    columns = {
        "time_s": time_s.round(3),
        "base_deg": base.round(4),
        "torque_nmm": (base * 0.002 + noise).round(5),
    }
    columns |= {f"hall_{k}_deg": (base * (1.0 - 0.1 * k)).round(3) for k in (1, 2)}
    frame = polars.DataFrame(columns)
    if path.suffix == ".jsonl":
        frame.write_ndjson(path)
    else:
        frame.write_csv(path)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=float, default=1e7)
    parser.add_argument("--kind", choices=tuple(READERS), default="csv")
    given = parser.parse_args()
    rows, suffix = int(given.rows), {"csv": "csv", "json_lines": "jsonl"}[given.kind]
    late = False
    taken_s = {}
    with tempfile.TemporaryDirectory(prefix="import_speed-") as folder:
        path = Path(folder) / f"log.{suffix}"
        write(path, rows)
        print(f"{rows:,} rows, {path.stat().st_size / 1e6:.0f} MB")
        first = Path(folder) / f"first.{suffix}"
        write(first, 1000)
        line = [sys.executable, "-c", MEASURED.format(OWN["needle-rig"]), str(first)]
        subprocess.run(line, capture_output=True, check=True)
        for name, reading in READERS[given.kind].items():
            line = [sys.executable, "-c", MEASURED.format(reading), str(path)]
            told = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()
            count, seconds, memory_mb = int(told[0]), float(told[1]), float(told[2])
            taken_s[name] = seconds
            print(f"{name:12s} {seconds:6.1f} s  {memory_mb:6.0f} MB")
            late |= count != rows
            if name == "needle-rig" and given.kind == "csv":
                late |= seconds > LIMIT_S or memory_mb > LIMIT_MB
    if given.kind == "json_lines":
        times = taken_s["needle-rig"] / taken_s["polars"]
        print(f"{times:.1f} x polars")
        late |= times > MOST_TIMES
    return 1 if late else 0


if __name__ == "__main__":
    sys.exit(main())
