"""Reads ten million rows of five columns as `needle-rig import` does, beside the format's own library.

import_speed                prints processor seconds and the peak of memory, each in its own process
import_speed --rows 1e6
import_speed --kind mf4     csv (400 MB, beside pandas and polars), json_lines, parquet, feather, hdf5, mat73,
                            npz, tdms, mf4: each beside its own library
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from needle_rig.numerics import Array

LIMIT_S, LIMIT_MB = 10.0, 1000.0
"""Ten million rows are three hours at 1 kHz: what a person waits for before reading anything else. Of
processor time, which a busy machine does not change; what is compiled once is not counted."""

MOST_TIMES = 2.0
"""Times the plain read of the format's own library; text, which pandas and polars read, has LIMIT_S."""

OWN = (
    "from needle_rig.importing import read_recording; from pathlib import Path; "
    "n = len(read_recording(Path(p)).columns[0].values)"
)
PEERS = {
    "csv": {
        "polars": "import polars; n = polars.read_csv(p).height",
        "pandas": "import pandas; n = len(pandas.read_csv(p))",
    },
    "json_lines": {"polars": "import polars; n = polars.read_ndjson(p).height"},
    "parquet": {"polars": "import polars; n = len(polars.read_parquet(p).to_numpy())"},
    "feather": {"polars": "import polars; n = len(polars.read_ipc(p).to_numpy())"},
    "hdf5": {"h5py": "import h5py; n = len([v[()] for v in h5py.File(p).values()][0])"},
    "mat73": {"h5py": "import h5py; n = len([v[()].ravel() for v in h5py.File(p).values()][0])"},
    "npz": {"numpy": "import numpy; f = numpy.load(p); n = len([f[k] for k in f][0])"},
    "tdms": {
        "nptdms": "import nptdms; f = nptdms.TdmsFile.read(p); "
        "n = len([c[:] for g in f.groups() for c in g.channels()][0])"
    },
    "mf4": {"asammdf": "import asammdf; n = len([list(asammdf.MDF(p).iter_channels())][0][0].samples)"},
}
SUFFIX = {"json_lines": "jsonl", "mat73": "mat", "hdf5": "h5"}
MEASURED = (
    "import resource, sys, time; p = sys.argv[1]; t = time.process_time(); {}; "
    "print(n, time.process_time() - t, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)"
)


def columns(rows: int) -> dict[str, Array]:
    """Time in s, base and two angles in °, torque in N·mm, each (rows,)."""
    import numpy as np

    time_s: Array = np.arange(rows) * np.float64(1e-3)
    base = 45.0 * np.sin(time_s / 5.0)
    noise = np.random.default_rng(1).normal(0.0, 1e-3, rows)
    made: dict[str, Array] = {
        "time_s": time_s.round(3),
        "base_deg": base.round(4),
        "torque_nmm": (base * 0.002 + noise).round(5),
    }
    return made | {f"hall_{k}_deg": (base * (1.0 - 0.1 * k)).round(3) for k in (1, 2)}


def write(path: Path, rows: int, kind: str) -> None:
    """A file of that kind, by the writer of its field."""
    made = columns(rows)
    if kind in ("hdf5", "mat73"):
        import h5py
        import numpy as np

        # MATLAB's file has a block of its own before that of HDF5, and rows lie across
        with h5py.File(path, "w", userblock_size=512 if kind == "mat73" else 0) as file:
            for name, values in made.items():
                item = file.create_dataset(name, data=values[None, :] if kind == "mat73" else values)
                if kind == "mat73":
                    item.attrs["MATLAB_class"] = np.bytes_("double")
        if kind == "mat73":
            with path.open("r+b") as head:
                head.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    elif kind == "npz":
        import numpy as np

        np.savez(path, allow_pickle=False, **made)
    elif kind == "tdms":
        import nptdms

        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment([nptdms.ChannelObject("run", name, values) for name, values in made.items()])
    elif kind == "mf4":
        import asammdf

        time_s = made.pop("time_s")
        with asammdf.MDF(version="4.10") as mdf:
            mdf.append([asammdf.Signal(values, time_s, name=name) for name, values in made.items()])
            mdf.save(path)
    else:
        import polars

        name = {"json_lines": "ndjson", "feather": "ipc"}.get(kind, kind)
        getattr(polars.DataFrame(made), f"write_{name}")(path)


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rows", type=float, default=1e7)
    parser.add_argument("--kind", choices=tuple(PEERS), default="csv")
    given = parser.parse_args()
    rows, suffix = int(given.rows), SUFFIX.get(given.kind, given.kind)
    late = False
    taken_s = {}
    with tempfile.TemporaryDirectory(prefix="import_speed-") as folder:
        path = Path(folder) / f"log.{suffix}"
        first = Path(folder) / f"first.{suffix}"
        for place, count in ((path, rows), (first, 1000)):
            # a process that wrote ten million rows would keep their memory
            line = [sys.executable, "-c", WRITTEN, str(place), str(count), given.kind]
            subprocess.run(line, capture_output=True, check=True)
        print(f"{given.kind}: {rows:,} rows, {path.stat().st_size / 1e6:.0f} MB")
        line = [sys.executable, "-c", MEASURED.format(OWN), str(first)]
        subprocess.run(line, capture_output=True, check=True)
        for name, reading in ({"needle-rig": OWN} | PEERS[given.kind]).items():
            line = [sys.executable, "-c", MEASURED.format(reading), str(path)]
            told = subprocess.run(line, capture_output=True, text=True, check=True).stdout.split()
            count, seconds, memory_mb = int(told[0]), float(told[1]), float(told[2])
            taken_s[name] = seconds
            print(f"{name:12s} {seconds:6.1f} s  {memory_mb:6.0f} MB")
            late |= count != rows
            late |= name == "needle-rig" and given.kind != "json_lines" and memory_mb > LIMIT_MB
    if given.kind == "csv":
        late |= taken_s["needle-rig"] > LIMIT_S
    else:
        (peer,) = PEERS[given.kind]
        times = taken_s["needle-rig"] / taken_s[peer]
        print(f"{times:.1f} x {peer}")
        late |= times > MOST_TIMES
    return 1 if late else 0


WRITTEN = (
    "import sys; from pathlib import Path; from benchmarks.import_speed import write; "
    "write(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3])"
)


if __name__ == "__main__":
    sys.exit(main())
