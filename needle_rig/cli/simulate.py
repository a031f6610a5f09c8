"""needle-rig simulate: measurements with a known effect, as a dataset."""

from __future__ import annotations

import json
import os
from pathlib import Path

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import effects_option, library


@click.command("simulate")
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    default="rig_rigid",
    show_default=True,
    help="Parameter set, or a model file.",
)
@click.option(
    "--effect",
    "hidden",
    shell_complete=completing("effects"),
    multiple=True,
    metavar="NAME[=VALUE]",
    help="Effect to hide, e.g. tissue_elasticity=0.35; may be repeated. Without a value: its typical size.",
)
@effects_option
@click.option(
    "--protocol",
    shell_complete=completing("protocols"),
    default="standard",
    show_default=True,
    help="Name, or a YAML file.",
)
@click.option("--replicates", type=click.IntRange(1, 100), default=1, help="Run the protocol so many times.")
@click.option(
    "--layout",
    "layout_from",
    metavar="NAME|FILE|DATASET",
    help="experiment, model, a rig file, or a dataset folder; default: that of the parameters.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of noise and scatter."
)
@click.option("--hall-noise-deg", type=float, default=0.25, show_default=True)
@click.option("--torque-noise-nmm", type=float, default=0.0008, show_default=True)
@click.option("--encoder-noise-deg", type=float, default=0.02, show_default=True)
@click.option(
    "--scatter-percent", type=float, default=2.0, show_default=True, help="Of friction from trial to trial."
)
@click.option(
    "--rigidity-error-percent",
    type=float,
    default=0.0,
    show_default=True,
    help="Of the needle's true rigidity about the stated one.",
)
@click.option("--rate-hz", type=float, default=50.0, show_default=True, help="Samples a second.")
@click.option("--name", help="Name of the dataset; default: the name of the folder.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder to write; must be new.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def command(
    parameters: str,
    hidden: tuple[str, ...],
    effects: tuple[str, ...],
    protocol: str,
    replicates: int,
    layout_from: str | None,
    seed: int,
    hall_noise_deg: float,
    torque_noise_nmm: float,
    encoder_noise_deg: float,
    scatter_percent: float,
    rigidity_error_percent: float,
    rate_hz: float,
    name: str | None,
    out: Path,
    as_json: bool,
) -> None:
    """Write a dataset of simulated trials, noise and scatter included, with effects that you choose.

    \b
    needle-rig simulate --effect tissue_elasticity=0.35 --seed 1 --out data/mine
    needle-rig diagnose data/mine
    """
    from needle_rig.cli._layouts import layout_named
    from needle_rig.dataset import write_dataset
    from needle_rig.dataset.protocol import load_protocol
    from needle_rig.errors import BadInput
    from needle_rig.model import load_parameters
    from needle_rig.physics.effect_text import parse_effects
    from needle_rig.workbench.virtual.dataset import simulate_dataset
    from needle_rig.workbench.virtual.noise import Noise

    if os.path.lexists(out / "dataset.yaml"):
        raise BadInput(f"{out}: holds a dataset already; name another folder with --out or remove it first")
    model = load_parameters(
        parameters, layout=None if layout_from is None else layout_named(layout_from), effects=effects
    )
    if hidden:
        model = model.with_effects(*parse_effects(hidden, library(effects)))
    noise = Noise(
        hall_noise_deg,
        torque_noise_nmm,
        encoder_noise_deg,
        scatter_percent / 100,
        rigidity_error_percent / 100,
    )
    plan = load_protocol(protocol).repeated(replicates)
    dataset = simulate_dataset(model, plan, seed, noise, name=name or out.resolve().name, rate_hz=rate_hz)
    write_dataset(dataset, out)
    samples = sum(len(t.trial.time_s) for t in dataset.trials)
    if as_json:
        result = {
            "dataset": str(out),
            "name": dataset.name,
            "trials": len(dataset.trials),
            "samples": samples,
            "seed": seed,
            "parameters": model.values(),
        }
        click.echo(json.dumps(result))
        return
    told = ", ".join(hidden) or "nothing"
    click.echo(
        f"{out}: {len(dataset.trials)} trials, {samples} samples; {parameters} with {told}, seed {seed}"
    )
