"""needle-rig experiment: the trial that would best tell two effects apart."""

from __future__ import annotations

import json
from pathlib import Path

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    json_option,
    library,
    model_option,
    read_data,
    read_model,
    say,
)


@click.command("experiment")
@data_argument
@click.option(
    "--between", shell_complete=completing("effects"), nargs=2, required=True, metavar="EFFECT EFFECT"
)
@model_option
@effects_option
@click.option("--out", type=click.Path(path_type=Path), help="Protocol file; default: EFFECT-or-EFFECT.yaml.")
@click.option(
    "--config",
    "rig",
    type=click.Path(path_type=Path),
    help="Rig file whose limits hold; default: the shipped one.",
)
@json_option
def command(
    data: tuple[Path, ...],
    between: tuple[str, str],
    model_path: Path | None,
    directories: tuple[str, ...],
    out: Path | None,
    rig: Path | None,
    as_json: bool,
) -> None:
    """Propose the trial that would best separate two effects, as a protocol that the rig can run.

    \b
    needle-rig experiment data/mine --between tissue_elasticity chuck_compliance
    needle-rig compensate --protocol tissue_elasticity-or-chuck_compliance.yaml
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.workbench.learning.experiment import propose_experiment

    known = library(directories)
    found = propose_experiment(
        read_data(data), between, known, read_model(model_path, directories), rig=rig, say=say
    )
    path = out or Path(f"{between[0]}-or-{between[1]}.yaml")
    found.save(path)
    if as_json:
        click.echo(json.dumps(found.as_json(path), ensure_ascii=False))
        return
    for sentence in found.sentences():
        click.echo(sentence)
    click.echo(f"wrote {path}")
