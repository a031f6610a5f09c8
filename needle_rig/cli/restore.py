"""`needle-rig restore`: puts the rig of a backup in place."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--root", type=click.Path(path_type=Path), default=Path("/"), hidden=True)
def command(file: Path, root: Path) -> None:
    """Put what `needle-rig backup` packed into FILE in place: all of it, or nothing.

    Every file is held against its hash first. The folder of the rig file is exchanged as a whole, and what
    stood there is kept beside it as needle-rig.replaced. Runs are added to those that are there.

    \b
    Exit codes: 0 done, 2 a damaged file, or a run goes on, 3 the disk is full; with 2 and 3 nothing changed.
    """
    from needle_rig.service.installed.installation import Installation
    from needle_rig.service.setup.backup import restore
    from needle_rig.service.setup.install import is_active

    place = Installation(root.absolute())
    done = restore(place, file)
    for sentence in done.told:
        click.echo(f"note: {sentence}", err=True)
    click.echo(f"{done.files} files are back, {done.runs} of them runs; the rig file is {place.rig_file}.")
    if not place.unit.exists():
        click.echo("Next: needle-rig install-service")
    elif place.root == Path("/") and is_active():
        click.echo("The daemon runs with what it had; when nothing moves: sudo systemctl restart needle-rig")
