"""`needle-rig clear`: lets the running daemon leave a fault."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.option(
    "--socket", type=click.Path(path_type=Path), help="Socket of the daemon; default: the usual one."
)
def command(socket: Path | None) -> None:
    """Leave a fault once its cause is gone; a cause that is still there brings the fault back."""
    from needle_rig.service.client import the_daemon

    client = the_daemon(socket)
    client.clear()
    click.echo(f"The fault is cleared ({client.path}); see `needle-rig status`.")
