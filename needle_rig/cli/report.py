"""`needle-rig report`: one file for an issue."""

from __future__ import annotations

from pathlib import Path

import click

from needle_rig.cli._runs import config_option, directory_option


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--run/--no-run", "with_run", default=True, help="Add the last run that ended.")
@directory_option
@config_option
def command(file: Path | None, with_run: bool, directory: Path | None, config_path: Path | None) -> None:
    """Collect versions, status, check, log, configuration and the last run into FILE, for an issue.

    FILE is a ZIP archive; without it, needle-rig-report-DATE.zip here. Values of keys such as password and
    token are left out. Look through it before you send it.

    \b
    Exit codes: 0 done, 2 bad use, 3 FILE cannot be written.
    """
    from datetime import UTC, datetime

    from needle_rig.cli._runs import runs_directory
    from needle_rig.errors import BadInput
    from needle_rig.service.installed.installation import HERE
    from needle_rig.service.setup.problem_report import write_report

    path = file or Path(f"needle-rig-report-{datetime.now(UTC):%Y-%m-%d_%H-%M-%SZ}.zip")
    runs = None
    if with_run:
        try:
            runs = runs_directory(directory, config_path)
        except BadInput:  # a rig file that is wrong is what the report may be about
            runs = HERE.runs
    for line in write_report(HERE, path, runs):
        click.echo(f"  {line}")
    click.echo(f"{path}: look through it, then attach it to the issue.")
