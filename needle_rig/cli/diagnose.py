"""needle-rig diagnose: which physical effect is missing."""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._workbench import (
    cluster_option,
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    library,
    model_option,
    read_observations,
    read_saved,
    say,
    seed_option,
    worker,
)
from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.workbench.selection.answer import Answer


@click.command("diagnose")
@data_argument
@model_option
@effects_option
@click.option("--max-effects", type=click.IntRange(1, 6), default=3, show_default=True)
@click.option(
    "--quick",
    is_flag=True,
    help="One effect alone, each by itself: half the time or less, and no second one.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Diagnosis file to write, for adopt.")
@seed_option
@jobs_option
@cluster_option
@json_option
def command(
    data: tuple[Path, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
    max_effects: int,
    quick: bool,
    out: Path | None,
    seed: int,
    jobs: int | None,
    cluster: str | None,
    as_json: bool,
) -> None:
    """Say which effect is missing from the model: its size, its rivals, and what the data cannot tell.

    Of a --model it says first whether its values hold as they stand, then whether its structure does.

    \b
    needle-rig diagnose data/mine --out diagnosis.yaml
    needle-rig diagnose data/mine --model fitted.yaml --effects my_effects --json

    DATA is a dataset folder or a run file, or several; or a folder of settled values as published
    (settled.yaml; reed2008 is shipped), where one effect at a time is tried. Every verdict (effect, none,
    unknown) exits with 0.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.workbench.learning.observations import Traces

    if out is not None and not out.absolute().parent.is_dir():
        raise BadInput(f"--out {out}: there is no folder {out.parent}; make it, or name another place")
    saved = read_saved(model_path, directories)
    observed = read_observations(data)
    found = observed.diagnose(
        library(directories),
        saved.model if saved else None,
        max_effects=max_effects,
        quick=quick,
        seed=seed,
        work=worker(jobs, cluster),
        say=say,
    )
    if out is not None:
        from needle_rig.workbench.learning.diagnosis_file import keep, save_diagnosis

        say("keeping the fits")
        save_diagnosis(out, keep(found, observed, saved))
        click.echo(f"wrote {out}", err=True)
    from needle_rig.workbench.learning.compare import compared, values_document
    from needle_rig.workbench.selection.diagnose import Diagnosis

    document = found.as_json()
    if saved is not None and isinstance(found, Diagnosis):
        held = compared(found.baseline, saved)
        document["model_values"] = values_document(held, structure_holds=found.verdict == "none")
    if as_json:
        click.echo(json.dumps(document, ensure_ascii=False))
        return
    values = document.get("model_values")
    _show(found, [] if values is None else values["sentences"])
    started = () if model_path is None else ("--model", str(model_path))
    folders = [word for folder in directories for word in ("--effects", folder)]
    if found.verdict == "none" and values is not None and values["contradict"]:
        words = ["needle-rig", "identify", *(str(path) for path in data), *started, *folders]
        click.echo(f"take the values of these data over: {shlex.join([*words, '--out', 'MODEL.yaml'])}")
    if found.verdict == "effect":
        click.echo(_next_step(found, data, started, folders, out))
    elif found.verdict == "unknown" and isinstance(observed, Traces):
        words = ["needle-rig", "learn", *(str(path) for path in data), *started, *folders]
        told = shlex.join([*words, "--out", "found.py"])
        click.echo(f"look for a law that the library does not hold: {told}")


def _next_step(
    found: Answer, data: tuple[Path, ...], started: Sequence[str], folders: Sequence[str], out: Path | None
) -> str:
    """The commands that take the answer over."""
    choice = [word for effect in found.effects for word in ("--effect", effect)] if found.ties else []
    paths = [str(path) for path in data]
    file = str(out or "DIAGNOSIS.yaml")
    adopt = ["needle-rig", "adopt", file, *paths, *choice, *folders, "--out", "MODEL.yaml"]
    if out is not None:
        return f"adopt it: {shlex.join(adopt)}"
    again = ["needle-rig", "diagnose", *paths, *started, *folders, "--out", file]
    return f"adopt it: {shlex.join(again)}, then {shlex.join(adopt)}"


def _show(found: Answer, values: Sequence[str]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from needle_rig.workbench.selection.answer import left_out_error

    # names and notes come from files: brackets in them are no markup
    console = Console(highlight=False, soft_wrap=False, markup=False)
    against = f" against the model {found.model}: "
    if values:
        first, *others = values
        console.print(Text.assemble((found.dataset, "bold"), against + first))
        for sentence in others:
            console.print(f"  {sentence}")
        console.print(Text.assemble(("structure", "bold"), f": {found.sentence()}"))
    else:
        console.print(Text.assemble((found.dataset, "bold"), against + found.sentence()))
    console.print(found.errors_sentence())
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("effect", "held out", "removed"):
        table.add_column(heading, no_wrap=True)
    table.add_column("for and against")
    for row in found.ranking[: max(6, len(found.effects))]:
        words = row.in_favour + (f"; against: {row.against}" if row.against else "")
        table.add_row(
            row.effect, left_out_error(row.held_out_error), f"{100 * row.error_removed:.0f} %", words
        )
    console.print(table)
    for row in found.ranking[: len(found.effects)]:
        for v in row.values:
            unit = "" if v.unit == "1" else f" {v.unit}"
            console.print(f"{row.effect}.{v.name} = {v.value:.4g} (95 %: {v.low:.4g} … {v.high:.4g}){unit}")
    for kind in ("present", "negligible", "cannot_tell", "absent"):
        names = [d for d in found.decisions.values() if d.decision == kind]
        if names:
            said = ", ".join(d.effect if kind == "present" else d.sentence() for d in names)
            console.print(Text.assemble((kind.replace("_", " "), "bold"), f": {said}"))
    for sentence in found.left_in_words():
        console.print(f"left over: {sentence}")
    if found.next_experiment:
        console.print(f"next: {found.next_experiment['sentence']}")
    for note in found.notes:
        console.print(f"note: {note}")
