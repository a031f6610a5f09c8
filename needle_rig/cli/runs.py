"""`needle-rig runs`: what has been recorded."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._runs import config_option, directory_option, runs_directory
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.recording import RunSummary


@click.command()
@directory_option
@config_option
@click.option("--json", "as_json", is_flag=True, help="One JSON list on stdout.")
def command(directory: Path | None, config_path: Path | None, as_json: bool) -> None:
    """List the recorded runs, oldest first.

    Status: aligned, not_aligned, aborted or fault for a run that ended; running; cut off when the power, the
    daemon or its recorder went before it ended (what was recorded is readable); unreadable.
    """
    from needle_rig.config.places import show_path
    from needle_rig.recording import list_runs

    folder = runs_directory(directory, config_path)
    found = list_runs(folder)
    if as_json:
        click.echo(json.dumps([_as_json(run) for run in found], indent=1, ensure_ascii=False))
        return
    if not found:
        click.echo(f"No runs in {show_path(folder)}; make one with: needle-rig compensate --target 45")
        return
    rows: list[tuple[str, ...]] = [
        ("run", "rig", "time (UTC)", "target", "strategy", "parameters", "status", "duration")
    ]
    rows += [_row(run) for run in found]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    for row in rows:
        cells = [
            cell.rjust(width) if column in (3, 7) else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ]
        click.echo("  ".join(cells).rstrip())


def _row(run: RunSummary) -> tuple[str, ...]:
    target = "" if math.isnan(run.target_deg) else f"{run.target_deg:g}°"
    started = run.started_utc[:19].replace("T", " ")
    rig = {True: "simulated", False: "real", None: ""}[run.simulated]
    return (
        run.name,
        rig,
        started,
        target,
        run.strategy,
        run.parameters,
        run.status,
        f"{run.duration_s:.1f} s",
    )


def _as_json(run: RunSummary) -> JsonObject:
    return {
        "name": run.name,
        "path": str(run.path),
        "simulated": run.simulated,
        "started_utc": run.started_utc or None,
        "target_deg": None if math.isnan(run.target_deg) else run.target_deg,
        "strategy": run.strategy or None,
        "parameters": run.parameters or None,
        "status": run.status,
        "duration_s": round(run.duration_s, 6),
        "complete": run.complete,
    }
