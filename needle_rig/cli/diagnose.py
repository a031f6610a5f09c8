"""needle-rig diagnose: which physical effect is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._workbench import (
    cluster_option,
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    left_out_error,
    library,
    model_option,
    read_data,
    read_model,
    read_settled_values,
    say,
    seed_option,
    worker,
)

if TYPE_CHECKING:
    from needle_rig.workbench.selection.answer import Answer


@click.command("diagnose")
@data_argument
@model_option
@effects_option
@click.option("--max-effects", type=click.IntRange(1, 6), default=3, show_default=True)
@seed_option
@jobs_option
@cluster_option
@json_option
def command(
    data: tuple[Path, ...],
    model_path: Path | None,
    directories: tuple[str, ...],
    max_effects: int,
    seed: int,
    jobs: int | None,
    cluster: str | None,
    as_json: bool,
) -> None:
    """Say which effect is missing from the model: its size, its rivals, and what the data cannot tell.

    \b
    needle-rig diagnose data/mine
    needle-rig diagnose data/mine --model fitted.yaml --effects my_effects --json

    DATA is a dataset folder or a run file, or several; or a folder of settled values as published
    (settled.yaml; reed2008 is shipped), where one effect at a time is tried. Every verdict (effect, none,
    unknown) exits with 0.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.workbench.published.diagnose import diagnose_settled
    from needle_rig.workbench.selection.diagnose import diagnose

    effects, model = library(directories), read_model(model_path, directories)
    found: Answer
    if (settled := read_settled_values(data)) is not None:
        found = diagnose_settled(settled, effects, model, say=say)
    else:
        found = diagnose(
            read_data(data),
            effects,
            model,
            max_effects=max_effects,
            seed=seed,
            work=worker(jobs, cluster),
            say=say,
        )
    click.echo(json.dumps(found.as_json(), ensure_ascii=False) if as_json else "", nl=as_json)
    if not as_json:
        _show(found)


def _show(found: Answer) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # names and notes come from files: brackets in them are no markup
    console = Console(highlight=False, soft_wrap=False, markup=False)
    against = f" against the model {found.model}: {_verdict(found)}"
    console.print(Text.assemble((found.dataset, "bold"), against))
    before, after = left_out_error(found.held_out_error_before), left_out_error(found.held_out_error_after)
    console.print(
        f"Error on {found.left_out} left out: {before} → {after} (noise is {found.noise_floor:.2f})"
    )
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


def _verdict(found: Answer) -> str:
    if found.verdict == "none":
        return "nothing is missing beyond the noise and the scatter of the trials."
    if found.verdict == "unknown":
        return "something is missing that no effect of the library explains."
    ties = {r for row in found.ranking[: len(found.effects)] for r in row.indistinguishable_from}
    named = " and ".join(found.effects)
    return f"{named} missing" + (f"; cannot be told apart from {', '.join(sorted(ties))}." if ties else ".")
