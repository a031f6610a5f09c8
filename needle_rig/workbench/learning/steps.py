"""Steps of work whose number is known before the first begins."""

from __future__ import annotations

from itertools import count

from needle_rig.workbench.selection.answer import Say


def numbered(say: Say, total: int) -> Say:
    """`say` with the number of each step among `total`."""
    numbers = count(1)
    return lambda text: say(f"{text} ({next(numbers)} of {total})")
