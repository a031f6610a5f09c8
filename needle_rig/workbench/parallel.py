"""Independent tasks here, in several processes or on a Dask cluster: the same results in the same order."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.context import SpawnContext, SpawnProcess
from pathlib import Path
from types import ModuleType
from typing import Any, Self

from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.extras import missing
from needle_rig.folders import temporary_folder
from needle_rig.parent import end_with_parent

Task = tuple[Any, ...]
Progress = Callable[[Iterable[Any], int], Iterable[Any]]
"""Hands on results as they come, of which there will be so many, and shows how far they are."""


def on_terminal(results: Iterable[Any], total: int) -> Iterable[Any]:
    """Hands on `results` with a bar and the time left on stderr: on a terminal, silent otherwise."""
    from rich.console import Console
    from rich.progress import track

    silent = total < 2 or not sys.stderr.isatty()  # noqa: PLR2004 one task has no way to go
    return track(results, "", total, console=Console(stderr=True), transient=True, disable=silent)


class Work:
    """Runs `function(shared, *task)` for every task: in this process."""

    processes = 1
    """That run at once."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress or (lambda results, _: results)
        self._shared: Any = None

    def share(self, shared: Any) -> None:
        """Give every later task this first argument."""
        self._shared = shared

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """The results, in the order of the tasks. Raises what a task raises."""
        return list(self._progress(self._results(function, tasks), len(tasks)))

    def _results(self, function: Callable[..., Any], tasks: Sequence[Task]) -> Iterator[Any]:
        return (function(self._shared, *task) for task in tasks)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._shared = None


class _Afresh(SpawnProcess):
    """A process that does not run the caller's main file again: a script would ask all its questions anew."""

    def start(self) -> None:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = ModuleType("__main__")
        try:
            super().start()
        finally:
            sys.modules["__main__"] = main


class _AfreshContext(SpawnContext):
    Process = _Afresh


class Processes(Work):
    """In `jobs` processes, started afresh (spawn), so that nothing of this one leaks into them."""

    def __init__(self, jobs: int, progress: Progress | None = None) -> None:
        super().__init__(progress)
        if jobs < 1:
            raise BadInput(f"jobs {jobs}: give at least 1")
        one_thread_each()
        self.processes = jobs
        # each process holds the pipes of the others' work: their end would not be seen
        self._pool = ProcessPoolExecutor(jobs, mp_context=_AfreshContext(), initializer=end_with_parent)
        self._closing = contextlib.ExitStack()
        self._folder = self._closing.enter_context(temporary_folder("needle-rig-jobs-"))
        self._round = 0

    def share(self, shared: Any) -> None:
        """Write it to a file, which every process reads once."""
        self._round += 1
        self._shared = self._folder / f"shared-{self._round}.pickle"
        self._shared.write_bytes(pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL))

    def _results(self, function: Callable[..., Any], tasks: Sequence[Task]) -> Iterator[Any]:
        futures = [self._pool.submit(_call, self._shared, function, task) for task in tasks]
        try:
            for future in futures:
                yield future.result()
        except BrokenProcessPool:
            raise NeedleRigError(
                "one of the jobs was ended from outside, as a machine does that is short of memory; "
                "try again with fewer"
            ) from None

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            # what they do takes minutes and is wanted no more
            for process in multiprocessing.active_children():
                process.terminate()
        self._pool.shutdown(cancel_futures=True)
        self._closing.close()


_SHARED: dict[Path, Any] = {}


def _call(path: Path, function: Callable[..., Any], task: Task) -> Any:
    if path not in _SHARED:
        _SHARED.clear()
        _SHARED[path] = pickle.loads(path.read_bytes())
    return function(_SHARED[path], *task)


class Cluster(Work):
    """On a Dask cluster. Raises BadInput when `distributed` is not installed or nothing answers."""

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        super().__init__(progress)
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

    def share(self, shared: Any) -> None:
        """Send it to every worker."""
        self._shared = self._client.scatter(shared, broadcast=True, hash=False)

    def _results(self, function: Callable[..., Any], tasks: Sequence[Task]) -> Iterator[Any]:
        futures = [self._client.submit(function, self._shared, *task, pure=False) for task in tasks]
        return (future.result() for future in futures)

    def __exit__(self, *_: object) -> None:
        self._client.close()


def workers(jobs: int | None, cluster: str | None, progress: Progress | None = None) -> Work:
    """Where tasks run: a cluster when given, else `jobs` processes (default: one a core), else here."""
    if cluster:
        return Cluster(cluster, progress)
    count = len(os.sched_getaffinity(0)) if jobs is None else jobs
    return Work(progress) if count == 1 else Processes(count, progress)


def one_thread_each() -> None:
    """Keep linear algebra on small matrices from starting threads, in processes that import NumPy later."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")
