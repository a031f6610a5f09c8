"""How a question is worked: in how many processes, and who hears how far it is."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from needle_rig.workbench.parallel import Work


def _unheard(_: str) -> None:
    return


def _uncounted(results: Iterable[Any], _: int) -> Iterable[Any]:
    return results


@dataclass(frozen=True, slots=True, kw_only=True)
class Doing:
    """How one question is worked; the answer does not depend on it.

    A worker of the page is cancelled by its end, a command and a cell by KeyboardInterrupt: nothing here
    catches it, and `work` ends its processes. A question that was stopped so, or by a machine without power,
    goes on from what was done when it is re-run.
    """

    jobs: int | None = None
    """Processes; None: one a core."""
    cluster: str | None = None
    """Address of a Dask scheduler that takes their place."""
    say: Callable[[str], None] = _unheard
    """Hears each step that begins."""
    tell: Callable[[str], None] = _unheard
    """Hears sentences that are worth reading before the answer."""
    progress: Callable[[Iterable[Any], int], Iterable[Any]] = _uncounted
    """Hands on the results of a step, of which there will be so many, and counts them."""

    at: Work | None = None
    """Where tasks run already, for a question that is a part of another."""

    @contextmanager
    def work(self, question: object) -> Iterator[Work]:
        """Where tasks of `question` run: what is done is kept until it is answered. Raises BadInput."""
        from needle_rig.workbench.answers import answers_of
        from needle_rig.workbench.parallel import workers

        if self.at is not None:
            yield self.at
            return
        with (
            answers_of(repr(question), self.say, self.tell) as answers,
            workers(self.jobs, self.cluster, self.progress, answers) as work,
        ):
            yield work


SILENT = Doing()
