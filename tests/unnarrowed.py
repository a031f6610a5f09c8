"""Values that tests ask for more than once."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def now(value: T) -> T:
    """`value`. What is asserted of it counts now only: mypy would believe it of an attribute ever after."""
    return value
