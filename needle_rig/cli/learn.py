"""needle-rig learn: a law that no library holds, with its curve, its formula and its effect file."""

from __future__ import annotations

import json
import shlex
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    library,
    model_option,
    read_model,
    read_observations,
    say,
    seed_option,
    worker,
)
from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.workbench.laws.learnt import Learnt


@click.command("learn")
@data_argument
@click.option("--out", type=click.Path(path_type=Path), help="Effect file to draft (.py).")
@picture_option("--png", "png_path", type=click.Path(path_type=Path), help="Write the curves as a picture.")
@click.option("--pysr", is_flag=True, help="Ask PySR for a formula of each curve as well.")
@model_option
@effects_option
@seed_option
@jobs_option
@json_option
def command(
    data: tuple[Path, ...],
    out: Path | None,
    png_path: Path | None,
    pysr: bool,
    model_path: Path | None,
    directories: tuple[str, ...],
    seed: int,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Find a law that no effect holds: where it acts, what it depends on, its curve and a short formula.

    \b
    needle-rig learn data/mine --out my_effects/found.py --png found.png
    needle-rig adopt data/mine found --effects my_effects --out fitted.yaml

    DATA is a dataset folder or a run file, or several; settled values are too few. The library is asked
    first: a law is said only where it does better than every effect. Every verdict (law, none, library,
    cannot_tell) exits with 0. A second law is drafted beside the first, its file's name ending in _2.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.workbench.laws.symbolic import formula_of, regressor
    from needle_rig.workbench.learning.learn_law import laws_of
    from needle_rig.workbench.learning.observations import Traces

    started = time.monotonic()
    effects = library(directories)
    _check_places(out, png_path, effects)
    make = regressor() if pysr else None
    present = read_model(model_path, directories)
    observed = read_observations(data)
    if not isinstance(observed, Traces):
        raise BadInput(
            f"{observed.name}: holds settled values only, from which no curve can be learnt;"
            " name a dataset of traces or a run file"
        )
    found = laws_of(observed, effects, present, seed=seed, workers=lambda: worker(jobs, None), say=say)
    drafts = found.write_drafts(out) if out is not None else ()
    for draft in drafts:
        click.echo(f"wrote {draft}", err=True)
    if png_path is not None and found.laws:
        from needle_rig.figures.laws import laws_figure

        laws_figure(found).savefig(png_path, dpi=110)
        click.echo(f"wrote {png_path}", err=True)
    if make is not None and found.laws:
        say("asking PySR")
    others = [] if make is None else [formula_of(make, law) for law in found.laws]
    if as_json:
        told = found.as_json(time.monotonic() - started)
        for law, other in zip(told["laws"], others, strict=False):
            law["pysr"] = other.text
        click.echo(json.dumps(told, ensure_ascii=False))
        return
    _show(found, [other.sentence() for other in others])
    if found.verdict == "law" and drafts:
        click.echo(f"adopt it: {_adoption(data, drafts[0], model_path)}")


def _check_places(out: Path | None, png_path: Path | None, effects: object) -> None:
    """Raises BadInput for places that cannot be written to, or an effect's name that is taken."""
    for option, path in (("--out", out), ("--png", png_path)):
        if path is not None and not path.absolute().parent.is_dir():
            raise BadInput(
                f"{option} {path}: there is no folder {path.parent}; make it, or name another place"
            )
    if out is None:
        return
    if out.suffix != ".py" or not out.stem.isidentifier() or out.stem.startswith("_"):
        raise BadInput(f"--out {out}: an effect's file is a Python file; name it as found.py")
    assert isinstance(effects, dict)
    if out.stem in effects:
        raise BadInput(f"--out {out}: there is an effect {out.stem} already; name the file otherwise")


def _adoption(data: tuple[Path, ...], draft: Path, model_path: Path | None) -> str:
    model = () if model_path is None else ("--model", str(model_path))
    words = ["needle-rig", "adopt", *(str(path) for path in data), draft.stem]
    return shlex.join([*words, *model, "--effects", str(draft.parent), "--out", "MODEL.yaml"])


def _show(found: Learnt, others: Sequence[str]) -> None:
    from needle_rig.workbench.selection.answer import left_out_error

    click.echo(f"{found.origin.dataset}: {found.verdict.replace('_', ' ')}. {found.sentence}")
    before, after = left_out_error(found.held_out_before), left_out_error(found.held_out_after)
    click.echo(f"error on commands left out: {before} → {after} × the noise")
    if found.library:
        click.echo(f"of the library: {', '.join(found.library)}")
    for place, law in enumerate(found.laws):
        step = f"{left_out_error(law.held_out_before)} → {left_out_error(law.held_out_after)}"
        click.echo(f"{law.law.name}: {law.law.words()}; {step}")
        if law.formula is not None:
            click.echo(f"  formula {law.formula}")
        for name, value, spread, unit in law.parameters:
            click.echo(f"  {name} = {value:.4g} ± {spread:.2g}" + ("" if unit == "1" else f" {unit}"))
        for said in others[place : place + 1]:
            click.echo(f"  {said}")
        for other in law.tied_with:
            click.echo(f"  cannot be told from: {other.words()}")
        if law.experiment is not None:
            click.echo(f"  next: {law.experiment['sentence']}")
