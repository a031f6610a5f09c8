"""What the workbench's commands share: how data, models and effects are named, and progress on stderr."""

from __future__ import annotations

import os
import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args, get_origin

import click

from needle_rig.cli._complete import completing
from needle_rig.questions.doing import Doing
from needle_rig.questions.fields import Within, defaults, hints

if TYPE_CHECKING:
    from needle_rig.questions.question import About, Question

Command = Callable[..., Any]
Words = tuple[str, ...]


def newest(paths: tuple[Any, ...]) -> tuple[Any, ...]:
    """The paths; `last` is the newest run where no file has that name."""
    from needle_rig.cli._runs import the_run

    runs = [path for path in paths if str(path) == "last" and not os.path.lexists(path)]
    run = the_run("last", None, None).path if runs else Path()
    return tuple(run if path in runs else path for path in paths)


def measured(_context: click.Context, _argument: click.Parameter, paths: tuple[Any, ...]) -> tuple[Any, ...]:
    """`newest` of what a command is given."""
    return newest(paths)


data_argument = click.argument(
    "data", nargs=-1, required=True, type=click.Path(path_type=Path), callback=measured
)
model_option = click.option(
    "--model",
    shell_complete=completing("parameters"),
    metavar="FILE|NAME",
    type=click.Path(path_type=Path),
    help="Model file, or a parameter set as rig_elastic; default: the null model.",
)
effects_option = click.option(
    "--effects",
    multiple=True,
    metavar="DIR",
    help="Further folder with effects, Python that will be run; config/effects is always searched.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), help="Processes; default: one a core. Results do not depend on it."
)
cluster_option = click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, as tcp://host:8786.")


def of_field(kind: type[Question], field: str, *declared: str, **more: Any) -> Callable[[Command], Command]:
    """The option of a question's field: its type, its bounds and its default are the field's."""
    hint, default = hints(kind)[field], defaults(kind).get(field)
    bounds = next((part for part in getattr(hint, "__metadata__", ()) if isinstance(part, Within)), None)
    number = get_args(hint)[0] if bounds else hint
    if hint is bool:
        more["is_flag"] = True
    elif get_origin(hint) is Sequence:
        more["multiple"] = True
    else:
        more |= {"default": default, "show_default": default is not None}
        if bounds:
            high = None if bounds.high == float("inf") else bounds.high
            kinds: dict[Any, Any] = {int: click.IntRange, float: click.FloatRange}
            more.setdefault("type", kinds[number](number(bounds.low), high and number(high)))
    return click.option(*(declared or (f"--{field.replace('_', '-')}",)), field, **more)


def terminal(jobs: int | None = None, cluster: str | None = None) -> Doing:
    """Works with a bar, steps and warnings on stderr, until it is done or stopped."""
    from needle_rig.cli._motion import end_as_by_ctrl_c
    from needle_rig.workbench.parallel import on_terminal, one_thread_each

    one_thread_each()
    end_as_by_ctrl_c()
    return Doing(
        jobs=jobs,
        cluster=cluster,
        say=say,
        tell=lambda sentence: click.echo(sentence, err=True),
        progress=on_terminal,
    )


def typed(command: str, question: About, *more: str, first: Words = (), last: Words = ()) -> str:
    """The line that asks another command about the same data, model and effects."""
    data = question.data
    assert isinstance(data, tuple)
    model = () if question.model is None else ("--model", str(question.model))
    folders = [word for folder in question.effects for word in ("--effects", str(folder))]
    return shlex.join(["needle-rig", command, *first, *map(str, data), *last, *model, *folders, *more])


def say(text: str) -> None:
    """One line of progress on stderr."""
    click.echo(f"{text} …", err=True)


def number(value: Any) -> str:
    """A number for a table."""
    if value is None:
        return "—"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
