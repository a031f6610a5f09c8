"""`needle-rig hold`: keeps the base where it is."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import commanding, socket_option


@click.command()
@socket_option
def command(socket: Path | None) -> None:
    """Let the drive keep the base where it is, against the needle, until `release` or `stop`.

    \b
    Exit codes: 0 it holds, 2 bad use or somebody else commands the rig, 3 a fault of the rig.
    """
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    with commanding(client, "hold"):
        client.command("hold")
    click.echo("The base is held; let go with: needle-rig release")
