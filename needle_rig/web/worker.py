"""One piece of work in a process of its own: `python -m needle_rig.web.worker`.

A request is one line on stdin, what is said comes as lines on stdout: steps, progress, a result or an error.
The process is a session of its own, below the tick in priority, and ends with whoever started it.
"""

from __future__ import annotations

import json
import os
import sys
import traceback
from collections.abc import Iterable, Iterator
from typing import Any

from needle_rig.errors import NeedleRigError
from needle_rig.parent import end_with
from needle_rig.web.bounds import bound, too_large
from needle_rig.workbench.parallel import one_thread_each

NICE = 10
"""Whoever drives a rig on this computer goes first."""


class Voice:
    """Says on the process's own stdout how far the work is; what libraries print goes to stderr."""

    def __init__(self) -> None:
        self._out = os.fdopen(os.dup(1), "w", encoding="utf-8")
        os.dup2(2, 1)

    def tell(self, **said: Any) -> None:
        """One line."""
        self._out.write(json.dumps(said, ensure_ascii=False, allow_nan=False) + "\n")
        self._out.flush()

    def step(self, text: str) -> None:
        """What is begun now."""
        self.tell(step=text)

    def progress(self, results: Iterable[Any], total: int) -> Iterator[Any]:
        """Hands on `results` and counts them."""
        for done, result in enumerate(results, 1):
            yield result
            self.tell(done=done, total=total)


def main() -> None:
    """Do what stdin asks for."""
    os.nice(NICE)
    one_thread_each()
    voice = Voice()
    request = json.loads(sys.stdin.readline())
    end_with(sys.stdin.fileno())
    try:
        from needle_rig.questions.doing import Doing
        from needle_rig.web.work import work

        doing = Doing(jobs=request.pop("jobs"), say=voice.step, progress=voice.progress)
        kind = request.pop("kind")
        bound(kind)
        voice.tell(result=work(kind, request, doing))
    except NeedleRigError as error:
        voice.tell(error=str(error))
    except MemoryError:
        voice.tell(error=too_large())
    except Exception:  # noqa: BLE001 - the page gets a defect in a line, and whole on stderr
        traceback.print_exc()
        said = traceback.format_exc().strip().splitlines()[-1]
        voice.tell(error=f"a defect of this program: {said}")


if __name__ == "__main__":
    main()
