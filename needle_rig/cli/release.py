"""`needle-rig release`: lets go of the base."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import commanding, socket_option


@click.command()
@socket_option
def command(socket: Path | None) -> None:
    """Let go of the base: the drive's supply opens and a hand may turn it.

    \b
    Exit codes: 0 done, 2 a sequence runs or somebody else commands the rig, 3 a fault of the rig.
    """
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    with commanding(client, "release"):
        client.command("release")
    click.echo("The base is free.")
