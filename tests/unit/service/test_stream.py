import asyncio
import json

from needle_rig.service.stream import Stream


async def test_a_slow_listener_gets_every_event_but_only_the_newest_state() -> None:
    stream = Stream(rate_hz=10)
    with stream.listen() as listener:
        for n in range(50):
            stream.state(n * 1.0, lambda n=n: {"type": "state", "n": n})  # type: ignore[misc]
        stream.event({"type": "phase", "n": 1})
        stream.event({"type": "phase", "n": 2})
        ending = asyncio.ensure_future(stream.end())
        got = [json.loads(text) async for text in listener.messages()]
    await ending
    assert [(each["type"], each["n"]) for each in got] == [("phase", 1), ("phase", 2), ("state", 49)]


async def test_states_are_thinned_out_and_not_even_made_when_nobody_listens() -> None:
    stream = Stream(rate_hz=10)
    made = 0

    def describe() -> dict[str, int]:
        nonlocal made
        made += 1
        return {}

    stream.state(0.0, describe)
    assert made == 0
    with stream.listen():
        for n in range(200):
            stream.state(n * 0.005, describe)
    assert made == 10


async def test_a_waiting_listener_wakes_up() -> None:
    stream = Stream()
    with stream.listen() as listener:
        messages = listener.messages()
        waiting = asyncio.ensure_future(anext(messages))
        await asyncio.sleep(0)
        stream.event({"n": 7})
        assert json.loads(await waiting) == {"n": 7}
        await messages.aclose()  # type: ignore[attr-defined]


async def test_the_end_waits_until_the_last_event_is_fetched() -> None:
    stream, got = Stream(), []

    async def listen_slowly() -> None:
        with stream.listen() as listener:
            async for text in listener.messages():
                await asyncio.sleep(0.02)
                got.append(json.loads(text)["n"])

    listening = asyncio.ensure_future(listen_slowly())
    await asyncio.sleep(0)
    for n in range(3):
        stream.event({"n": n})
    await stream.end(wait_s=30.0)
    assert got == [0, 1, 2]
    await listening


async def test_the_end_does_not_wait_for_a_listener_that_fetches_nothing() -> None:
    stream = Stream()
    with stream.listen():
        await asyncio.wait_for(stream.end(wait_s=0.05), 5.0)
