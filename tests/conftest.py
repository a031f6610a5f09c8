"""What every test is held to: no asyncio task may outlive it."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings

# Where it decides whether a change lands, the same examples every time; elsewhere new ones.
settings.register_profile("needle-rig", deadline=None, print_blob=True, derandomize="CI" in os.environ)
settings.load_profile("needle-rig")


@pytest.fixture(autouse=True, scope="session")
def compiled_solver() -> None:
    """Compiles the solver before any test's time counts: half a minute on a machine that never ran it."""
    import numpy as np

    from needle_rig.model import load_parameters
    from needle_rig.physics.effect import Trial

    time_s = np.array([0.0, 0.1, 0.2])
    load_parameters("rig_elastic").truth(Trial(time_s, time_s))


@pytest.fixture(autouse=True)
def no_task_left_behind(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Fails a test whose event loop ends, or is closed, with tasks that are not done.

    asyncio.run cancels what is left without a word, so the tasks are looked at just before it does.
    """
    left: list[str] = []

    def watch(owner: type, loop_of: Any) -> None:
        close = owner.close

        def closing(self: Any) -> None:
            loop = loop_of(self)
            if loop is not None and not loop.is_closed():
                left.extend(f"{task.get_name()}: {task.get_coro()}" for task in asyncio.all_tasks(loop))
            close(self)

        monkeypatch.setattr(owner, "close", closing)

    watch(asyncio.Runner, lambda runner: runner._loop)
    watch(asyncio.BaseEventLoop, lambda loop: loop)
    yield
    assert not left, "asyncio tasks left behind:\n" + "\n".join(dict.fromkeys(left))
