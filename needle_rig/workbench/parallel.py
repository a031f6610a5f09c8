"""Independent tasks here, in several processes or on a Dask cluster: the same results in the same order."""

from __future__ import annotations

import multiprocessing
import os
import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Protocol, Self

from needle_rig.errors import BadInput

Task = tuple[Any, ...]
Progress = Callable[[int, int], None]
"""Called with (tasks done, tasks in this round)."""


class Work(Protocol):
    """Runs `function(shared, *task)` for every task, results in the order of the tasks."""

    def share(self, shared: Any) -> None:
        """Give every later task this first argument."""

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """The results, in order."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Here:
    """In this process."""

    def __init__(self, progress: Progress | None = None) -> None:
        self._progress = progress or _quiet
        self._shared: Any = None

    def share(self, shared: Any) -> None:
        """Keep it."""
        self._shared = shared

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """Results in the order of the tasks."""
        results = []
        for done, task in enumerate(tasks, 1):
            results.append(function(self._shared, *task))
            self._progress(done, len(tasks))
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._shared = None


_SHARED: dict[str, Any] = {}


def _call(path: str, function: Callable[..., Any], task: Task) -> Any:
    if path not in _SHARED:
        _SHARED.clear()
        _SHARED[path] = pickle.loads(Path(path).read_bytes())
    return function(_SHARED[path], *task)


class Processes:
    """In `jobs` processes, started afresh (spawn), so that nothing of this one leaks into them."""

    def __init__(self, jobs: int, progress: Progress | None = None) -> None:
        if jobs < 1:
            raise BadInput(f"--jobs {jobs}: give at least 1")
        self._progress = progress or _quiet
        for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
            os.environ.setdefault(
                name, "1"
            )  # small matrices: threads of each process would only get in the way
        self._pool = ProcessPoolExecutor(jobs, mp_context=multiprocessing.get_context("spawn"))
        self._folder = TemporaryDirectory(prefix="needle-rig-")
        self._path, self._round = "", 0

    def share(self, shared: Any) -> None:
        """Write it to a file, which every process reads once."""
        self._round += 1
        path = Path(self._folder.name) / f"shared-{self._round}.pickle"
        path.write_bytes(pickle.dumps(shared, protocol=pickle.HIGHEST_PROTOCOL))
        self._path = str(path)

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """Results in the order of the tasks."""
        futures = [self._pool.submit(_call, self._path, function, task) for task in tasks]
        results = []
        for done, future in enumerate(futures, 1):
            results.append(future.result())
            self._progress(done, len(tasks))
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(cancel_futures=True)
        self._folder.cleanup()


class Cluster:
    """On a Dask cluster. Raises BadInput when `distributed` is not installed or nothing answers."""

    def __init__(self, address: str, progress: Progress | None = None) -> None:
        try:
            from distributed import Client
        except ImportError as error:
            raise BadInput("--cluster needs the optional extra: pip install 'needle-rig[cluster]'") from error
        self._progress = progress or _quiet
        connect: Any = Client
        try:
            self._client: Any = connect(address, timeout="10s")
        except (OSError, TimeoutError, ValueError) as error:
            raise BadInput(f"--cluster {address}: no scheduler answers there ({error})") from error
        self._shared: Any = None

    def share(self, shared: Any) -> None:
        """Send it to every worker."""
        self._shared = self._client.scatter(shared, broadcast=True, hash=False)

    def run(self, function: Callable[..., Any], tasks: Sequence[Task]) -> list[Any]:
        """Results in the order of the tasks."""
        futures = [self._client.submit(function, self._shared, *task, pure=False) for task in tasks]
        results = []
        for done, future in enumerate(futures, 1):
            results.append(future.result())
            self._progress(done, len(tasks))
        return results

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._client.close()


def workers(jobs: int | None, cluster: str | None, progress: Progress | None = None) -> Work:
    """Where tasks run: a cluster when given, else `jobs` processes (default: one a core), else here."""
    if cluster:
        return Cluster(cluster, progress)
    count = len(os.sched_getaffinity(0)) if jobs is None else jobs
    return Here(progress) if count == 1 else Processes(count, progress)


def _quiet(done: int, total: int) -> None:
    del done, total
