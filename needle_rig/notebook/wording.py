"""Sentences of the workbench in the words of Python: questions for commands, arguments for options."""

from __future__ import annotations

import re
from collections.abc import Iterable

from needle_rig.notebook.asking import in_python

QUESTIONS = (
    *("compare", "diagnose", "effects", "experiment", "export", "identify", "learn", "parameters"),
    "strategies",
)
"""Commands that are functions here, too."""
_COMMAND = re.compile(rf"needle-rig ({'|'.join(QUESTIONS)})\b(?: [^\s;,]+)?")
_TYPED = re.compile(r"(`[^`]*`)")


def as_python(text: str) -> str:
    """A sentence for Python. What stands between backquotes is typed in a shell, and stays."""
    parts = _TYPED.split(text)
    parts[::2] = [in_python(_COMMAND.sub(r"nr.\1", part)) for part in parts[::2]]
    return "".join(parts)


def all_as_python(texts: Iterable[str]) -> tuple[str, ...]:
    """Several."""
    return tuple(map(as_python, texts))
