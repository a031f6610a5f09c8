"""`needle-rig stop`: stops the drive of the running daemon."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import socket_option


@click.command()
@socket_option
@click.option("--reason", default="stopped by a person", help="What the record says.")
def command(socket: Path | None, reason: str) -> None:
    """Stop the drive; a run that goes on ends as aborted. The daemon itself stays."""
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    client.stop(reason)
    click.echo(f"The drive is told to stop ({client.path}).")
