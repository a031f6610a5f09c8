"""A question that was stopped goes on from what was done, and to the same answer."""

from __future__ import annotations

import dataclasses
import importlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from needle_rig.errors import BadInput
from needle_rig.questions.doing import Doing
from needle_rig.workbench import answers
from needle_rig.workbench.answers import answers_of, digest_of
from needle_rig.workbench.parallel import Work, workers

BETWEEN = ("tissue_elasticity", "chuck_compliance")
WENT_ON = "going on after {} tasks that were done before this was stopped"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "needle-rig" / "answers"


def noted(place: Path, k: int) -> str:
    """Leaves a line that it was done."""
    with (place / "done").open("a") as file:
        file.write(f"{k}\n")
    return f"answer {k}"


class Asking:
    """One question, asked several times."""

    def __init__(self, place: Path) -> None:
        self.place, self.said, self.told, self.stays = place, [], [], ""  # type: ignore[var-annotated]

    @contextmanager
    def work(self, jobs: int = 1, asked: str = "it") -> Iterator[Work]:
        with (
            answers_of(asked, self.said.append, self.told.append) as kept,
            workers(jobs, None, answers=kept) as work,
        ):
            work.share(self.place)
            yield work

    def stopped(self, tasks: int, jobs: int = 1, asked: str = "it") -> None:
        """After so many tasks."""
        with suppress(KeyboardInterrupt), self.work(jobs, asked) as work:
            work.run(noted, [(k,) for k in range(tasks)])
            raise KeyboardInterrupt
        self.stays = self.told.pop()

    def answered(self, tasks: int, jobs: int = 1) -> list[int]:
        """The tasks that are done for it, in order."""
        (self.place / "done").write_text("")
        with self.work(jobs) as work:
            assert work.run(noted, [(k,) for k in range(tasks)]) == [f"answer {k}" for k in range(tasks)]
        return sorted(map(int, (self.place / "done").read_text().split()))


@pytest.fixture
def asking(tmp_path: Path) -> Asking:
    return Asking(tmp_path)


@pytest.mark.parametrize(("before", "after"), [(1, 1), (2, 2), (1, 2), (2, 1)])
def test_a_stopped_question_goes_on_and_an_answered_one_leaves_nothing(
    asking: Asking, cache: Path, before: int, after: int
) -> None:
    asking.stopped(3, before)
    assert asking.said == []
    assert asking.stays == "3 tasks are done: the same, re-run within a week, goes on from there"
    assert asking.answered(5, after) == [3, 4]
    assert asking.said == [WENT_ON.format(3)]
    assert list(cache.iterdir()) == []
    assert asking.answered(2) == [0, 1]
    assert asking.told == []


def test_a_task_that_is_asked_twice_is_done_once_and_is_no_earlier_answer(asking: Asking) -> None:
    (asking.place / "done").write_text("")
    with asking.work(1) as work:
        assert work.run(noted, [(4,)]) == work.run(noted, [(4,)]) == ["answer 4"]
    assert (asking.place / "done").read_text().split() == ["4"]
    assert asking.said == []


def test_a_stop_in_the_middle_of_a_step_keeps_what_was_done_of_it(asking: Asking) -> None:
    """The third task never ends: the stop comes while it runs, and the fourth is done beside it."""
    before = signal.signal(signal.SIGALRM, signal.default_int_handler)
    signal.alarm(60)
    try:
        with pytest.raises(KeyboardInterrupt), asking.work(2) as work:
            work.run(unless_two, [(k,) for k in range(4)])
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    assert sorted((asking.place / "done").read_text().split()) == ["0", "1", "3"]
    (asking.place / "done").write_text("")
    (asking.place / "goes").touch()
    with asking.work(2) as work:
        assert work.run(unless_two, [(k,) for k in range(4)]) == [f"answer {k}" for k in range(4)]
    assert (asking.place / "done").read_text() == "2\n"


def unless_two(place: Path, k: int) -> str:
    """The task 2 lasts until it may go; all others are done by then, and stop the question."""
    (place / "done").touch()
    while k == 2 and not (place / "goes").exists():
        if len((place / "done").read_text().split()) == 3:
            time.sleep(0.3)  # until the last answer has come over, too
            os.kill(os.getppid(), signal.SIGALRM)
            time.sleep(600.0)
        time.sleep(0.01)
    return noted(place, k)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda kept: kept[0].write_bytes(kept[0].read_bytes()[:-1]),
        lambda kept: kept[0].write_bytes(b""),
        lambda kept: kept[0].write_bytes(kept[1].read_bytes()),
        lambda kept: kept[0].write_bytes(os.urandom(5000)),
        lambda kept: (kept[0].unlink(), kept[0].mkdir()),
        lambda kept: kept[0].rename(kept[0].with_suffix(".4711")),
    ],
    ids=["cut off", "empty", "of another task", "foreign", "folder", "never renamed"],
)
def test_a_damaged_answer_is_worked_again(
    asking: Asking, cache: Path, spoil: Callable[[list[Path]], object]
) -> None:
    asking.stopped(3)
    (question,) = cache.iterdir()
    spoil(sorted(question.iterdir()))
    assert len(asking.answered(3)) == 1
    assert list(cache.iterdir()) == []


def test_another_source_another_argument_and_another_shared_thing_are_other_tasks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "of_a_lab.py").write_text("class Law:\n    size = 1\n")
    module = importlib.import_module("of_a_lab")
    known = digest_of(module.Law())
    assert digest_of(module.Law()) == known
    answers._stamp_of.cache_clear()
    (tmp_path / "of_a_lab.py").write_text("class Law:\n    size = 2\n")
    assert digest_of(module.Law()) != known
    assert digest_of((1.0, "a")) != digest_of((1.0, "b"))


def test_what_has_no_source_is_known_to_its_process_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    typed = type("Typed", (), {"__module__": "__main__", "__qualname__": "Typed"})
    monkeypatch.setattr(sys.modules["__main__"], "Typed", typed, raising=False)
    monkeypatch.delattr(sys.modules["__main__"], "__file__", raising=False)
    answers._stamp_of.cache_clear()
    here = digest_of(typed)
    answers._stamp_of.cache_clear()
    assert digest_of(typed) != here


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda place: place.chmod(0o755), "is open to others; remove it"),
        (lambda place: os.chown(place, 65534, 65534), "is open to others; remove it"),
        (lambda place: (place.rmdir(), place.symlink_to("/tmp")), "Not a directory"),
        (lambda place: (place.rmdir(), place.touch()), "File exists"),
    ],
    ids=["others may read", "of another user", "link", "file"],
)
def test_a_folder_that_is_not_ours_alone_is_refused_in_a_sentence(
    asking: Asking, cache: Path, spoil: Callable[[Path], object], said: str
) -> None:
    if os.geteuid() and "chown" in spoil.__code__.co_names:
        pytest.skip("only root gives a folder away")
    cache.mkdir(parents=True, mode=0o700)
    spoil(cache)
    assert asking.answered(2) == [0, 1]
    assert len(asking.told) == 1
    assert asking.told[0].startswith("warning: what is done is not kept (")
    assert said in asking.told[0]


def test_a_full_disk_costs_nothing_but_the_work(asking: Asking, cache: Path) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with asking.work() as work:
        resource.setrlimit(resource.RLIMIT_FSIZE, (20, before[1]))
        try:
            assert work.run(abs_of, [(-k,) for k in range(3)]) == [0, 1, 2]
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert len(asking.told) == 1
    assert "not kept (File too large)" in asking.told[0]
    assert list(cache.iterdir()) == []


def abs_of(_: Path, number: int) -> int:
    return abs(number)


def test_too_much_is_not_kept(asking: Asking, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(answers, "LIMIT_BYTES", 100)
    asking.stopped(9)
    (question,) = cache.iterdir()
    assert sum(file.stat().st_size for file in question.iterdir()) < 300
    assert len(asking.told) == 1


def test_the_same_question_twice_at_once_is_answered_twice(asking: Asking, cache: Path) -> None:
    asking.stopped(2)
    with asking.work() as work:
        assert asking.answered(3) == [2]
        assert list(cache.iterdir()) == []
        assert work.run(noted, [(k,) for k in range(3)]) == ["answer 0", "answer 1", "answer 2"]
    assert asking.told == []


def test_answers_of_an_old_question_go_and_of_a_recent_one_stay(asking: Asking, cache: Path) -> None:
    asking.stopped(1)
    (old,) = cache.iterdir()
    asking.stopped(1, asked="recent")
    os.utime(old, (time.time() - answers.LIVES_S - 60.0,) * 2)
    with asking.work(asked="another"):
        assert len(list(cache.iterdir())) == 2
        assert not old.exists()


def test_of_many_stopped_questions_the_last_stay(
    asking: Asking, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for k in range(4):
        asking.stopped(1, asked=str(k))
        for at, folder in enumerate(sorted(cache.iterdir(), key=lambda each: each.stat().st_mtime)):
            os.utime(folder, (time.time() - 100.0 + at,) * 2)
    each = next(next(cache.iterdir()).iterdir()).stat().st_size
    monkeypatch.setattr(answers, "LIMIT_BYTES", 2 * each)
    with asking.work(asked="another"):
        assert len(list(cache.iterdir())) == 3


@pytest.mark.whole
def test_a_command_that_is_stopped_three_times_says_what_one_says_that_is_not(
    tmp_path: Path, cache: Path
) -> None:
    """By Ctrl-C, by SIGTERM, and as by power; no process of it lives on."""
    shutil.copytree(Path(__file__).parents[1] / "data" / "practice" / "elastic", tmp_path / "mine")
    line = [sys.executable, "-m", "needle_rig", "experiment", "mine", "--between", *BETWEEN, "--json"]

    def begun(out: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [*line, "--out", out], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path
        )

    def kept_whole() -> int:
        return sum("." not in file.name for file in cache.glob("*/*"))

    whole, _ = begun("e.yaml").communicate()
    assert list(cache.iterdir()) == []
    kept = 0
    for number, code in ((signal.SIGINT, 4), (signal.SIGTERM, 4), (signal.SIGKILL, -signal.SIGKILL)):
        process = begun("e.yaml")
        while kept_whole() == kept:
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(number)
        _, said = process.communicate()
        assert process.returncode == code, said
        assert (code == -signal.SIGKILL) != ("the same, re-run within a week, goes on from there" in said), (
            said
        )
        if code != -signal.SIGKILL:  # a child that was just begun says that its parent is gone
            assert "Traceback" not in said, said
        kept = kept_whole()
    last = begun("e.yaml")
    again, said = last.communicate()
    assert again == whole
    assert WENT_ON.format(kept) in said
    assert list(cache.iterdir()) == []


def test_a_question_that_is_a_part_of_another_ends_without_it(asking: Asking, cache: Path) -> None:
    """As one rig of several: what it took stays until all are answered."""
    doing = Doing(jobs=1, say=asking.said.append)

    def parts(stopped: bool) -> None:
        with doing.work("all") as whole:
            for part in range(2):
                with dataclasses.replace(doing, at=whole).work(part) as work:
                    work.share(asking.place)
                    work.run(noted, [(part,)])
                if stopped:
                    raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        parts(stopped=True)
    (asking.place / "done").write_text("")
    parts(stopped=False)
    assert (asking.place / "done").read_text() == "1\n"
    assert asking.said == [WENT_ON.format(1)]
    assert list(cache.iterdir()) == []


STATED = """
from needle_rig.physics.library import find_effects
from needle_rig.workbench.answers import digest_of
from needle_rig.workbench.contest.strategies_table import Bout
from needle_rig.workbench.learning.learn import fit_known
from needle_rig.workbench.virtual.noise import Noise
from tests.workbench.hidden import dataset

saved = fit_known(dataset(), find_effects(), ())
print(digest_of(Bout(saved.model, 1e-4, Noise(), saved)), digest_of(find_effects()))
"""


@pytest.mark.whole
def test_one_task_has_one_name_in_every_process() -> None:
    """A set of names has an order of its own in each."""
    root = str(Path(__file__).parents[2])
    named = [
        subprocess.run(
            [sys.executable, "-c", STATED],
            env=os.environ | {"PYTHONHASHSEED": seed, "PYTHONPATH": root},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    ]
    assert len(named[0].split()) == 2
    assert set(named) == {named[0]}


def test_a_working_folder_that_is_gone_costs_nothing_but_the_work(
    asking: Asking, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    assert asking.answered(2) == [0, 1]
    assert len(asking.told) == 1


def test_a_question_that_is_refused_before_any_task_leaves_nothing(asking: Asking, cache: Path) -> None:
    with pytest.raises(BadInput), asking.work():
        raise BadInput("no")
    assert list(cache.iterdir()) == []
