"""The page's connection to the daemon: it ends when it is told to, whatever comes meanwhile."""

from __future__ import annotations

import asyncio
from pathlib import Path

from websockets.asyncio.server import ServerConnection, unix_serve

from needle_rig.web.rig_link import RigLink

TRIES = 20


def test_it_ends_while_messages_come_without_a_pause(tmp_path: Path) -> None:
    async def talk(stream: ServerConnection) -> None:
        while True:
            await stream.send('{"type": "state"}')
            await asyncio.sleep(0)

    async def main() -> None:
        async with unix_serve(talk, str(tmp_path / "s"), compression=None):
            for _ in range(TRIES):
                rig = RigLink(tmp_path / "s")
                rig.open()
                while not rig.reached:
                    await asyncio.sleep(0)
                async with asyncio.timeout(2.0):
                    await rig.close()

    asyncio.run(main())
