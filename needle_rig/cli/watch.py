"""needle-rig watch: whether a parameter of the rig has left its range, over the runs that were recorded."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._output import console
from needle_rig.cli._runs import config_option, directory_option, runs_directory
from needle_rig.cli._workbench import effects_option, json_option, number, terminal
from needle_rig.questions.question import Question

if TYPE_CHECKING:
    from needle_rig.workbench.learning.watched_runs import WatchedRun


@click.command("watch")
@directory_option
@config_option
@click.option(
    "--model", help="Parameter set or model file.  [default: recording.watch.model of the rig file]"
)
@click.option(
    "--reference",
    type=click.IntRange(10, 500),
    help="Runs of the reference period.  [default: the rig file's, 20]",
)
@effects_option
@click.option("--list", "as_list", is_flag=True, help="Show what every run said.")
@click.option("--restart", is_flag=True, help="Begin a new reference period with the next run.")
@json_option
def command(
    directory: Path | None,
    config_path: Path | None,
    model: str | None,
    reference: int | None,
    effects: tuple[str, ...],
    as_list: bool,
    restart: bool,
    as_json: bool,
) -> int:
    """Look at the runs that were not looked at yet, and say what changed against the reference period.

    \b
    needle-rig watch
    needle-rig watch --list
    needle-rig watch --restart      after a new needle, phantom or calibration

    The daemon does so after every run where the rig file has recording.watch. Exit code 1: something changed.
    """
    from needle_rig.config.places import show_path
    from needle_rig.config.schema import WatchSection
    from needle_rig.errors import BadInput
    from needle_rig.workbench.learning import watch
    from needle_rig.workbench.learning.watched_runs import kept_runs

    doing = terminal()
    folder = runs_directory(directory, config_path)
    if not folder.is_dir():
        raise BadInput(f"{show_path(folder)}: there is no such folder of runs; name it with --dir")
    section = None
    if model is not None or reference is not None:
        stated = {"model": model} | ({} if reference is None else {"reference_runs": reference})
        section = WatchSection.model_validate(stated)
    looked = watch.look(folder, Question(effects=effects).library(doing), section)
    if restart:
        if not looked:
            raise BadInput(
                f"{show_path(folder)}: another process looks at its runs, or it is not yours; wait"
            )
        watch.restart(folder)
    runs = kept_runs(folder)
    found = watch.said_of(folder, section)
    if as_json:
        listed = {"runs": [run.model_dump() for run in runs]} if as_list else {}
        click.echo(json.dumps(found.as_json() | listed, ensure_ascii=False))
    elif as_list:
        _show(runs)
    if not as_json:
        for sentence in found.sentences:
            click.echo(sentence)
        if not looked:
            click.echo("note: another process looks at new runs just now, or the folder is not yours")
    return 1 if found.changes or found.verdict == "unknown" else 0


def _show(runs: list[WatchedRun]) -> None:
    from rich.table import Table

    names = list(dict.fromkeys(name for run in runs for name in run.parameters))
    units = {name: one.unit for run in runs for name, one in run.parameters.items()}
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    table.add_column("run", no_wrap=True)
    for name in names:
        table.add_column(f"{name.rpartition('.')[2].partition('_nmm')[0]}\n{units[name]}")
    table.add_column("left\n× noise")
    for run in runs:
        if run.not_judged:
            table.add_row(run.run, f"not judged: {run.not_judged}")
            continue
        told = [run.parameters.get(name) for name in names]
        cells = ["—" if one is None else f"{one.value:.4g}" for one in told]
        table.add_row(run.run, *cells, number(run.misfit))
    console().print(table)
