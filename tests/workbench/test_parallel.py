from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from needle_rig.errors import NeedleRigError
from needle_rig.workbench.parallel import Processes, Work, on_terminal

INTERRUPTED = """
import time
from needle_rig.workbench.parallel import Processes

if __name__ == "__main__":
    with Processes(2) as work:
        work.share(0.0)
        work.run(time.sleep, [()] * 4)
        work.share(300.0)
        print("begun", flush=True)
        work.run(time.sleep, [()] * 4)
"""


def test_results_stand_in_the_order_of_the_tasks() -> None:
    for work in (Work(), Processes(2)):
        with work:
            work.share(2)
            assert work.run(pow, [(5,), (1,), (3,)]) == [32, 2, 8]
            work.share(3)
            assert work.run(pow, [(2,)]) == [9]


def test_a_process_has_one_thread_for_linear_algebra() -> None:
    with Processes(2) as work:
        work.share("OPENBLAS_NUM_THREADS")
        assert work.run(os.getenv, [()]) == ["1"]


def test_what_a_task_raises_is_raised() -> None:
    with Processes(2) as work:
        work.share(1)
        with pytest.raises(ZeroDivisionError):
            work.run(divmod, [(2,), (0,)])


def test_a_process_that_dies_is_told_in_a_sentence() -> None:
    with Processes(2) as work:
        work.share(9)
        with pytest.raises(NeedleRigError, match=r"ended from outside.*try again with fewer"):
            work.run(os._exit, [()])


def test_a_process_that_is_begun_is_begun_whole_before_ctrl_c_is_raised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    done: list[str] = []
    start = SpawnProcess.start

    def interrupted(process: SpawnProcess) -> None:
        signal.raise_signal(signal.SIGINT)
        start(process)
        done.append(process.name)

    monkeypatch.setattr(SpawnProcess, "start", interrupted)
    with Processes(2) as work:
        work.share(0.0)
        with pytest.raises(KeyboardInterrupt):
            work.run(time.sleep, [()])
    assert len(done) == 1
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("interrupt", [os.kill, os.killpg])
def test_an_interrupt_ends_all_processes_at_once(
    interrupt: Callable[[int, int], None], tmp_path: Path
) -> None:
    """`os.killpg` is Ctrl-C at a terminal, which every process hears."""
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    folders = os.environ | {"TMPDIR": str(tmp_path)}
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env=folders, start_new_session=True,
    )  # fmt: skip
    with parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"begun\n"
        time.sleep(0.5)
        begun_s = time.monotonic()
        interrupt(parent.pid, signal.SIGINT)
        assert parent.wait() != 0
        assert time.monotonic() - begun_s < 10.0
    # multiprocessing's tracker of semaphores goes when it reads that its parent is gone
    while alive_in_group(parent.pid) and time.monotonic() - begun_s < 10.0:
        time.sleep(0.05)
    assert alive_in_group(parent.pid) == []
    assert list(tmp_path.iterdir()) == [script]


COMPILED = """
from needle_rig.workbench.parallel import Processes

if __name__ == "__main__":
    with Processes(2) as work:
        work.share(range(10**13))
        print("begun", flush=True)
        work.run(sum, [()] * 2)
"""


def test_processes_end_with_a_killed_parent_whatever_they_are_busy_with(tmp_path: Path) -> None:
    """`sum` holds the interpreter's lock: no thread of its process comes to a turn."""
    script = tmp_path / "script.py"
    script.write_text(COMPILED)
    folders = os.environ | {"TMPDIR": str(tmp_path)}
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, env=folders, start_new_session=True
    )
    with parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == b"begun\n"
        time.sleep(2.0)
        parent.kill()
    deadline_s = time.monotonic() + 10.0
    while (alive := alive_in_group(parent.pid)) and time.monotonic() < deadline_s:
        time.sleep(0.05)
    for process in alive:
        os.kill(int(process), signal.SIGKILL)
    assert alive == []
    (left,) = (place for place in tmp_path.iterdir() if place != script)
    subprocess.run([sys.executable, "-c", NEXT], env=folders, check=True)
    assert not left.exists()


NEXT = "from needle_rig.workbench.parallel import Processes\nwith Processes(1): pass"


def alive_in_group(group: int) -> list[str]:
    found = []
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            _, _, fields = place.read_text().rpartition(")")
        except OSError:
            continue
        state, _, its_group = fields.split()[:3]
        if int(its_group) == group and state != "Z":
            found.append(place.parent.name)
    return found


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("stream", "shown"), [(Terminal, True), (io.StringIO, False)])
def test_progress_is_shown_on_a_terminal_alone(
    stream: type[io.StringIO], shown: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TERM", "xterm")
    err = stream()
    monkeypatch.setattr(sys, "stderr", err)
    work = Work(on_terminal)
    work.share(1)
    assert work.run(pow, [(k,) for k in range(3)]) == [1, 1, 1]
    said = err.getvalue()
    assert ("100%" in said) == shown
    assert bool(said) == shown
