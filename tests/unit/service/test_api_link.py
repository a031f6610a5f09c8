"""How often the daemon tells its state."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from needle_rig.service.api_link import STATES_HZ, ApiLink


async def refuse(*_: Any) -> Any:
    raise AssertionError("nothing is asked here")


def told_at(ticks_s: Iterable[float]) -> list[float]:
    """When a state went out, s, with a tick at each of `ticks_s`."""
    told: list[float] = []
    link = ApiLink(refuse)
    lines: Any = SimpleNamespace(waiting_bytes=0, send=lambda _, document: told.append(document["now_s"]))
    link._lines, link._listeners = lines, 1
    for now_s in ticks_s:
        link.state(now_s, partial(dict, now_s=now_s))
    return told


@pytest.mark.parametrize("tick_hz", [20.0, 100.0, 200.0, 1000.0])
def test_states_go_out_thirty_times_a_second_whatever_the_tick(tick_hz: float) -> None:
    seconds = 10
    told = told_at(100.0 + tick / tick_hz for tick in range(int(seconds * tick_hz)))
    assert len(told) == pytest.approx(seconds * min(STATES_HZ, tick_hz), abs=2)


def test_a_pause_is_not_made_up_for() -> None:
    assert told_at((1.0, 9.0, 9.001, 9.002, 9.003)) == [1.0, 9.0, 9.001]
