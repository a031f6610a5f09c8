"""No run file holds up a command or ends it: damaged bytes and tables of another shape are sentences."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from needle_rig.cli.main import run as command
from needle_rig.config.loader import load_rig_config
from needle_rig.errors import BadInput
from needle_rig.recording import RunFile, RunWriter, journal_path, list_runs, run_attributes, run_tables
from needle_rig.recording.journal import Frames
from needle_rig.recording.liveness import being_written
from needle_rig.recording.superblock import SUPERBLOCK_BYTES, Superblock, lookup3
from needle_rig.recording.tables import EVENT, FORMAT

DAMAGED_HEAD = Path(__file__).resolve().parent.parent / "data/run_files/damaged_head.h5"
ROWS = 200


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("good") / "good.h5"
    config = load_rig_config()
    about = run_attributes(config, strategy="none", target_deg=45, parameters="rig_elastic", settle_s=3.0)
    tables = run_tables(sensors=4)
    with RunWriter(path, about, tables) as writer:
        for name, kind in tables.items():
            rows = np.zeros(ROWS, kind)
            rows["time_s"] = 1.0 + np.arange(ROWS) * 0.005
            if name == "ticks":
                rows["phase"], rows["motion"] = b"moving", b"rotate"
                rows["base_angle_rad"] = np.linspace(0, 0.5, ROWS)
            writer.append(name, rows)
        writer.close({"status": "aligned"}, time_s=3.0)
    return path


@pytest.fixture
def path(good: Path, tmp_path: Path) -> Path:
    copy = tmp_path / "runs" / "bad.h5"
    copy.parent.mkdir()
    shutil.copy(good, copy)
    return copy


def in_bounded_time(*words: str | Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-m", "needle_rig", *map(str, words)]
    return subprocess.run(line, capture_output=True, text=True, timeout=60, check=False)


def test_lookup3_gives_its_author_s_answers() -> None:
    assert lookup3(b"") == 0xDEADBEEF
    assert lookup3(b"Four score and seven years ago") == 0x17770551


def test_a_run_s_superblock_is_understood(good: Path) -> None:
    found = Superblock.parse(good.read_bytes()[:SUPERBLOCK_BYTES])
    assert found is not None
    assert not found.marked_open
    assert found.end_bytes == good.stat().st_size
    assert found.closed(found.end_bytes) == good.read_bytes()[:SUPERBLOCK_BYTES]


@pytest.mark.whole
def test_a_damaged_head_holds_up_no_command(good: Path, tmp_path: Path) -> None:
    shutil.copy(DAMAGED_HEAD, tmp_path)
    shutil.copy(good, tmp_path)
    raw = good.read_bytes()
    for at, bit in ((57, 7), (273, 0), (874, 3), (1925, 6)):
        damaged = bytearray(raw)
        damaged[at] ^= 1 << bit
        (tmp_path / f"byte_{at}.h5").write_bytes(damaged)
    listed = in_bounded_time("runs", "--dir", tmp_path, "--json")
    assert listed.returncode == 0, listed.stderr
    status = {entry["name"]: entry["status"] for entry in json.loads(listed.stdout)}
    assert status.pop("good") == "aligned"
    assert set(status.values()) == {"unreadable"}
    assert len(status) == 5
    last = in_bounded_time("export", "last", "--csv", "--dir", tmp_path, "--out", tmp_path / "out")
    assert last.returncode == 0, last.stderr
    compared = in_bounded_time("compare", tmp_path / DAMAGED_HEAD.name)
    assert (compared.returncode, compared.stdout) == (2, "")
    assert "is no readable run" in compared.stderr
    assert len(compared.stderr.splitlines()) == 1


def test_texts_whose_sizes_lead_nowhere_hold_up_no_command(good: Path, tmp_path: Path) -> None:
    """libhdf5 walks the objects of a global heap, which has no checksum, and never ends on a size of 0."""
    raw = good.read_bytes()
    heap = raw.index(b"GCOL")
    assert struct.unpack_from("<HH4xQ", raw, heap + 16)[0] == 1, "its first object"
    second = heap + 16 + 16 + (struct.unpack_from("<Q", raw, heap + 24)[0] + 7) // 8 * 8
    damage = {"longer": (second + 8, b"\4\x08"), "endless": (second + 8, b"\xff" * 8)}
    damage |= {"nothing": (second, bytes(16)), "heap": (heap + 8, b"\xff" * 8), "short": (heap + 8, bytes(8))}
    for name, (at, content) in damage.items():
        (tmp_path / f"{name}.h5").write_bytes(raw[:at] + content + raw[at + len(content) :])
    listed = in_bounded_time("runs", "--dir", tmp_path, "--json")
    assert listed.returncode == 0, listed.stderr
    status = {entry["name"]: entry["status"] for entry in json.loads(listed.stdout)}
    assert status == dict.fromkeys(damage, "unreadable")


def test_a_cut_file_is_read_to_its_end_and_says_so(tmp_path: Path) -> None:
    cut = tmp_path / "cut.h5"
    child = os.fork()
    if child == 0:
        file = h5py.File(cut, "w", libver=("v110", "v110"))  # as writers of older versions did
        file.attrs["format"] = FORMAT
        for name, kind in {**run_tables(1), "events": EVENT, "late_attributes": np.dtype("u1")}.items():
            file.create_dataset(name, shape=(0,), maxshape=(None,), chunks=(1000,), dtype=kind)
        file.swmr_mode = True
        file["torque"].resize((4999,))
        file["torque"][:] = [(0.001 * n, 0.5, n, 1e-4) for n in range(1, 5000)]
        file["torque"].flush()
        os._exit(0)  # as a kill: nothing is closed
    os.waitpid(child, 0)
    head = Superblock.parse(cut.read_bytes()[:SUPERBLOCK_BYTES])
    assert head is not None
    assert head.marked_open
    assert head.end_bytes < cut.stat().st_size, "the mended end is what this test is about"
    run = RunFile(cut)
    assert run.table("torque")["counter"].tolist() == list(range(1, 5000))
    assert not run.complete
    os.utime(cut, (1e9, 1e9))
    assert list_runs(tmp_path)[0].status == "cut off"


def test_a_writer_is_alive_while_it_holds_the_lock(path: Path) -> None:
    assert not being_written(path)
    assert not being_written(path.with_name("gone.h5"))
    with journal_path(path).open("wb") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        assert being_written(path)
        assert RunFile(path).complete, "a lock is no reason not to read"
    assert not being_written(path)


def _with_rows(made: object, name: str = "events") -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        file.pop(name, None)
        file[name] = made

    return change


def _attribute(name: str, value: object) -> Callable[[h5py.File], None]:
    return lambda file: file.attrs.__setitem__(name, value)


def _late(line: bytes) -> Callable[[h5py.File], None]:
    return _with_rows(np.frombuffer(line, "u1"), "late_attributes")


def _times(value: float) -> Callable[[h5py.File], None]:
    def change(file: h5py.File) -> None:
        for name in ("ticks", "torque", "events"):
            rows = np.resize(file[name][:], 5)
            rows["time_s"][2:] = value
            _with_rows(rows, name)(file)

    return change


def _virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((5,), file["torque"].dtype)
    layout[:] = h5py.VirtualSource("other.h5", "torque", (5,), file["torque"].dtype)
    del file["torque"]
    file.create_virtual_dataset("torque", layout)


def _group(file: h5py.File) -> None:
    file.create_group("more")


def _packed(file: h5py.File) -> None:
    rows = file["torque"][:]
    del file["torque"]
    file.create_dataset("torque", data=rows, compression="gzip")


CLOCK = np.zeros(4, [("time_s", "f8")])

CHANGES: dict[str, tuple[Callable[[h5py.File], None], str]] = {
    "events of numbers": (_with_rows(np.arange(5)), "table events is of another type"),
    "events without text": (_with_rows(CLOCK), "table events is of another type"),
    "no events": (lambda file: file.__delitem__("events"), "it has no table events"),
    "a table of two dimensions": (_with_rows(np.zeros((3, 3)), "ticks"), "ticks is no table"),
    "a table of one number": (_with_rows(1.5, "ticks"), "ticks is no table"),
    "a table without columns": (_with_rows(np.arange(5.0), "ticks"), "table ticks has no column time_s"),
    "a column lost": (_with_rows(CLOCK, "hall"), "table hall has no column angle_rad"),
    "a column of text": (
        _with_rows(np.zeros(4, [("time_s", "f8"), ("torque_nm", "S8")]), "torque"),
        "column torque_nm is of another type",
    ),
    "a time of text": (_with_rows(np.zeros(4, [("time_s", "S8")]), "more"), "column time_s is no time"),
    "rows beyond the file": (
        lambda file: file["ticks"].resize((10**12,)),
        "table ticks claims 1000000000000 rows",
    ),
    "a link": (_with_rows(h5py.ExternalLink("/etc/passwd", "x"), "ticks"), "ticks is a link"),
    "a table elsewhere": (_virtual, "compressed or lies in another file"),
    "a packed table": (_packed, "compressed or lies in another file"),
    "a group": (_group, "more is no table"),
    "late attributes of numbers": (_with_rows(np.arange(5.0), "late_attributes"), "is of another type"),
    "text in settle_s": (_attribute("settle_s", "three"), "attribute settle_s is no finite number"),
    "no number in target_deg": (_attribute("target_deg", np.nan), "attribute target_deg is no finite"),
    "a number in strategy": (_attribute("strategy", 5), "attribute strategy is no text"),
    "a terminal's commands": (_attribute("strategy", "\x1b[2J"), "characters that cannot be shown"),
    "an empty attribute": (_attribute("config", h5py.Empty("f8")), "attribute"),
    "a late text in settle_s": (_late(b'{"settle_s": "x"}\n'), "attribute settle_s is no finite number"),
    "no time": (_times(np.nan), "nan s is no time of a run"),
    "a time beyond all": (_times(1e308), "1e+308 s is no time of a run"),
    "a config that is none": (_attribute("config", "x: ["), ""),
}


@pytest.mark.parametrize("change", CHANGES)
def test_another_shape_is_a_sentence(
    change: str, path: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    make, says = CHANGES[change]
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        make(file)
    assert command(["compare", str(path)]) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said.splitlines()) == 1
    for kind in ("csv", "mcap", "png", "dataset"):
        assert command(["export", str(path), f"--{kind}", "--out", str(tmp_path / kind)]) in (0, 2)
        assert "Traceback" not in capsys.readouterr().err
    assert command(["runs", "--dir", str(path.parent)]) == 0
    assert says == "" or " unreadable " in capsys.readouterr().out


def test_one_bad_file_does_not_hide_the_others(good: Path, path: Path) -> None:
    shutil.copy(good, path.parent / "good.h5")
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        CHANGES["events of numbers"][0](file)
    os.mkfifo(path.parent / "pipe.h5")
    (path.parent / "loop.h5").symlink_to("loop.h5")
    (path.parent / "folder.h5").mkdir()
    found = {run.name: run.status for run in list_runs(path.parent)}
    assert found == dict.fromkeys(("bad", "pipe", "loop", "folder"), "unreadable") | {"good": "aligned"}


def test_late_attributes_that_are_none_are_left_out(path: Path) -> None:
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        _late(b'[1]\n{"result": []}\n' + b"[" * 9000 + b'\n{"note": "read"}\n')(file)
    run = RunFile(path)
    assert run.result is None
    assert run.attributes["note"] == "read"


def test_an_older_hdf5_file_is_no_run(tmp_path: Path) -> None:
    h5py.File(tmp_path / "a.h5", "w").close()
    with pytest.raises(BadInput, match=r"is HDF5 but no run of needle-rig \(its superblock is of an older"):
        RunFile(tmp_path / "a.h5")


WRITER = """
import select, sys
from needle_rig.recording import RunWriter, run_tables
with RunWriter(sys.argv[1], {"strategy": "none"}, run_tables(sensors=4)) as writer:
    row = 0
    while not select.select([sys.stdin], [], [], 0.0)[0]:
        for name in ("torque", "drive"):
            writer.append(name, [(float(row + n + 1), 0.0, n, 0.1, 0, 0)[: 4 if name == "torque" else 6]
                                 for n in range(20)])
        row += 20
        writer.sync()
"""


def begun(journal: Path) -> bool:
    """Whether the journal's first frame, which makes it a run, is whole."""
    return journal.is_file() and next(iter(Frames(journal)), None) is not None


def test_rows_seen_beside_a_writer_are_whole(tmp_path: Path) -> None:
    path, seen, looks = tmp_path / "live.h5", 0, 0
    with subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdin=subprocess.PIPE) as writer:
        assert writer.stdin is not None
        while looks < 10 or seen <= 100:
            assert writer.poll() is None
            if not begun(journal_path(path)):
                continue
            for name in ("torque", "drive"):
                rows = RunFile(path).table(name)["time_s"].tolist()
                assert rows == [float(n + 1) for n in range(len(rows))]
            assert len(rows) >= seen
            seen, looks = len(rows), looks + 1
        writer.stdin.close()
    assert writer.returncode == 0
    assert RunFile(path).complete
