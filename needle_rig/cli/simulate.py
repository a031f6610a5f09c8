"""needle-rig simulate: measurements with a known effect, as a dataset."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import effects_option, json_option, of_field, terminal
from needle_rig.questions.simulate import Simulate
from needle_rig.workbench.virtual.noise import Noise

USUAL = Noise()


@click.command("simulate")
@of_field(
    Simulate, "parameters", shell_complete=completing("parameters"), help="Parameter set, or a model file."
)
@of_field(
    Simulate,
    "hidden",
    "--effect",
    shell_complete=completing("effects"),
    metavar="NAME[=VALUE]",
    help="Effect to hide, e.g. tissue_elasticity=0.35; may be repeated. Without a value: its typical size.",
)
@effects_option
@of_field(Simulate, "protocol", shell_complete=completing("protocols"), help="Name, or a YAML file.")
@of_field(Simulate, "replicates", help="Run the protocol so many times.")
@of_field(
    Simulate,
    "layout",
    metavar="NAME|FILE|DATASET",
    help="experiment, model, a rig file, or a dataset folder; default: that of the parameters.",
)
@of_field(Simulate, "seed", help="Of noise and scatter.")
@click.option("--hall-noise-deg", default=USUAL.hall_deg, show_default=True)
@click.option("--torque-noise-nmm", default=USUAL.torque_nmm, show_default=True)
@click.option("--encoder-noise-deg", default=USUAL.encoder_deg, show_default=True)
@click.option(
    "--scatter-percent",
    default=100.0 * USUAL.friction_scatter,
    show_default=True,
    help="Of friction from trial to trial.",
)
@click.option(
    "--rigidity-error-percent",
    default=100.0 * USUAL.rigidity_error,
    show_default=True,
    help="Of the needle's true rigidity about the stated one.",
)
@of_field(Simulate, "rate_hz", help="Samples a second.")
@click.option("--name", "called", help="Name of the dataset; default: the name of the folder.")
@of_field(
    Simulate, "out", type=click.Path(path_type=Path), required=True, help="Folder to write; must be new."
)
@json_option
def command(
    hall_noise_deg: float,
    torque_noise_nmm: float,
    encoder_noise_deg: float,
    scatter_percent: float,
    rigidity_error_percent: float,
    called: str | None,
    as_json: bool,
    **asked: Any,
) -> None:
    """Write a dataset of simulated trials, noise and scatter included, with effects that you choose.

    \b
    needle-rig simulate --effect tissue_elasticity=0.35 --seed 1 --out data/mine
    needle-rig diagnose data/mine
    """
    scatter, rigidity_error = scatter_percent / 100, rigidity_error_percent / 100
    noise = Noise(hall_noise_deg, torque_noise_nmm, encoder_noise_deg, scatter, rigidity_error)
    question = Simulate(noise=noise, name=called or asked["out"].resolve().name, **asked)
    dataset = question.answer(terminal())
    trials, samples = len(dataset.trials), sum(len(t.trial.time_s) for t in dataset.trials)
    if as_json:
        result = {
            "dataset": str(question.out),
            "name": dataset.name,
            "trials": trials,
            "samples": samples,
            "seed": question.seed,
            "parameters": question.plant().values(),
        }
        click.echo(json.dumps(result))
        return
    told = ", ".join(asked["hidden"]) or "nothing"
    click.echo(
        f"{question.out}: {trials} trials, {samples} samples;"
        f" {question.parameters} with {told}, seed {question.seed}"
    )
