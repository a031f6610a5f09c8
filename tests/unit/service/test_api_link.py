"""How often the daemon tells its state, and when it takes the API's process for one that hangs."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterable
from functools import partial
from types import SimpleNamespace
from typing import Any

import pytest

from needle_rig.service.api import api_link
from needle_rig.service.api.api_link import SILENT, STARTING, STATES_HZ, ApiLink


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


async def checks_until_it_hangs(first_word_at: int | None) -> int:
    """Of a process that speaks once, after some checks, or never."""
    own, theirs = socket.socketpair()
    process: Any = SimpleNamespace(wait=asyncio.Event().wait, returncode=None)
    link, checks = ApiLink(refuse), 0
    wait = asyncio.wait

    async def counted(*given: Any, **known: Any) -> Any:
        nonlocal checks
        if checks == first_word_at:
            theirs.send(b"alive {}\n")
        checks += 1
        return await wait(*given, **known)

    with pytest.MonkeyPatch.context() as patch, theirs:
        patch.setattr(api_link, "CHECK_S", 0.005)
        patch.setattr(asyncio, "wait", counted)
        assert await link._watch(process, own) == "hangs"
    return checks


def test_a_process_that_starts_slowly_is_waited_for_and_one_that_falls_silent_is_not() -> None:
    assert asyncio.run(checks_until_it_hangs(None)) == STARTING
    assert asyncio.run(checks_until_it_hangs(first_word_at=STARTING - 2)) <= STARTING - 1 + SILENT
    assert asyncio.run(checks_until_it_hangs(first_word_at=0)) <= 1 + SILENT
