"""`needle-rig backup`: keeps what a lost computer would take along."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--runs", "with_runs", is_flag=True, help="Keep all recorded runs as well.")
@click.option("--root", type=click.Path(path_type=Path), default=Path("/"), hidden=True)
def command(file: Path, with_runs: bool, root: Path) -> None:
    """Pack rig file, calibration and models of this computer's rig into FILE, each with its hash.

    FILE is written whole or not at all. `needle-rig restore FILE` puts it in place, also on a new computer.

    \b
    Exit codes: 0 done, 2 bad use or a run goes on (with --runs), 3 FILE cannot be written.
    """
    from needle_rig.service.installed.installation import Installation
    from needle_rig.service.setup.backup import back_up

    done = back_up(Installation(root.absolute()), file, with_runs=with_runs)
    for sentence in done.told:
        click.echo(f"warning: {sentence}", err=True)
    runs = f", {done.runs} of them runs" if with_runs else "; the runs are not in it, --runs adds them"
    click.echo(f"{file}: {done.files} files, {done.size_bytes / 1e6:.3g} MB{runs}.")
