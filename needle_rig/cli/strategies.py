"""needle-rig strategies: every way of aligning the needle, side by side on one simulated rig."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import effects_option, jobs_option, json_option, of_field, terminal
from needle_rig.errors import BadInput
from needle_rig.questions.fields import defaults
from needle_rig.questions.strategies import Strategies

if TYPE_CHECKING:
    from needle_rig.questions.doing import Doing
    from needle_rig.workbench.contest.contest import Contest
    from needle_rig.workbench.contest.strategies_table import StrategyOverall

PAIR = ("planned", "reed2008")
EACH = "  {:<36}{:<24}{:>11}{:>13}{:>7}  {}"


def _degrees(_context: click.Context, _option: click.Parameter, text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise BadInput(f"--targets {text}: write degrees with commas, as in --targets 45,-90") from None


@click.command("strategies")
@of_field(
    Strategies,
    "parameters",
    shell_complete=completing("parameters"),
    help="Parameter set, or a model file.",
)
@of_field(
    Strategies,
    "hidden",
    "--effect",
    shell_complete=completing("effects"),
    metavar="NAME[=VALUE]",
    help="Effect of the simulated rig.",
)
@click.option(
    "--each",
    is_flag=True,
    help="A rig of its own for every --effect, and one line for each: planned beside reed2008.",
)
@effects_option
@of_field(
    Strategies,
    "model",
    help="Model file, or parameter set, that planned works with; default: identified from runs on this rig.",
)
@of_field(
    Strategies,
    "diagnose",
    help="Let diagnose find the effects of that model, instead of naming them.",
)
@click.option(
    "--targets",
    "targets_deg",
    default=",".join(f"{target:g}" for target in defaults(Strategies)["targets_deg"]),
    show_default=True,
    callback=_degrees,
    help="Angles in degrees, with commas.",
)
@of_field(
    Strategies,
    "names",
    "--strategy",
    shell_complete=completing("strategies"),
    callback=lambda _context, _option, names: tuple(name.replace("-", "_") for name in names),
    help="Only this one; may be repeated.",
)
@of_field(Strategies, "seeds", help="Runs of each kind.")
@click.option(
    "--scatter-percent",
    type=float,
    default=100.0 * defaults(Strategies)["friction_scatter"],
    show_default=True,
    help="Of friction, run to run.",
)
@picture_option(
    "--pictures", metavar="DIR", type=click.Path(path_type=Path), help="Draw a PNG to this folder."
)
@jobs_option
@json_option
def command(
    each: bool, scatter_percent: float, pictures: Path | None, jobs: int | None, as_json: bool, **asked: Any
) -> None:
    """Run every strategy on the simulated rig, from a relaxed and from a wound shaft.

    Friction differs from run to run, sensors are noisy, every strategy meets the same needles. Errors are of
    the true shaft, from the first tissue to the tip. planned works with a model identified from
    eight runs on the same rig.
    """
    doing = terminal(jobs)
    if not 0.0 <= scatter_percent <= 50.0:
        raise BadInput(f"--scatter-percent {scatter_percent:g}: give 0 to 50")
    question = Strategies(friction_scatter=scatter_percent / 100.0, **asked)
    over = (
        f"{question.parameters}: {{}}medians (95 % quantiles) over {len(question.targets_deg)} targets,"
        f" each {question.seeds} × relaxed and {question.seeds} × wound"
    )
    if each:
        if not question.hidden or question.model is not None or pictures is not None:
            raise BadInput("--each needs --effect once or more, and goes without --model and --pictures")
        question = dataclasses.replace(question, names=question.names or PAIR)
        if not set(PAIR) <= set(question.names):
            raise BadInput(f"--each compares {' with '.join(PAIR)}: name both with --strategy, or none")
        with doing.work(question) as work:
            doing = dataclasses.replace(doing, at=work)
            _each(question, doing, over.format("worst error of the shaft in °, "), as_json)
        return
    found = question.answer(doing)
    if pictures is not None:
        from needle_rig.figures.figure import png
        from needle_rig.figures.strategies import strategies_figure

        pictures.mkdir(parents=True, exist_ok=True)
        file = pictures / "strategies.png"
        hidden = ", ".join(e.name() for e in question.plant().effects) or "rigid tissue"
        title = f"{question.parameters} ({hidden}), {scatter_percent:g} % scatter of friction"
        file.write_bytes(png(strategies_figure(found.table, title)))
        click.echo(f"picture: {file}", err=True)
    if as_json:
        click.echo(json.dumps(found.as_json(), ensure_ascii=False, allow_nan=False))
        return
    _show(found.table.overall(), over.format(""))


def _each(question: Strategies, doing: Doing, title: str, as_json: bool) -> None:
    """One rig for each hidden effect; all are made before the first is run."""
    rigs = {str(effect): dataclasses.replace(question, hidden=(effect,)) for effect in question.hidden}
    for one in rigs.values():
        one.plant()
    if as_json:
        told = [{"effect": effect} | one.answer(doing).as_json() for effect, one in rigs.items()]
        click.echo(json.dumps({"effects": told}, ensure_ascii=False, allow_nan=False))
        return
    click.echo(title)
    click.echo(EACH.format("hidden effect", "in the model", "planned", "reed2008", "times", "said before"))
    sentences = [_show_one(effect, one.answer(doing)) for effect, one in rigs.items()]
    for sentence in filter(None, sentences):
        click.echo(sentence)


def _show_one(effect: str, found: Contest) -> str:
    """Print one line a hidden effect; the answer says why planning will not help much, or is empty."""
    rows = {row["strategy"]: row for row in found.table.overall()}
    saved, told = found.saved, found.predicted
    assert saved is not None
    assert told is not None
    names = ", ".join(e.name() for e in saved.model.effects) or "none"
    errors = [rows[name]["worst_deg"] for name in PAIR if "worst_deg" in rows[name]]
    cells = [f"{e['median']:.1f} ({e['q95']:.1f})" for e in errors]
    if len(errors) < len(PAIR):
        click.echo(EACH.format(effect, names, "refused", *cells, "", "refused"))
        return f"{effect}: {told.sentence}"
    times = f"{errors[1]['median'] / errors[0]['median']:.1f}"
    before = f"{told.planned_deg:.1f} ({told.q95_deg:.1f}) against {told.reed2008_deg:.1f}"
    click.echo(EACH.format(effect, names, *cells, times, before))
    return f"{effect}: {told.sentence}" if told.little_gained else ""


def _show(rows: list[StrategyOverall], title: str) -> None:
    """A table, the straightest shaft first; then what was refused and what gave way."""
    click.echo(title)
    heads = ("tip lag °", "worst °", "mean °", "torque N·mm", "rotations", "total °", "time s")
    click.echo(f"  {'strategy':<17}" + "".join(f"{head:>15}" for head in heads))
    for row in sorted(rows, key=lambda r: r["worst_deg"]["median"] if "worst_deg" in r else float("inf")):
        if "worst_deg" not in row:
            click.echo(f"  {row['strategy']:<17}" + f"{'refused':>15}")
            continue
        cells = [
            f"{of['median']:.{d}f} ({of['q95']:.{d}f})"
            for of, d in (
                (row["tip_lag_deg"], 1),
                (row["worst_deg"], 1),
                (row["mean_deg"], 1),
                (row["torque_nmm"], 3),
            )
        ]
        cells += [f"{row['rotations']:g}", f"{row['total_rotation_deg']:.0f}", f"{row['time_s']:.1f}"]
        click.echo(f"  {row['strategy']:<17}" + "".join(f"{cell:>15}" for cell in cells))
    for row in rows:
        if "refused" in row:
            click.echo(f"{row['strategy']}: {row['refused']}")
        if "gave_way_to_reed2008" in row:
            click.echo(
                f"{row['strategy']}: its model did not hold in {row['gave_way_to_reed2008']} of {row['runs']}"
                " runs, where it went on as reed2008"
            )
