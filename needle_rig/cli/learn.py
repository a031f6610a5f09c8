"""needle-rig learn: a law that no library holds, with its curve, its formula and its effect file."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import (
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    model_option,
    say,
    terminal,
    typed,
)
from needle_rig.errors import BadInput
from needle_rig.questions.learn import Learn

if TYPE_CHECKING:
    from needle_rig.workbench.laws.learnt import Learnt


@click.command("learn")
@data_argument
@click.option("--out", "draft", type=click.Path(path_type=Path), help="Effect file to draft (.py).")
@picture_option("--png", "png_path", type=click.Path(path_type=Path), help="Write the curves as a picture.")
@click.option("--pysr", is_flag=True, help="Ask PySR for a formula of each curve as well.")
@model_option
@effects_option
@jobs_option
@json_option
def command(png_path: Path | None, pysr: bool, jobs: int | None, as_json: bool, **asked: Any) -> None:
    """Find a law that no effect holds: where it acts, what it depends on, its curve and a short formula.

    \b
    needle-rig learn data/mine --out my_effects/found.py --png found.png
    needle-rig adopt data/mine found --effects my_effects --out fitted.yaml

    DATA is a dataset folder or a run file, or several; settled values are too few. The library is asked
    first: a law is said only where it does better than every effect. Every verdict (law, none, library,
    cannot_tell) exits with 0. A second law is drafted beside the first, its file's name ending in _2.
    """
    doing, question = terminal(jobs), Learn(**asked)
    from needle_rig.workbench.laws.symbolic import formula_of, regressor

    started = time.monotonic()
    if png_path is not None and not png_path.absolute().parent.is_dir():
        raise BadInput(
            f"--png {png_path}: there is no folder {png_path.parent}; make it, or name another place"
        )
    make = regressor() if pysr else None
    answer = question.answer(doing)
    found, drafts = answer.found, answer.drafts
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
        known = dataclasses.replace(question, effects=(*question.effects, drafts[0].parent))
        click.echo(f"adopt it: {typed('adopt', known, '--out', 'MODEL.yaml', last=(drafts[0].stem,))}")


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
            click.echo(f"  cannot be told apart from: {other.words()}")
        if law.experiment is not None:
            click.echo(f"  next: {law.experiment['sentence']}")
