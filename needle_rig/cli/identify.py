"""needle-rig identify: the paper's identification experiments on the simulated rig."""

from __future__ import annotations

import json

import click

from needle_rig.cli._workbench import effects_option


@click.command("identify")
@click.argument("what", type=click.Choice(["jg", "damping", "friction"]))
@click.option(
    "--parameters", default="rig_elastic", show_default=True, help="Parameter set, or a model file."
)
@click.option(
    "--effect", "effects", multiple=True, metavar="NAME[=VALUE]", help="Effect of the simulated rig."
)
@effects_option
@click.option(
    "--seed", type=click.IntRange(min=0), default=1, show_default=True, help="Of the sensors' noise."
)
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
def command(
    what: str,
    parameters: str,
    effects: tuple[str, ...],
    directories: tuple[str, ...],
    seed: int,
    as_json: bool,
) -> int:
    """Find a constant of the simulated rig by experiment, with its sensors' noise.

    \b
    jg        tip held, base turned by 90°: torsional rigidity
    damping   steady turns at three rates; a set without damping gets the paper's 2.8 N·mm·s per 100 mm
    friction  the torque that stays after a turn

    Exit code 1 when the result is off by more than 2 %.
    """
    from needle_rig.config.schema import SimulationSection
    from needle_rig.model import effect_directories, load_parameters
    from needle_rig.physics.effect_text import parse_effects
    from needle_rig.physics.library import find_effects
    from needle_rig.workbench.paper.identify import DAMPING, EXPERIMENTS

    model = load_parameters(parameters, effects=directories)
    library = find_effects(effect_directories(directories))
    if effects:
        model = model.with_effects(*parse_effects(effects, library))
    added = what == "damping" and not any(e.name() == DAMPING and not e.is_off() for e in model.effects)
    if added:
        model = model.with_effects(*parse_effects((f"{DAMPING}=2.8",), library))
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
