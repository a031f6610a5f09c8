"""Independent tasks here, in several processes or on a Dask cluster: the same results in the same order."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from functools import partial
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any, Self

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.extras import missing
from needle_rig.folders import temporary_folder
from needle_rig.parent import end_with_parent
from needle_rig.workbench.answers import Answers, digest_of

Task = tuple[Any, ...]
Keep = Callable[[bytes], None]
Progress = Callable[[Iterable[Any], int], Iterable[Any]]
"""Hands on results as they come, of which there will be so many, and shows how far they are."""


def on_terminal(results: Iterable[Any], total: int) -> Iterable[Any]:
    """Hands on `results` with a bar and the time left on stderr: on a terminal, silent otherwise."""
    from rich.console import Console
    from rich.progress import track

    silent = total < 2 or not sys.stderr.isatty()  # noqa: PLR2004 one task has no way to go
    return track(results, "", total, console=Console(stderr=True), transient=True, disable=silent)


class Work:
    """Runs `function(shared, *task)` for every task: in this process.

    A `with` within that of its owner leaves it open.
    """

    processes = 1
    """That run at once."""

    def __init__(self, progress: Progress | None = None, answers: Answers | None = None) -> None:
        self._progress = progress or (lambda results, _: results)
        self._answers = answers
        self._shared: Any = None
        self._asked = ""
        self._within = 0

    def share(self, shared: Any) -> None:
        """Give every later task this first argument."""
        self._shared = self._placed(shared)
        if self._answers is not None:
            self._asked = digest_of(shared)

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """The results, in the order of the tasks. Raises what a task raises."""
        asked = [self._ask(function, task) for task in tasks]
        return list(self._progress((answer() for answer in asked), len(tasks)))

    def _ask(self, function: Callable[..., Any], task: Task) -> Callable[[], Any]:
        """What gives the answer: that of an earlier process, which was stopped, or of a task begun now."""
        if self._answers is None:
            return self._begin(function, task, lambda _: None)
        key = self._answers.key(self._asked, function, task)
        known = self._answers.find(key)
        if known is not None:
            return lambda: known[0]
        return self._begin(function, task, partial(self._answers.keep, key))

    def _placed(self, shared: Any) -> Any:
        """`shared` where tasks find it."""
        return shared

    def _begin(self, function: Callable[..., Any], task: Task, keep: Keep) -> Callable[[], Any]:
        """Begin a task; `keep` gets its pickled answer as soon as that is there."""

        def answer() -> Any:
            if self._answers is None:
                return function(self._shared, *task)
            answered = _pickled(function, self._shared, *task)
            keep(answered)
            return pickle.loads(answered)

        return answer

    def _end(self, kind: type[BaseException] | None) -> None:  # noqa: ARG002 nothing else runs here
        """Free what this holds; `kind` is what ended the work early."""
        self._shared = None

    def __enter__(self) -> Self:
        self._within += 1
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._within -= 1
        if not self._within:
            self._end(kind)


def _pickled(function: Callable[..., Any], *arguments: Any) -> bytes:
    """The answer in the form that is kept, so that one that was kept and one that is new are the same."""
    return pickle.dumps(function(*arguments), protocol=pickle.HIGHEST_PROTOCOL)


class _Afresh(SpawnProcess):
    """A process that does not run the caller's main file again: a script would ask all its questions anew."""

    def start(self) -> None:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            with _signals_at_the_end():
                super().start()
        finally:
            sys.modules["__main__"] = main


@contextmanager
def _signals_at_the_end() -> Iterator[None]:
    """What would raise here is handled when this is done: a child would wait for data that never come."""
    came: list[int] = []
    here = threading.current_thread() is threading.main_thread()
    try:
        with ExitStack() as afterwards:
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP) if here else ():
                if callable(before := signal.getsignal(number)):
                    signal.signal(number, lambda caught, _: came.append(caught))
                    afterwards.callback(signal.signal, number, before)
            yield
    finally:
        for caught in came:
            signal.raise_signal(caught)


class _AfreshContext(SpawnContext):
    Process = _Afresh


class Processes(Work):
    """In `jobs` processes, started afresh (spawn), so that nothing of this one leaks into them."""

    def __init__(self, jobs: int, progress: Progress | None = None, answers: Answers | None = None) -> None:
        super().__init__(progress, answers)
        if jobs < 1:
            raise BadInput(f"jobs {jobs}: give at least 1")
        one_thread_each()
        self.processes = jobs
        # each process holds the pipes of the others' work: their end would not be seen
        self._pool = ProcessPoolExecutor(jobs, mp_context=_AfreshContext(), initializer=end_with_parent)
        self._stack = ExitStack()
        self._folder = self._stack.enter_context(temporary_folder("needle-rig-tasks-"))
        self._round = 0

    def _placed(self, shared: Any) -> Path:
        """Written to a file, which every process reads once."""
        self._round += 1
        place = self._folder / f"shared-{self._round}.pickle"
        place.write_bytes(pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL))
        return place

    def _begin(self, function: Callable[..., Any], task: Task, keep: Keep) -> Callable[[], Any]:
        future = self._pool.submit(_call, self._shared, function, task)
        future.add_done_callback(partial(_keep, keep))
        return partial(_answered, future)

    def _end(self, kind: type[BaseException] | None) -> None:
        if kind is not None:
            # what they do takes minutes and is wanted no more
            for process in multiprocessing.active_children():
                process.terminate()
        self._pool.shutdown(cancel_futures=True)
        self._stack.close()


def _answered(future: Future[bytes]) -> Any:
    try:
        return pickle.loads(future.result())
    except BrokenProcessPool:
        raise NeedleRigError(
            "one of the jobs was ended from outside, as a machine does that is short of memory; "
            "try again with fewer"
        ) from None


def _keep(keep: Keep, done: Future[bytes]) -> None:
    """Keep the answer of a future that has one."""
    if not done.cancelled() and done.exception() is None:
        keep(done.result())


_SHARED: dict[Path, Any] = {}


def _call(path: Path, function: Callable[..., Any], task: Task) -> bytes:
    if path not in _SHARED:
        _SHARED.clear()
        _SHARED[path] = pickle.loads(path.read_bytes())
    return _pickled(function, _SHARED[path], *task)


class Cluster(Work):
    """On a Dask cluster. Raises BadInput when `distributed` is not installed or nothing answers."""

    def __init__(
        self, address: str, progress: Progress | None = None, answers: Answers | None = None
    ) -> None:
        super().__init__(progress, answers)
        try:
            from distributed import Client
        except ImportError as error:
            raise missing("a cluster", "distributed", "cluster") from error
        connect: Any = Client
        try:
            self._client: Any = connect(address, timeout="10s")
        except (OSError, TimeoutError, ValueError) as error:
            raise BadInput(f"cluster {address}: no scheduler answers there ({error})") from error
        self.processes = max(1, sum(self._client.ncores().values()))

    def _placed(self, shared: Any) -> Any:
        """Sent to every worker."""
        return self._client.scatter(shared, broadcast=True, hash=False)

    def _begin(self, function: Callable[..., Any], task: Task, keep: Keep) -> Callable[[], Any]:
        future = self._client.submit(_pickled, function, self._shared, *task, pure=False)

        def answer() -> Any:
            answered = future.result()
            keep(answered)
            return pickle.loads(answered)

        return answer

    def _end(self, kind: type[BaseException] | None) -> None:  # noqa: ARG002 tasks end with their client
        self._client.close()


def workers(
    jobs: int | None, cluster: str | None, progress: Progress | None = None, answers: Answers | None = None
) -> Work:
    """Where tasks run: a cluster when given, else `jobs` processes (default: one a core), else here."""
    if cluster:
        return Cluster(cluster, progress, answers)
    count = len(os.sched_getaffinity(0)) if jobs is None else jobs
    return Work(progress, answers) if count == 1 else Processes(count, progress, answers)


def one_thread_each() -> None:
    """Keep linear algebra on small matrices from starting threads, in processes that import NumPy later."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
