"""Run files: what is written is read back, also while it is written and after a kill."""

from __future__ import annotations

import errno
import os
import random
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.config.loader import load_rig_config
from needle_rig.errors import BadInput, RigFault
from needle_rig.recording import (
    RunFile,
    RunWriter,
    find_run,
    journal_path,
    list_runs,
    new_run,
    run_attributes,
    run_tables,
    unfinished_runs,
)
from needle_rig.recording.image import empty_image
from needle_rig.recording.journal import Journal
from needle_rig.recording.writer import _event_rows

TABLES = run_tables(sensors=4)
ATTRIBUTES = {"strategy": "reed2008", "target_deg": 45.0, "parameters": "rig_elastic"}


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    config = load_rig_config()
    attributes = run_attributes(
        config, strategy="reed2008", target_deg=45, parameters="rig_elastic", shaft_position_m=np.arange(3.0)
    )
    with RunWriter(tmp_path / "a.h5", attributes, TABLES) as writer:
        writer.append("torque", [(0.001, 0.5, 7, 1e-4), (0.002, 0.501, 8, 2e-4)])
        writer.append("hall", [(0.001, 0.5, 7, 0.1, 0.2, 0.3, 0.4)])
        writer.append("hall", [])
        writer.append("hall", np.zeros(2, TABLES["hall"]))
        writer.event(0.003, "phase", "moving: Grüße")
        writer.close({"status": "aligned", "lag_deg": 26.0}, time_s=0.004)
        writer.close()
    run = RunFile(tmp_path / "a.h5")
    assert run.complete
    assert run.result == {"status": "aligned", "lag_deg": 26.0}
    assert run.config == config
    assert run.attributes["target_deg"] == 45.0
    assert np.asarray(run.attributes["shaft_position_m"]).tolist() == [0, 1, 2]
    assert run.table("torque")["counter"].tolist() == [7, 8]
    assert run.table("hall")["angle_rad"][0].tolist() == [0.1, 0.2, 0.3, 0.4]
    assert len(run.table("hall")) == 3
    assert [(e.kind, e.text) for e in run.events] == [("phase", "moving: Grüße"), ("end", "")]
    assert run.span_s == (0.0, 0.002)


@given(st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), max_size=2000))
def test_a_long_event_keeps_its_text(text: str) -> None:
    rows = _event_rows(1.0, "note", text)
    assert b"".join(rows["text"]).decode() == text
    assert all(row.decode() is not None for row in rows["text"])


def test_a_run_is_readable_while_it_is_written(tmp_path: Path) -> None:
    with new_run(tmp_path, ATTRIBUTES, TABLES) as writer:
        run = RunFile(writer.path)
        assert not run.complete
        assert len(run.table("torque")) == 0
        writer.append("torque", [(0.001, 0.5, 7, 1e-4)])
        assert len(run.table("torque")) == 1
        assert list_runs(tmp_path)[0].status == "running"
    assert run.complete


def test_rows_reach_the_disk_without_being_asked(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES, sync_interval_s=0.01) as writer:
        writer.append("torque", [(0.001, 0.5, 7, 1e-4)])
        assert len(RunFile(writer.path).table("torque")) == 1


def test_a_run_is_never_written_over(tmp_path: Path) -> None:
    writers = [new_run(tmp_path, ATTRIBUTES, TABLES) for _ in range(3)]
    for writer in writers:
        writer.close()
    assert len({writer.path for writer in writers}) == 3
    assert all(writer.path.name.endswith(".h5") and "reed2008" in writer.path.name for writer in writers)
    with pytest.raises(BadInput, match="exists already; a run is never written over"):
        RunWriter(writers[0].path, ATTRIBUTES, TABLES)
    assert list(tmp_path.glob(".*")) == []


def test_a_folder_that_cannot_be_made(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(BadInput, match="cannot be the folder of the runs: Not a directory"):
        new_run(tmp_path / "file" / "runs", ATTRIBUTES, TABLES)


def full_disk(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_keeps_what_was_written_and_the_last_words(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES)
    rows = np.zeros(1000, TABLES["torque"])
    rows["time_s"] = np.arange(1000) + 1.0
    writer.append("torque", rows)
    monkeypatch.setattr(os, "posix_fallocate", full_disk)
    told = ""
    while not told:
        try:
            writer.append("torque", rows)
        except RigFault as fault:
            told = str(fault)
        assert writer.rows < 100_000
    assert "a.h5: the run cannot be written: No space left on device; its first" in told
    assert "\n" not in told
    with pytest.raises(RigFault, match="No space left"):
        writer.append("torque", rows[:1])
    writer.event(5.0, "fault", "the disk is full")
    with pytest.raises(
        RigFault, match=r"cannot be made: No space left on device; the run is kept in a\.journal"
    ):
        writer.close({"status": "fault"})
    kept = writer.rows - 2
    run = RunFile(tmp_path / "a.h5")
    assert len(run.table("torque")) == kept
    assert kept % 1000 == 0
    assert run.result == {"status": "fault"}
    assert [event.kind for event in run.events] == ["fault", "recorder"]
    assert not run.complete
    monkeypatch.undo()
    resumed = RunWriter.resume(tmp_path / "a.h5")
    resumed.close_unfinished("closed when there was room")
    assert not list(tmp_path.glob("*.journal"))
    run = RunFile(tmp_path / "a.h5")
    assert len(run.table("torque")) == kept
    assert (run.table("torque")["time_s"] > 0).all()
    assert run.result == {"status": "fault"}
    assert not run.complete


@pytest.mark.parametrize(
    ("content", "says"),
    [(b"", "is empty: it was cut off before it began"), (b"hello" * 100, "is not a readable run")],
)
def test_a_file_that_is_no_run(tmp_path: Path, content: bytes, says: str) -> None:
    path = tmp_path / "x.h5"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=says):
        RunFile(path)
    assert list_runs(tmp_path)[0].status == "unreadable"


def test_foreign_hdf5_is_no_run(tmp_path: Path) -> None:
    h5py.File(tmp_path / "x.h5", "w").close()
    with pytest.raises(BadInput, match="is HDF5 but no run"):
        RunFile(tmp_path / "x.h5")


def test_a_table_that_is_not_there(tmp_path: Path) -> None:
    new_run(tmp_path, ATTRIBUTES, TABLES).close()
    with pytest.raises(BadInput, match="has no table ticcs; it has drive, hall, ticks, torque"):
        find_run("last", tmp_path).table("ticcs")


def test_which_run_is_meant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BadInput, match="last: no run in runs; make one"):
        find_run("last", "runs")
    for name, when in (("2026-01-01_a", "2026-01-01T00:00:00"), ("2026-01-02_b", "2026-01-02T00:00:00")):
        RunWriter(f"runs/{name}.h5", {**ATTRIBUTES, "started_utc": when}, TABLES).close({"status": "aligned"})
    assert [run.status for run in list_runs("runs")] == ["aligned", "aligned"]
    assert find_run("last", "runs").name == "2026-01-02_b"
    assert find_run("2026-01-01_a", "runs").name == "2026-01-01_a"
    assert find_run("runs/2026-01-01_a.h5", "elsewhere").name == "2026-01-01_a"
    assert find_run("_b", "runs").name == "2026-01-02_b"
    with pytest.raises(BadInput, match="fits 2 runs in runs: 2026-01-01_a, 2026-01-02_b; say which"):
        find_run("2026", "runs")
    with pytest.raises(BadInput, match=r"no such run in runs; did you mean 2026-01-01_a\?"):
        find_run("2026-01-01_c", "runs")
    with pytest.raises(BadInput, match="there is no such file; list the runs"):
        RunFile("runs/none.h5")


@pytest.fixture(scope="module")
def left(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """The journal of a run that was cut off after 50 frames of 20 rows."""
    path = tmp_path_factory.mktemp("left") / "a.h5"
    writer = RunWriter(path, ATTRIBUTES, TABLES)
    for begin in range(0, 1000, 20):
        writer.append("torque", [(1.0 + n, 0.5, n, 1e-4) for n in range(begin, begin + 20)])
    writer.leave()
    return journal_path(path).read_bytes()


@pytest.mark.parametrize("seed", range(40))
def test_a_damaged_journal_yields_the_rows_before_the_damage(tmp_path: Path, left: bytes, seed: int) -> None:
    chance, damaged = random.Random(seed), bytearray(left)
    used = len(left.rstrip(b"\0"))
    at = chance.randrange(used)
    match seed % 4:
        case 0:
            damaged[at] ^= 1 << chance.randrange(8)
        case 1:
            del damaged[at:]
        case 2:
            damaged[at:] = os.urandom(len(damaged) - at)
        case 3:
            damaged[at : at + 4096] = bytes(len(damaged[at : at + 4096]))
    path = tmp_path / "a.h5"
    journal_path(path).write_bytes(damaged)
    [listed] = list_runs(tmp_path)
    assert listed.status in ("cut off", "unreadable")
    if listed.status == "unreadable":
        return
    counters = RunFile(path).table("torque")["counter"].tolist()
    assert counters == list(range(len(counters)))
    assert len(counters) % 20 == 0
    assert len(counters) < 1000
    if seed % 4 in (0, 2):
        assert RunFile(path).torn_bytes > 0
    writer = RunWriter.resume(path)
    writer.close_unfinished("it was cut off")
    assert RunFile(path).table("torque")["counter"].tolist() == counters
    assert list(tmp_path.iterdir()) == [path]


def test_frames_of_another_run_do_not_fit(tmp_path: Path, left: bytes) -> None:
    other = RunWriter(tmp_path / "b.h5", ATTRIBUTES, TABLES)
    other.append("torque", [(1.0, 0.5, 7, 2e-4)])
    other.leave()
    mine = journal_path(tmp_path / "b.h5").read_bytes().rstrip(b"\0")
    # the disk gave this journal a block that was another one's, frame upon frame
    journal_path(tmp_path / "b.h5").write_bytes(mine + left[len(mine) :])
    run = RunFile(tmp_path / "b.h5")
    assert run.table("torque")["counter"].tolist() == [7]
    assert run.torn_bytes > 0


def test_a_frame_that_fits_no_table_is_a_sentence(tmp_path: Path) -> None:
    journal = Journal.create(tmp_path / "a.journal", empty_image(ATTRIBUTES, TABLES))
    journal.append(99, b"rows")
    journal.close()
    with pytest.raises(BadInput, match="a frame of 4 bytes fits no table 99"):
        RunFile(tmp_path / "a.h5")
    with pytest.raises(BadInput, match="a frame of 4 bytes fits no table 99"):
        RunWriter.resume(tmp_path / "a.h5")
    assert list_runs(tmp_path)[0].status == "unreadable"


def test_a_run_is_taken_over_by_nobody_while_it_is_written(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES) as writer:
        assert unfinished_runs(tmp_path) == []
        with pytest.raises(BadInput, match="is being written by another process"):
            RunWriter.resume(writer.path)
    with pytest.raises(BadInput, match="there is no unfinished run of this name"):
        RunWriter.resume(writer.path)


def test_a_kill_between_the_file_and_the_end_of_its_journal_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES)
    writer.append("torque", [(1.0, 0.5, 7, 1e-4)])
    monkeypatch.setattr(Journal, "remove", Journal.close)
    writer.close({"status": "aligned"})
    assert RunFile(tmp_path / "a.h5").complete
    monkeypatch.undo()
    assert unfinished_runs(tmp_path) == [tmp_path / "a.h5"]
    resumed = RunWriter.resume(tmp_path / "a.h5")
    assert resumed.complete
    resumed.close_unfinished("it was cut off")
    run = RunFile(tmp_path / "a.h5")
    assert run.complete
    assert run.result == {"status": "aligned"}
    assert [event.kind for event in run.events] == ["end"]
    assert list(tmp_path.iterdir()) == [tmp_path / "a.h5"]


def test_a_flipped_bit_in_a_run_file_is_seen(tmp_path: Path) -> None:
    with RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES) as writer:
        writer.append("torque", [(1.0 + n, 0.5, 7, 1e-4) for n in range(100)])
    raw = bytearray((tmp_path / "a.h5").read_bytes())
    raw[raw.index(np.float64(51.0).tobytes() + np.float64(0.5).tobytes()) + 3] ^= 1
    (tmp_path / "a.h5").write_bytes(raw)
    with pytest.raises(BadInput, match="is no readable run"):
        RunFile(tmp_path / "a.h5").table("torque")


WRITER = """
import sys, time
import numpy as np
from needle_rig.recording import RunWriter, run_tables
tables = run_tables(sensors=4)
with RunWriter(sys.argv[1], {"strategy": "reed2008", "target_deg": 45.0}, tables) as writer:
    counts = {"torque": 0, "ticks": 0}
    begin = time.monotonic()
    print("begun", flush=True)
    while True:
        due = time.monotonic() - begin
        for name, rate in (("torque", 1000), ("ticks", 200)):
            rows = np.zeros(max(0, int(due * rate) - counts[name]), tables[name])
            rows["time_s"] = begin + (counts[name] + np.arange(len(rows)) + 1) / rate
            if name == "torque":
                rows["counter"] = counts[name] + np.arange(len(rows))
            counts[name] += len(rows)
            writer.append(name, rows)
        if len(rows) and counts["ticks"] % 50 < len(rows):
            writer.event(begin + due, "phase", "moving")
        time.sleep(0.002)
"""


@pytest.mark.real_time
@pytest.mark.parametrize("seed", range(5))
def test_a_killed_writer_loses_at_most_half_a_second(tmp_path: Path, seed: int) -> None:
    path = tmp_path / "killed.h5"
    writer = subprocess.Popen([sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True)
    try:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "begun\n"
        threshold_s = random.Random(seed).uniform(0.05, 1.5)
        end = time.monotonic() + threshold_s
        threading.Event().wait(end - time.monotonic())
        killed_s = time.monotonic()
        os.kill(writer.pid, signal.SIGKILL)
    finally:
        writer.kill()
        writer.communicate()
    run = RunFile(path)
    assert not run.complete
    assert run.result is None
    for name in ("torque", "ticks"):
        rows = run.table(name)
        last_s = rows["time_s"][-1] if len(rows) else killed_s - threshold_s
        assert killed_s - last_s < 0.5
        assert (np.diff(rows["time_s"]) > 0).all()
    assert run.table("torque")["counter"].tolist() == list(range(len(run.table("torque"))))


def test_what_is_said_late_is_joined_to_the_attributes(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "a.h5", ATTRIBUTES, TABLES)
    writer.set_attribute("note", "grün")
    writer.set_attribute("result", {"status": "fault"})
    writer.close()
    assert RunFile(writer.path).attributes["note"] == "grün"
    assert RunFile(writer.path).result == {"status": "fault"}
