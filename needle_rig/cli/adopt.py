"""needle-rig adopt: add what a diagnosis names, or one effect, to a model, or take the last step back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._workbench import (
    effects_option,
    json_option,
    library,
    model_option,
    read_observations,
    read_saved,
    say,
)
from needle_rig.records import JsonObject

if TYPE_CHECKING:
    from needle_rig.model import SavedModel

DATA_FILES = ("dataset.yaml", "settled.yaml")


@click.command("adopt")
@click.argument("what", nargs=-1, metavar="DIAGNOSIS [DATA...] | DATA... EFFECT")
@model_option
@effects_option
@click.option(
    "--effect",
    "chosen",
    shell_complete=completing("effects"),
    multiple=True,
    metavar="EFFECT",
    help="Which of a diagnosis's ties.",
)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Model file to write.")
@click.option("--force", is_flag=True, help="Add the effect even if it foretells nothing better.")
@click.option(
    "--undo", "take_back", is_flag=True, help="Take the last step of --model back; no DATA, no EFFECT."
)
@json_option
def command(
    what: tuple[str, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
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
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.model import save_model
    from needle_rig.workbench.learning.adopt import undo

    of_diagnosis = bool(what) and _is_diagnosis(what[0])
    if chosen and not of_diagnosis:
        raise click.UsageError("--effect chooses among the ties of a diagnosis file; name that file first.")
    if of_diagnosis and model_path is not None:
        raise click.UsageError("a diagnosis file holds the model that it began at; leave --model out.")
    if take_back:
        saved = read_saved(model_path, directories)
        if saved is None or what:
            raise click.UsageError("--undo takes --model FILE and --out FILE, and neither DATA nor EFFECT.")
        save_model(out, undo(saved))
        undone = saved.history[-1].added
        told = {"model": str(out), "undone": undone}
        click.echo(json.dumps(told) if as_json else f"{out}: took back {', '.join(undone)}")
        return
    if of_diagnosis:
        result = _from_diagnosis(Path(what[0]), what[1:], directories, chosen, out.stem, force)
    else:
        result = _by_name(what, model_path, directories, out.stem, force)
    save_model(out, result)
    if as_json:
        click.echo(json.dumps(_document(result, out), default=str))
    else:
        _show(result, out)


def _is_diagnosis(word: str) -> bool:
    """Whether a word names a diagnosis file: by its name, so that what is wrong with the file is said."""
    path = Path(word)
    return path.suffix.lower() in (".yaml", ".yml") and path.name not in DATA_FILES


def _from_diagnosis(
    file: Path,
    data: tuple[str, ...],
    directories: tuple[str, ...],
    chosen: tuple[str, ...],
    name: str,
    force: bool,
) -> SavedModel:
    from needle_rig.workbench.learning.adopt import adopt_diagnosis
    from needle_rig.workbench.learning.diagnosis_file import load_diagnosis

    kept = load_diagnosis(file, effects=directories)
    observed = read_observations(tuple(Path(p) for p in data)) if data else None
    return adopt_diagnosis(kept, observed, effects=chosen, force=force, name=None if kept.learnt else name)


def _by_name(
    what: tuple[str, ...], model_path: Path | None, directories: tuple[str, ...], name: str, force: bool
) -> SavedModel:
    from needle_rig.workbench.learning.adopt import adopt

    if len(what) < 2:
        raise click.UsageError(
            "Name a diagnosis file, or the data and the effect: needle-rig adopt DIAGNOSIS.yaml --out FILE."
        )
    *paths, effect = what
    saved = read_saved(model_path, directories)
    observed = read_observations(tuple(Path(p) for p in paths))
    say(f"fitting {effect}")
    return adopt(observed, effect, library(directories), saved, force=force, name=None if saved else name)


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
            " foretells; add trials with another target, speed or dwell"
        )
    for name, value in result.model.values().items():
        error = result.uncertainties.get(name)
        click.echo(
            f"  {name} = {value:.5g}"
            + (f" ± {error:.2g}" if error is not None else "")
            + f" {result.model.info(name).unit}"
        )
