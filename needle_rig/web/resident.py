"""A process that stays for short answers, since the first needs the solver compiled: lines in, lines out."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import sys
from collections.abc import Callable
from typing import Any

from needle_rig.errors import BadInput, NeedleRigError, RigFault
from needle_rig.web.worker import NICE, Voice

LINE_BYTES = 16 << 20
PATIENCE_S = 300.0
"""The first start compiles the solver."""


class Resident:
    """The process as the server sees it: started at the first question, one answer at a time."""

    def __init__(self, directories: tuple[str, ...]) -> None:
        self._directories = directories
        self._process: asyncio.subprocess.Process | None = None
        self._alone = asyncio.Lock()

    async def start(self) -> None:
        """Have it ready before the first question."""
        async with self._alone:
            await self._running()

    async def ask(self, question: str, **given: Any) -> Any:
        """The answer to `effects`, `lesson`, `expect`, `trends` or `openapi`, with what it is given.

        Raises BadInput, RigFault.
        """
        async with self._alone:
            process = await self._running()
            assert process.stdin is not None
            assert process.stdout is not None
            line = b""
            with contextlib.suppress(ConnectionError, TimeoutError):
                process.stdin.write(json.dumps({"question": question, "given": given}).encode() + b"\n")
                await process.stdin.drain()
                line = await asyncio.wait_for(process.stdout.readline(), PATIENCE_S)
        if not line:
            self.close()
            raise RigFault("the process that computes this ended; try again")
        answer = json.loads(line)
        if "error" in answer:
            raise BadInput(answer["error"])
        return answer["result"]

    async def _running(self) -> asyncio.subprocess.Process:
        if self._process is None or self._process.returncode is not None:
            self._process = await asyncio.create_subprocess_exec(
                *(sys.executable, "-m", "needle_rig.web.resident", *self._directories),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                limit=LINE_BYTES,
                start_new_session=True,
            )
        return self._process

    def close(self) -> None:
        """End it."""
        if self._process is not None and self._process.returncode is None:
            with contextlib.suppress(ProcessLookupError):
                self._process.kill()
        self._process = None


def main() -> None:
    """Answer until stdin ends."""
    os.nice(NICE)
    voice = Voice()
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.model import effect_directories
    from needle_rig.web.expectation import Expectations
    from needle_rig.web.lessons import effects_document, lesson
    from needle_rig.web.trends import trends

    directories = effect_directories(tuple(sys.argv[1:]))
    answers: dict[str, Callable[..., Any]] = {
        "effects": lambda: effects_document(directories),
        "lesson": lambda **given: lesson(directories=directories, **given),
        "expect": Expectations().after,
        "trends": trends,
        "openapi": _openapi,
    }
    for line in sys.stdin:
        asked = json.loads(line)
        try:
            voice.tell(result=answers[asked["question"]](**asked["given"]))
        except NeedleRigError as error:
            voice.tell(error=str(error))


def _openapi() -> dict[str, Any]:
    """The server as OpenAPI; its types are of modules that take 60 MB, so they wait for the question."""
    from needle_rig.web.openapi import openapi_document

    return openapi_document()


if __name__ == "__main__":
    main()
