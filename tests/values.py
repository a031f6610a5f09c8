"""What tests say of a value so that mypy can follow them."""

from __future__ import annotations

from typing import TypeVar

T = TypeVar("T")


def known(value: T | None) -> T:
    """`value`, which must be there."""
    assert value is not None
    return value


def now(value: T) -> T:
    """`value`. What is asserted of it counts now only: mypy would believe it of an attribute ever after."""
    return value
