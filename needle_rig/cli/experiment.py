"""needle-rig experiment: the trial that would best tell two effects apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    model_option,
    terminal,
)
from needle_rig.questions.experiment import Experiment


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
@jobs_option
@json_option
def command(out: Path | None, jobs: int | None, as_json: bool, **asked: Any) -> None:
    """Propose the trial that would best separate two effects, as a protocol that the rig can run.

    \b
    needle-rig experiment data/mine --between tissue_elasticity chuck_compliance
    needle-rig compensate --protocol tissue_elasticity-or-chuck_compliance.yaml
    """
    found = Experiment(**asked).answer(terminal(jobs))
    path = out or Path(f"{'-or-'.join(found.between)}.yaml")
    found.save(path)
    if as_json:
        click.echo(json.dumps(found.as_json(path), ensure_ascii=False))
        return
    for sentence in found.sentences():
        click.echo(sentence)
    click.echo(f"wrote {path}")
