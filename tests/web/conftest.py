import dataclasses
import tempfile
import uuid
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from needle_rig.notebook import simulate
from tests.closed_loop.shell import Shell, all_gone
from tests.web.looking import CHROMIUM, EVIL, PATIENCE_MS, WIDE, Open
from tests.web.served import Served
from tests.workbench.hidden import PROTOCOL


def started(shell: Shell, *arguments: str, before: Sequence[str] = ()) -> Iterator[Served]:
    """The page of these arguments, behind the command `before`, ended at the end with all its processes."""
    own = dataclasses.replace(shell, mark=uuid.uuid4().hex)
    with own.start("web", *arguments, before=before) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert "the page: " in line, process.communicate()[1]
        second = process.stdout.readline() if "--watchers" in arguments else ""
        addresses = line.split("the page: ")[1].strip(), second.partition("to watch alone: ")[2].strip()
        yield Served(own, process, *addresses)
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


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="no playwright: pip install playwright")
    with playwright.sync_playwright() as started_:
        found = started_.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture(scope="module")
def data(shell: Shell) -> Path:
    """A short series with a hidden effect, and one whose every name is an attack."""
    mine = shell.folder / "data" / "mine"
    simulate({"tissue_elasticity": 0.35}, protocol=PROTOCOL, seed=1, name="mine", out=mine)
    simulate({}, seed=2, name=EVIL, out=shell.folder / "data" / "names")
    description = shell.folder / "data" / "names" / "dataset.yaml"
    text = description.read_text().replace("hall_1", "'<i onclick=evil()>hall'", 1)
    description.write_text(text)
    for trial in (shell.folder / "data" / "names" / "trials").glob("*.csv"):
        rows = trial.read_text().replace("hall_1_deg", "<i onclick=evil()>hall_deg").replace("rotate", EVIL)
        trial.write_text(rows)
    return Path(shell.folder) / "data"


@pytest.fixture(scope="module")
def page_server(shell: Shell, data: Path) -> Iterator[Served]:
    """With the data and a simulated rig in virtual time."""
    runs = str(shell.folder / "runs")
    yield from started(shell, str(data), "--rig", "simulated", "--fast", "--dir", runs, "--jobs", "2")


@pytest.fixture
def visit(browser: Any, page_server: Served) -> Iterator[Open]:
    """Open the page; at the end it has made no request to another host and met no error of its own."""
    contexts = []
    wrong: list[str] = []

    def opened(
        where: str = "live", size: Any = WIDE, scheme: str = "light", served: Served = page_server
    ) -> Any:
        context = browser.new_context(viewport=size, color_scheme=scheme, reduced_motion="reduce")
        contexts.append(context)
        context.set_default_timeout(PATIENCE_MS)
        page = context.new_page()
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on(
            "request",
            lambda r: None if r.url.startswith((served.base, "blob:", "data:")) else wrong.append(r.url),
        )
        page.on(
            "console",
            lambda m: wrong.append(m.text) if "Content Security Policy" in m.text else None,
        )
        page.goto(served.address)
        page.goto(f"{served.base}/#/{where}")
        page.wait_for_selector("h1")
        return page

    yield opened
    for context in contexts:
        context.close()
    assert not wrong
