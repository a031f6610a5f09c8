"""needle-rig adopt: add what a diagnosis names, or one effect, to a model, or take the last step back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import effects_option, json_option, measured, model_option, of_field, terminal
from needle_rig.questions.adopt import AddEffect, Adopt, Undo
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.model import SavedModel

DATA_FILES = ("dataset.yaml", "settled.yaml")


@click.command("adopt")
@click.argument("what", nargs=-1, callback=measured, metavar="DIAGNOSIS [DATA...] | DATA... EFFECT")
@model_option
@effects_option
@of_field(
    Adopt,
    "chosen",
    "--effect",
    shell_complete=completing("effects"),
    metavar="EFFECT",
    help="Which of a diagnosis's ties.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Model file to write.")
@of_field(Adopt, "force", help="Add the effect even if it predicts nothing better.")
@click.option(
    "--undo", "take_back", is_flag=True, help="Take the last step of --model back; no DATA, no EFFECT."
)
@json_option
def command(
    what: tuple[str, ...],
    model: Path | None,
    effects: tuple[str, ...],
    chosen: tuple[str, ...],
    out: Path,
    force: bool,
    take_back: bool,
    as_json: bool,
) -> None:
    """Write the model with what a diagnosis names, as it was fitted; or add EFFECT and refit all to DATA.

    \b
    needle-rig diagnose data/mine --out diagnosis.yaml
    needle-rig adopt diagnosis.yaml data/mine --out fitted.yaml
    needle-rig adopt data/mine tip_friction --model fitted.yaml --out fitted.yaml
    needle-rig adopt --undo --model fitted.yaml --out fitted.yaml

    DIAGNOSIS is a file of diagnose --out (.yaml); all effects that it names are added in one step. With DATA,
    these must be the data of the diagnosis, and the model must still meet them. An effect that does not lower
    the error on commands left out is refused (exit code 1).
    """
    doing = terminal()
    from needle_rig.model import load_saved, save_model

    if chosen and not (what and _is_diagnosis(what[0])):
        raise click.UsageError("--effect chooses among the ties of a diagnosis file; name that file first.")
    if take_back:
        if model is None or what:
            raise click.UsageError("--undo takes --model FILE and --out FILE, and neither DATA nor EFFECT.")
        saved = load_saved(model, effects=effects)
        save_model(out, Undo(model=saved, effects=effects).answer(doing))
        undone = saved.history[-1].added
        told = {"model": str(out), "undone": undone}
        click.echo(json.dumps(told) if as_json else f"{out}: took back {', '.join(undone)}")
        return
    result = _question(what, model, effects, chosen, force, out.stem).answer(doing)
    save_model(out, result)
    if as_json:
        click.echo(json.dumps(_document(result, out), default=str))
    else:
        _show(result, out)


def _question(
    what: tuple[str, ...],
    model: Path | None,
    effects: tuple[str, ...],
    chosen: tuple[str, ...],
    force: bool,
    name: str,
) -> Adopt | AddEffect:
    """What the words ask for. Raises UsageError."""
    if what and _is_diagnosis(what[0]):
        if model is not None:
            raise click.UsageError("a diagnosis file holds the model that it began at; leave --model out.")
        file, *paths = what
        return Adopt(
            diagnosis=file, data=paths or None, chosen=chosen, force=force, name=name, effects=effects
        )
    if len(what) < 2:
        raise click.UsageError(
            "Name a diagnosis file, or the data and the effect: needle-rig adopt DIAGNOSIS.yaml --out FILE."
        )
    *paths, effect = what
    return AddEffect(data=paths, effect=effect, model=model, effects=effects, force=force, name=name)


def _is_diagnosis(word: str) -> bool:
    """Whether a word names a diagnosis file: by its name, so that what is wrong with the file is said."""
    path = Path(word)
    return path.suffix.lower() in (".yaml", ".yml") and path.name not in DATA_FILES


def _document(result: SavedModel, out: Path) -> JsonObject:
    """The step in numbers."""
    from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS

    last = result.history[-1]
    errors = last.errors[IN_NOISE_UNITS]
    return {
        "model": str(out),
        "added": list(last.added),
        "parameters": {
            n: {"value": v, "uncertainty": result.uncertainties.get(n)}
            for n, v in result.model.values().items()
        },
        "training_error": errors.training_after,
        "held_out_error": errors.held_out_after,
        "noise_floor": errors.floor,
        "held_out_error_before": errors.held_out_before,
    }


def _show(result: SavedModel, out: Path) -> None:
    from needle_rig.workbench.selection.answer import left_out_error
    from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS

    last = result.history[-1]
    errors = last.errors[IN_NOISE_UNITS]
    before, after = left_out_error(errors.held_out_before), left_out_error(errors.held_out_after)
    added = " and ".join(last.added)
    click.echo(f"{out}: added {added}; error on commands left out {before} → {after} × the noise")
    if errors.held_out_after is None:
        click.echo(
            "note: all trials are of one command, so that none could be left out to check what the effect"
            " predicts; add trials with another target, speed or dwell"
        )
    for name, value in result.model.values().items():
        error = result.uncertainties.get(name)
        click.echo(
            f"  {name} = {value:.5g}"
            + (f" ± {error:.2g}" if error is not None else "")
            + f" {result.model.info(name).unit}"
        )
