"""needle-rig adopt: add an effect to a model, or take the last step back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from needle_rig.cli._workbench import (
    effects_option,
    json_option,
    left_out_error,
    library,
    model_option,
    read_data,
    say,
)


@click.command("adopt")
@click.argument("data_and_effect", nargs=-1, metavar="DATA... EFFECT")
@model_option
@effects_option
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Model file to write.")
@click.option("--force", is_flag=True, help="Add the effect even if it foretells nothing better.")
@click.option(
    "--undo", "take_back", is_flag=True, help="Take the last step of --model back; no DATA, no EFFECT."
)
@json_option
def command(
    data_and_effect: tuple[str, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
    out: Path,
    force: bool,
    take_back: bool,
    as_json: bool,
) -> None:
    """Add EFFECT to the model, refit everything to DATA, and write the model file.

    \b
    needle-rig adopt data/mine tissue_elasticity --out fitted.yaml
    needle-rig adopt data/mine tip_friction --model fitted.yaml --out fitted.yaml
    needle-rig adopt --undo --model fitted.yaml --out fitted.yaml

    An effect that does not lower the error on commands left out is refused (exit code 1).
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.model import load_model, save_model
    from needle_rig.workbench.learning.adopt import adopt, undo
    from needle_rig.workbench.learning.history import ladder

    saved = None if model_path is None else load_model(model_path, effects=directories)
    if take_back:
        if saved is None or data_and_effect:
            raise click.UsageError("--undo takes --model FILE and --out FILE, and neither DATA nor EFFECT.")
        result = undo(saved)
        told: dict[str, Any] = {"model": str(out), "undone": saved.history[-1].added}
    else:
        if len(data_and_effect) < 2:
            raise click.UsageError("Name the data and the effect: needle-rig adopt DATA EFFECT --out FILE.")
        *paths, effect = data_and_effect
        say(f"fitting {effect}")
        data = read_data(tuple(Path(p) for p in paths))
        result = adopt(
            data, effect, library(directories), saved, force=force, name=None if saved else out.stem
        )
        told = {
            "model": str(out),
            "added": effect,
            "parameters": {
                n: {"value": v, "uncertainty": result.uncertainties.get(n)}
                for n, v in result.model.values().items()
            },
            **{
                k: v
                for k, v in ladder(result)[-1].as_json().items()
                if k.endswith("_error") or k == "noise_floor"
            },
            "held_out_error_before": result.history[-1].errors["noise_units"].held_out_before,
        }
    save_model(out, result)
    if as_json:
        click.echo(json.dumps(told, default=str))
        return
    if take_back:
        click.echo(f"{out}: took back {', '.join(told['undone'])}")
        return
    before, after = (left_out_error(told[f"held_out_error{when}"]) for when in ("_before", ""))
    click.echo(f"{out}: added {told['added']}; error on commands left out {before} → {after} × the noise")
    if told["held_out_error"] is None:
        click.echo(
            "note: all trials are of one command, so that none could be left out to check what the effect"
            " foretells; add trials with another target, speed or dwell"
        )
    for name, value in result.model.values().items():
        error = result.uncertainties.get(name)
        click.echo(
            f"  {name} = {value:.5g}"
            + (f" ± {error:.2g}" if error is not None else "")
            + f" {result.model.info(name).unit}"
        )
