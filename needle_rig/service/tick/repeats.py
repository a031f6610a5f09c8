"""Keeps a log readable: what comes and goes many times is logged at once, and then once a minute."""

from __future__ import annotations

QUIET_S = 60.0
"""A link with a loose plug fails some hundred times a minute: one line for all of them."""


class Repeats:
    """Which of the things that happen again and again are worth a line."""

    def __init__(self) -> None:
        self._told: dict[str, tuple[float, int]] = {}

    def count(self, key: str, now_s: float) -> int | None:
        """How often `key` happened since it was reported last, this one included; None: tell nothing."""
        told_s, withheld = self._told.get(key, (-QUIET_S, 0))
        if now_s - told_s < QUIET_S:
            self._told[key] = (told_s, withheld + 1)
            return None
        self._told[key] = (now_s, 0)
        return withheld + 1
