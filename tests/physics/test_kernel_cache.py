"""The kept machine code of the kernel is as old as the newest of its sources."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba.core.dispatcher import Dispatcher

from needle_rig.physics import kernel
from needle_rig.physics.kernel.run import _run

KERNEL = Path(kernel.__file__).parent
INNER = "from two_files._compile import compiled\n\n\n@compiled\ndef added(x):\n    return x + {}\n"
OUTER = """
from two_files._cache import keep_by_package, kept
from two_files.inner import added

keep_by_package()


@kept("float64(float64)")
def run(x):
    return added(x)
"""
ASK = "from two_files.outer import run; print(run(1.0), sum(run.stats.cache_hits.values()))"


Ask = Callable[[str], tuple[float, int]]


@pytest.fixture(params=["beside the sources", "NUMBA_CACHE_DIR"])
def ask(request: pytest.FixtureRequest, tmp_path: Path) -> Ask:
    """Asks a package of two files, kept as the kernel is, in a new process: its answer and the cache hits."""
    package = tmp_path / "two_files"
    package.mkdir()
    for name in ("__init__.py", "_cache.py", "_compile.py"):
        shutil.copy(KERNEL / name, package / name)
    (package / "outer.py").write_text(OUTER)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")}
    if request.param == "NUMBA_CACHE_DIR":
        environment["NUMBA_CACHE_DIR"] = str(tmp_path / "kept")

    def asked(summand: str) -> tuple[float, int]:
        (package / "inner.py").write_text(INNER.format(summand))
        done = subprocess.run(
            [sys.executable, "-c", ASK], cwd=tmp_path, env=environment, check=True, capture_output=True
        )
        answer, hits = done.stdout.split()
        return float(answer), int(hits)

    return asked


@pytest.mark.whole
def test_a_change_in_a_file_of_what_is_called_is_compiled_and_no_change_is_not(ask: Ask) -> None:
    assert ask("1.0") == (2.0, 0)
    assert ask("1.0") == (2.0, 1)
    assert ask("100.0") == (101.0, 0)
    assert ask("100.0") == (101.0, 1)


@pytest.mark.whole
@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
def test_what_a_power_cut_left_of_it_is_compiled_anew(ask: Ask, tmp_path: Path, suffix: str) -> None:
    ask("1.0")
    (cut,) = tmp_path.rglob(f"*{suffix}")
    for length in (0, cut.stat().st_size // 2):
        os.truncate(cut, length)
        assert ask("1.0") == (2.0, 0)
        assert ask("1.0") == (2.0, 1)


NO_FOLDER = """
import sys
from numba.core import caching


def refused(self):
    raise PermissionError(13, "Permission denied")


caching._CacheLocator.ensure_cache_path = refused  # root may write anywhere
from two_files.outer import run
print(run(1.0))
"""


@pytest.mark.whole
def test_where_no_folder_can_be_written_it_compiles_and_says_so_once(ask: Ask, tmp_path: Path) -> None:
    """As of a read-only installation for a user without a home; and what this process starts says nothing."""
    ask("1.0")
    again = "import os, subprocess; " + f"subprocess.run([sys.executable, '-c', {NO_FOLDER!r}], check=True)"
    done = subprocess.run(
        [sys.executable, "-c", NO_FOLDER + again],
        cwd=tmp_path,
        env={key: value for key, value in os.environ.items() if not key.startswith("NUMBA_")},
        check=False,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, sorted(done.stdout.split())) == (0, ["2.0", "2.0"]), done.stderr
    assert done.stderr.count("compiled code cannot be kept") == 1
    assert "set NUMBA_CACHE_DIR to a folder that you can write" in done.stderr


def test_every_function_in_the_machine_code_stands_in_a_file_of_the_package() -> None:
    seen: set[Any] = set()
    to_see: list[Any] = [_run]
    while to_see:
        function = to_see.pop()
        seen.add(function)
        plain = getattr(function, "py_func", None) or function._defn
        assert Path(plain.__code__.co_filename).parent == KERNEL
        used = [plain.__globals__.get(name) for name in plain.__code__.co_names]
        to_see += [
            each
            for each in used
            if (isinstance(each, Dispatcher) or hasattr(each, "_defn")) and each not in seen
        ]
    assert len(seen) > 40
