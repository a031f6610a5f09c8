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

TOLD_APART_SIGMA = 2.0


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
    from needle_rig.config.loader import load_rig_config
    from needle_rig.errors import BadInput
    from needle_rig.simulation.protocol import save_protocol
    from needle_rig.workbench.estimation.baseline import fit_baseline
    from needle_rig.workbench.selection.candidates import try_effect
    from needle_rig.workbench.selection.design import (
        REPLICATES,
        commands,
        expected_power,
        proposals,
        protocol_of,
    )

    known = library(directories)
    for name in between:
        if name not in known:
            raise BadInput(f"{name}: no such effect; there are {', '.join(sorted(known))}")
    if between[0] == between[1]:
        raise BadInput(f"--between {between[0]} {between[1]}: name two different effects")
    dataset = read_data(data)
    say("fitting both effects")
    baseline = fit_baseline(dataset, read_model(model_path, directories), known)
    fits = []
    for name in between:
        found = try_effect(baseline.problem, baseline.current, name).fit
        if found is None:
            raise BadInput(f"{name} cannot be fitted to {dataset.name}; name another effect")
        fits.append(found)
    first, second = sorted(zip(fits, between, strict=True), key=lambda f: f[0].objective)
    drive = load_rig_config(rig, {}).drive
    among = commands(drive.velocity_limit_deg_s, drive.angle_limit_deg)
    say("simulating the candidates")
    ranked = proposals(baseline.problem, first[0], second[0], dataset.sensor_names, among)
    if not ranked:
        raise BadInput("no candidate trial could be simulated with both effects")
    best = ranked[0]
    power = expected_power(baseline.problem, first[0], second[0], best.command, REPLICATES)
    path = out or Path(f"{between[0]}-or-{between[1]}.yaml")
    sentence = best.sentence(first[1], second[1])
    save_protocol(path, protocol_of(best.command, *between), note=sentence)
    if as_json:
        answer = {
            "protocol": str(path),
            "between": list(between),
            "expected_separation_sigma": round(power, 2),
            "trials": REPLICATES,
            "duration_s": round(best.duration_s * REPLICATES, 1),
            "watch": best.watch,
            "sentence": sentence,
            "candidates": [
                {
                    "kind": p.command.kind,
                    "target_deg": p.command.target_deg,
                    "steps_deg": list(p.command.steps_deg),
                    "speed_deg_s": p.command.speed_deg_s,
                    "settle_s": p.command.settle_s,
                    "separation_sigma": round(p.separation_sigma, 2),
                    "duration_s": round(p.duration_s, 1),
                }
                for p in ranked
            ],
        }
        click.echo(json.dumps(answer, ensure_ascii=False))
        return
    click.echo(sentence)
    click.echo(f"{REPLICATES} such trials on top of these data: {power:.1f}σ between the two. Wrote {path}.")
    if power < TOLD_APART_SIGMA:
        click.echo(
            f"At the values fitted here {first[1]} and {second[1]} foretell the same needle; what one trial"
            " separates, fitting both again takes back."
        )
