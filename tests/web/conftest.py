import dataclasses
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.closed_loop.shell import Shell, all_gone
from tests.web.served import Served


def started(shell: Shell, *arguments: str) -> Iterator[Served]:
    """The page of these arguments, ended at the end with all of its processes."""
    own = dataclasses.replace(shell, mark=uuid.uuid4().hex)
    with own.start("web", *arguments) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert "the page: " in line, process.communicate()[1]
        yield Served(own, process, line.split("the page: ")[1].strip())
        process.terminate()
        process.communicate(timeout=30)
    all_gone(own.processes())


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    with tempfile.TemporaryDirectory(prefix="nr-") as temporary:  # a socket's path must be short
        yield Shell(tmp_path_factory.mktemp("page"), temporary=temporary)


@pytest.fixture(scope="module")
def served(shell: Shell) -> Iterator[Served]:
    """Without a rig and without data."""
    yield from started(shell, "--dir", str(Path(shell.folder) / "runs"))
