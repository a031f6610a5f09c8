"""`needle-rig clear`: lets the running daemon leave a fault."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._motion import commanding, socket_option


@click.command()
@socket_option
def command(socket: Path | None) -> None:
    """Leave a fault once its cause is gone; a cause that is still there brings the fault back."""
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    with commanding(client, "clear"):
        client.command("clear")
    click.echo(f"The fault is cleared ({client.path}); see `needle-rig status`.")
