"""needle-rig identify: constants of a rig from its own recordings, or by experiment on the simulated rig."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import effects_option, json_option, measured, terminal
from needle_rig.questions.identify import Identify
from needle_rig.questions.question import OnSimulatedRig

SIMULATED = ("jg", "damping", "friction")


@click.command("identify")
@click.argument(
    "data", nargs=-1, required=True, callback=measured, metavar="DATA... | jg | damping | friction"
)
@click.option("--model", type=click.Path(path_type=Path), help="Model file whose parameters are found.")
@click.option("--out", type=click.Path(path_type=Path), help="Model file to write.")
@click.option(
    "--update",
    "updated",
    type=click.Path(path_type=Path),
    help="Model file to put the recording to: what it knows counts, too.",
)
@effects_option
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    help="Of a simulated experiment: parameter set, or a model file.",
)
@click.option(
    "--effect",
    "hidden",
    shell_complete=completing("effects"),
    multiple=True,
    metavar="NAME[=VALUE]",
    help="The same: an effect.",
)
@click.option("--seed", type=click.IntRange(min=0), help="The same: of the sensors' noise.")
@json_option
def command(
    data: tuple[str, ...],
    model: Path | None,
    out: Path | None,
    updated: Path | None,
    effects: tuple[str, ...],
    parameters: str | None,
    hidden: tuple[str, ...],
    seed: int | None,
    as_json: bool,
) -> int:
    """Find torsional rigidity, damping, friction and its scatter, each with its uncertainty.

    \b
    needle-rig identify data/mine --out rig.yaml
    needle-rig identify runs/latest.h5 --update rig.yaml
    needle-rig identify jg

    DATA is a dataset folder or a run file, or several; whether the tip is clamped stands in its layout
    (rig: tip: clamped). What a recording does not give is named with the experiment that would. With --update
    a recording that contradicts the model file is refused (exit code 1).

    One of the words makes the paper's experiment on the simulated rig (exit code 1: off by more than 2 %):

    \b
    jg        tip held, base turned by 90°: torsional rigidity
    damping   steady turns at three rates; a set without damping gets the paper's 2.8 N·mm·s per 100 mm
    friction  the torque that stays after a turn
    """
    if data[0] in SIMULATED:
        if len(data) > 1 or model or out or updated:
            raise click.UsageError(
                f"{data[0]} is an experiment on the simulated rig: give it alone, or ./{data[0]}, a folder."
            )
        return _simulated(
            data[0], parameters or "rig_elastic", hidden, effects, 1 if seed is None else seed, as_json
        )
    if parameters or hidden or seed is not None:
        raise click.UsageError("--parameters, --effect and --seed are of the simulated rig; leave them out.")
    if updated is not None and (model or out):
        raise click.UsageError("--update reads and writes one model file; leave --model and --out out.")
    question = Identify(data=data, model=updated or model, effects=effects, update=updated is not None)
    _recorded(question, updated or out, as_json)
    return 0


def _recorded(question: Identify, path: Path | None, as_json: bool) -> None:
    doing = terminal()
    from needle_rig.model import save_model

    answer = question.answer(doing)
    if path is not None:
        save_model(path, answer.saved(answer.before.model.name if answer.before else path.stem))
    if as_json:
        told = answer.found.as_json() | {"model": None if path is None else str(path)}
        click.echo(json.dumps(told, ensure_ascii=False))
        return
    for sentence in answer.found.sentences():
        click.echo(sentence)
    if path is not None:
        click.echo(f"wrote {path}")


def _simulated(
    what: str,
    parameters: str,
    hidden: tuple[str, ...],
    effects: tuple[str, ...],
    seed: int,
    as_json: bool,
) -> int:
    from needle_rig.config.schema import SimulationSection
    from needle_rig.workbench.paper.experiments import DAMPING, EXPERIMENTS

    rig = OnSimulatedRig(parameters=parameters, hidden=hidden, effects=effects)
    model = rig.plant(terminal())
    added = what == "damping" and not any(e.name() == DAMPING and not e.is_off() for e in model.effects)
    if added:
        model = replace(rig, hidden=(*hidden, f"{DAMPING}=2.8")).plant()
    found = EXPERIMENTS[what](model, SimulationSection(parameters=parameters, seed=seed))
    document = found.as_document()
    if as_json:
        click.echo(json.dumps(document, ensure_ascii=False))
    else:
        if added:
            click.echo(f"{parameters} has no damping; the paper's 2.8 N·mm·s per 100 mm was added")
        click.echo(f"experiment: {found.experiment}")
        for reading in found.readings:
            click.echo("  " + ", ".join(f"{key} {value:.4g}" for key, value in reading.items()))
        click.echo(f"{found.quantity}: {found.value:.4g} ± {found.uncertainty:.2g} {found.unit}")
        click.echo(f"the simulated rig has {found.plant_value:.4g}: off by {found.error_percent:+.2f} %")
    return 0 if document["within"] else 1
