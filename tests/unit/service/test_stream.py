import asyncio

from needle_rig.service.api.stream import Stream


async def test_a_slow_listener_gets_every_event_but_only_the_newest_state() -> None:
    stream = Stream()
    with stream.listen() as listener:
        for n in range(50):
            stream.state(f"state {n}")
        stream.event("event 1")
        stream.event("event 2")
        ending = asyncio.ensure_future(stream.end())
        got = [text async for text in listener.messages()]
    await ending
    assert got == ["event 1", "event 2", "state 49"]


async def test_it_is_told_how_many_listen() -> None:
    told: list[int] = []
    stream = Stream(told.append)
    with stream.listen():
        with stream.listen():
            pass
        assert told == [1, 2, 1]
    assert told[-1] == 0


async def test_a_waiting_listener_wakes_up() -> None:
    stream = Stream()
    with stream.listen() as listener:
        messages = listener.messages()
        waiting = asyncio.ensure_future(anext(messages))
        await asyncio.sleep(0)
        stream.event("7")
        assert await waiting == "7"
        await messages.aclose()  # type: ignore[attr-defined]


async def test_the_end_waits_until_the_last_event_is_fetched() -> None:
    stream, got = Stream(), []

    async def listen_slowly() -> None:
        with stream.listen() as listener:
            async for text in listener.messages():
                await asyncio.sleep(0.02)
                got.append(text)

    listening = asyncio.ensure_future(listen_slowly())
    await asyncio.sleep(0)
    for n in range(3):
        stream.event(str(n))
    await stream.end(wait_s=30.0)
    assert got == ["0", "1", "2"]
    await listening


async def test_the_end_does_not_wait_for_a_listener_that_fetches_nothing() -> None:
    stream = Stream()
    with stream.listen():
        await asyncio.wait_for(stream.end(wait_s=0.05), 5.0)
