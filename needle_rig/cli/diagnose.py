"""needle-rig diagnose: which physical effect is missing."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._output import console
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import (
    cluster_option,
    data_argument,
    effects_option,
    jobs_option,
    json_option,
    model_option,
    of_field,
    terminal,
    typed,
)
from needle_rig.errors import BadInput
from needle_rig.questions.diagnose import Diagnose

if TYPE_CHECKING:
    from needle_rig.workbench.selection.answer import Answer


@click.command("diagnose")
@data_argument
@model_option
@effects_option
@of_field(Diagnose, "max_effects")
@of_field(
    Diagnose,
    "quick",
    help="One effect alone, each by itself: half the time or less, and no second one.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Diagnosis file to write, for adopt.")
@picture_option("--html", type=click.Path(path_type=Path), help="Write a report in one file, to send.")
@jobs_option
@cluster_option
@json_option
def command(
    out: Path | None, html: Path | None, jobs: int | None, cluster: str | None, as_json: bool, **asked: Any
) -> None:
    """Say which effect is missing from the model: its size, its rivals, and what the data cannot tell.

    Of a --model it says first whether its values hold as they stand, then whether its structure does.

    \b
    needle-rig diagnose data/mine --out diagnosis.yaml
    needle-rig diagnose data/mine --model fitted.yaml --effects my_effects --json
    needle-rig diagnose data/mine --html report.html

    DATA is a dataset folder or a run file, or several; or a folder of settled values as published
    (settled.yaml; reed2008 is shipped), where one effect at a time is tried. Every verdict (effect, none,
    unknown) exits with 0.
    """
    doing, question = terminal(jobs, cluster), Diagnose(**asked)
    from needle_rig.workbench.learning.observations import Traces

    for option, path in (("--out", out), ("--html", html)):
        if path is not None and not path.absolute().parent.is_dir():
            raise BadInput(
                f"{option} {path}: there is no folder {path.parent}; make it, or name another place"
            )
    answer = question.answer(doing)
    if out is not None:
        answer.save(out)
        click.echo(f"wrote {out}", err=True)
    if html is not None:
        question.write_report(answer.told(), answer.keep(), answer.compared(), html)
        click.echo(f"wrote {html}", err=True)
    document, found = answer.as_json(), answer.found
    if as_json:
        click.echo(json.dumps(document, ensure_ascii=False))
        return
    values = document.get("model_values")
    _show(found, [] if values is None else values["sentences"])
    if found.verdict == "none" and values is not None and values["contradict"]:
        taken = typed("identify", question, "--out", "MODEL.yaml")
        click.echo(f"take the values of these data over: {taken}")
    if found.verdict == "effect":
        click.echo(f"adopt it: {_next_step(found, question, out)}")
    elif found.verdict == "unknown":
        for sentence in _ways_on(found, question, laws=isinstance(answer.observed, Traces)):
            click.echo(sentence)


def _next_step(found: Answer, question: Diagnose, out: Path | None) -> str:
    """The commands that take the answer over."""
    choice = [word for effect in found.effects for word in ("--effect", effect)] if found.ties else []
    file = str(out or "DIAGNOSIS.yaml")
    started = dataclasses.replace(question, model=None)  # the diagnosis file holds it
    adopt = typed("adopt", started, *choice, "--out", "MODEL.yaml", first=(file,))
    return adopt if out is not None else f"{typed('diagnose', question, '--out', file)}, then {adopt}"


def _ways_on(found: Answer, question: Diagnose, *, laws: bool) -> Iterator[str]:
    """What goes on from *unknown*, each with its command filled in."""
    from needle_rig.workbench.selection.way_on import way_on

    way = way_on(found)
    if question.quick:
        thorough = dataclasses.replace(question, quick=False)
        yield f"look for more than one effect: {typed('diagnose', thorough)}"
    if way.part is not None:
        on = dataclasses.replace(question, model=Path("MODEL.yaml"))
        adopt = typed("adopt", question, "--out", "MODEL.yaml", last=(way.part.effect,))
        yield f"{way.part_sentence()}: {adopt}, then {typed('diagnose', on)}"
    if laws:
        yield (
            "look for a law that the library does not hold, which takes as long as a diagnosis without"
            f" --quick or longer: {typed('learn', question, '--out', 'found.py')}"
        )
    if way.record:
        both = typed("diagnose", question, last=("NEW_DATA",))
        yield f"{way.record_sentence()}: {both}"
    if way.channel:
        yield way.channel_sentence()


def _show(found: Answer, values: Sequence[str]) -> None:
    from rich.table import Table
    from rich.text import Text

    from needle_rig.workbench.selection.answer import left_out_error

    # names and notes come from files: brackets in them are no markup
    out = console()
    against = f" against the model {found.model}: "
    if values:
        first, *others = values
        out.print(Text.assemble((found.dataset, "bold"), against + first))
        for sentence in others:
            out.print(f"  {sentence}")
        out.print(Text.assemble(("structure", "bold"), f": {found.sentence()}"))
    else:
        out.print(Text.assemble((found.dataset, "bold"), against + found.sentence()))
    out.print(found.errors_sentence())
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for heading in ("effect", "held out", "removed"):
        table.add_column(heading, no_wrap=True)
    table.add_column("for and against")
    for row in found.ranking[: max(6, len(found.effects))]:
        words = row.in_favour + (f"; against: {row.against}" if row.against else "")
        table.add_row(
            row.effect, left_out_error(row.held_out_error), f"{100 * row.error_removed:.0f} %", words
        )
    out.print(table)
    for row in found.ranking[: len(found.effects)]:
        for v in row.values:
            unit = "" if v.unit == "1" else f" {v.unit}"
            out.print(f"{row.effect}.{v.name} = {v.value:.4g} (95 %: {v.low:.4g} … {v.high:.4g}){unit}")
    for kind in ("present", "negligible", "cannot_tell", "absent"):
        names = [d for d in found.decisions.values() if d.decision == kind]
        if names:
            said = ", ".join(d.effect if kind == "present" else d.sentence() for d in names)
            out.print(Text.assemble((kind.replace("_", " "), "bold"), f": {said}"))
    for sentence in found.left_in_words():
        out.print(f"left over: {sentence}")
    if found.next_experiment:
        out.print(f"next: {found.next_experiment['sentence']}")
    for note in found.notes:
        out.print(f"note: {note}")
