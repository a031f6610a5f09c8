"""The watch's process: below all others, ended by itself, and nothing that the recorder waits for."""

import io
import os
import signal
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from needle_rig.cli.daemon import _build
from needle_rig.cli.status import _text
from needle_rig.config.files import find_config_file
from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import WatchSection
from needle_rig.model import load_saved, save_model
from needle_rig.recording.watch_summary import SUMMARY, WATCH_FOLDER, read_summary
from needle_rig.service.recorder import recorder_process, watch_process
from needle_rig.service.recorder.recorder_process import Keeper
from needle_rig.service.recorder.watch_process import WatchProcess
from needle_rig.version import VERSION
from tests.recorded_run import write_run

REQUEST = {"strategy": "reed2008", "target_deg": 45.0, "parameters": "rig_elastic"}


def made_to(monkeypatch: pytest.MonkeyPatch, code: str) -> WatchProcess:
    """A watch that runs `code` instead."""
    monkeypatch.setattr(WatchProcess, "_command", lambda *_: [sys.executable, "-c", code])
    return WatchProcess()


def ended(watch: WatchProcess) -> int:
    assert watch._process is not None
    return watch._process.wait(20.0)


def test_a_watch_that_hangs_ends_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watch_process, "LONGEST_S", 2)
    watch = made_to(monkeypatch, "import time; time.sleep(60)")
    assert watch.start(tmp_path)
    assert not watch.start(tmp_path)  # one at a time
    assert ended(watch) == -signal.SIGALRM
    assert watch.start(tmp_path)
    ended(watch)


def test_a_watch_that_wants_all_memory_ends_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    watch = made_to(monkeypatch, f"bytearray({watch_process.MOST_BYTES})")
    assert watch.start(tmp_path)
    assert ended(watch) == 1


def test_a_watch_is_below_all_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told = tmp_path / "told"
    code = f"import os; open({str(told)!r}, 'w').write(f'{{os.nice(0)}} {{os.sched_getscheduler(0)}}')"
    watch = made_to(monkeypatch, code)
    assert watch.start(tmp_path)
    assert ended(watch) == 0
    assert told.read_text() == f"19 {os.SCHED_IDLE}"


def test_a_watch_ends_with_its_recorder_also_beside_busy_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    watch = made_to(monkeypatch, "while True: pass")
    watch.end()  # nothing was started yet
    assert watch.start(tmp_path)
    keeper = Keeper(io.StringIO())
    keeper._watch = watch
    begun_s = time.monotonic()
    keeper.orphaned()
    assert ended(watch) == -signal.SIGTERM
    assert time.monotonic() - begun_s < 2.0
    watch.end()  # a second time


def test_a_watch_that_cannot_be_started_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WatchProcess, "_command", lambda *_: ["/nowhere/python"])
    assert not WatchProcess().start(tmp_path)


@pytest.mark.parametrize("watched", [True, False])
def test_the_recorder_starts_it_after_a_run_where_the_rig_file_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, watched: bool
) -> None:
    started: list[Path] = []

    class Noted(WatchProcess):
        def start(self, directory: Path) -> bool:
            started.append(directory)
            return True

    monkeypatch.setattr(recorder_process, "WatchProcess", Noted)
    config = load_rig_config(None, {"recording.watch": {}} if watched else {})
    keeper = Keeper(io.StringIO())
    keeper.begin(tmp_path, config, REQUEST)
    assert started == []
    keeper.finish({"status": "aligned"}, 1.0)
    assert started == ([tmp_path] if watched else [])


def status_state(tmp_path: Path) -> Any:
    """The least that `status` tells of."""
    state: Any = dict.fromkeys(("sensors", "ticks", "lease", "run", "fault", "last", "before"))
    state |= {"rig": {"name": "rig", "simulated": False}, "since_utc": "", "starting": True}
    state |= {"latched": False, "released": False, "unfinished": [], "warnings": [], "runs": str(tmp_path)}
    return state | {"version": VERSION}


def test_status_repeats_what_was_said_of_the_runs(tmp_path: Path) -> None:
    state = status_state(tmp_path)
    assert "watch:" not in _text(state, "socket")
    (tmp_path / WATCH_FOLDER).mkdir()
    (tmp_path / WATCH_FOLDER / SUMMARY).write_text('{"sentences": ["friction 12 % up"]}')
    assert "watch:   friction 12 % up" in _text(state, "socket")


def test_status_tells_the_version_of_the_daemon_and_that_it_is_another(tmp_path: Path) -> None:
    state = status_state(tmp_path)
    assert f"version: {VERSION}" in _text(state, "socket")
    assert "warning" not in _text(state, "socket")
    state["version"] = "0.0.9"
    assert f"warning: the daemon runs needle-rig 0.0.9, and this is {VERSION}" in _text(state, "socket")
    del state["version"]  # a daemon from before versions were told
    assert "version: not told" in _text(state, "socket")
    assert "the daemon runs an older needle-rig" in _text(state, "socket")


@pytest.mark.slow
def test_within_its_limits_it_looks_at_a_run(tmp_path: Path) -> None:
    write_run(tmp_path / "one.h5", pictures=False)
    watch = WatchProcess()
    begun_s = time.monotonic()
    assert watch.start(tmp_path)
    assert time.monotonic() - begun_s < 1.0
    assert watch._process is not None
    assert watch._process.wait(watch_process.LONGEST_S) == 0
    assert "1 of 20 runs" in read_summary(tmp_path)[0]


@pytest.mark.parametrize(
    ("watch", "model", "watched"),
    [
        ("{model: rig_rigid, reference_runs: 30}", None, "rig_rigid"),
        ("{model: rig_rigid, reference_runs: 30}", "mine.yaml", "mine.yaml"),
        ("{reference_runs: 30}", "mine.yaml", "mine.yaml"),
        (None, "mine.yaml", None),
    ],
)
def test_runs_are_watched_with_the_model_that_the_daemon_plans_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, watch: str | None, model: str | None, watched: str | None
) -> None:
    monkeypatch.chdir(tmp_path)
    stated = "" if watch is None else f"\n  watch: {watch}"
    text = find_config_file("rig.yaml").read_text(encoding="utf-8")
    assert "\n  directory: runs\n" in text
    (tmp_path / "rig.yaml").write_text(
        text.replace("\n  directory: runs\n", f"\n  directory: runs{stated}\n")
    )
    save_model(tmp_path / "mine.yaml", load_saved("rig_elastic"))
    monkeypatch.setattr("needle_rig.assembly.build_daemon", lambda rig, **_: rig)
    rig: Any = _build("rig.yaml", {}, model, True, None, private=True)
    if watch is None:
        assert rig.recording.watch is None
        return
    place = str(tmp_path / "mine.yaml") if watched == "mine.yaml" else watched
    assert rig.recording.watch == WatchSection(model=place, reference_runs=30)
