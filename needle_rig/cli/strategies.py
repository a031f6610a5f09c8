"""needle-rig strategies: every way of aligning the needle, side by side on one simulated rig."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import effects_option, jobs_option, json_option, say, warned, worker
from needle_rig.errors import BadInput

if TYPE_CHECKING:
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.workbench.contest.contest import Contest
    from needle_rig.workbench.contest.strategies_table import StrategyOverall

PAIR = ("planned", "reed2008")
EACH = "  {:<36}{:<24}{:>11}{:>13}{:>7}  {}"
TARGETS = "15,-15,45,-45,90,-90,180,-180"


@click.command("strategies")
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    default="rig_elastic",
    show_default=True,
    help="Parameter set, or a model file.",
)
@click.option(
    "--effect",
    "effects",
    shell_complete=completing("effects"),
    multiple=True,
    metavar="NAME[=VALUE]",
    help="Effect of the simulated rig.",
)
@click.option(
    "--each",
    is_flag=True,
    help="A rig of its own for every --effect, and one line for each: planned beside reed2008.",
)
@effects_option
@click.option(
    "--model",
    "model_path",
    help="Model file, or parameter set, that planned works with; default: identified from runs on this rig.",
)
@click.option(
    "--diagnose", is_flag=True, help="Let diagnose find the effects of that model, instead of naming them."
)
@click.option("--targets", default=TARGETS, show_default=True, help="Angles in degrees, with commas.")
@click.option(
    "--strategy",
    "names",
    shell_complete=completing("strategies"),
    multiple=True,
    help="Only this one; may be repeated.",
)
@click.option(
    "--seeds", type=click.IntRange(1, 1000), default=3, show_default=True, help="Runs of each kind."
)
@click.option(
    "--scatter-percent", type=float, default=5.0, show_default=True, help="Of friction, run to run."
)
@picture_option(
    "--pictures", metavar="DIR", type=click.Path(path_type=Path), help="Draw a PNG to this folder."
)
@jobs_option
@json_option
def command(
    parameters: str,
    effects: tuple[str, ...],
    each: bool,
    directories: tuple[str, ...],
    model_path: str | None,
    diagnose: bool,
    targets: str,
    names: tuple[str, ...],
    seeds: int,
    scatter_percent: float,
    pictures: Path | None,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Run every strategy on the simulated rig, from a relaxed and from a wound shaft.

    Friction differs from run to run, sensors are noisy, every strategy meets the same needles. Errors are of
    the true shaft, from the first tissue to the tip. planned works with a model identified from
    eight runs on the same rig.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.cli._workbench import library as find_library
    from needle_rig.control.strategy import find_strategies
    from needle_rig.model import load_parameters, load_saved
    from needle_rig.physics.effect_text import parse_effects
    from needle_rig.workbench.contest.contest import Asked, contest
    from needle_rig.workbench.contest.strategies_table import all_strategies
    from needle_rig.workbench.virtual.noise import Noise

    library = find_library(directories)
    warned(find_strategies())
    bare = load_parameters(parameters, effects=directories)
    angles = _targets(targets)
    strategies = tuple(n.replace("-", "_") for n in names) or (PAIR if each else all_strategies())
    if not 0.0 <= scatter_percent <= 50.0:
        raise BadInput(f"--scatter-percent {scatter_percent:g}: give 0 to 50")
    if each and (not effects or model_path is not None or pictures is not None):
        raise BadInput("--each needs --effect once or more, and goes without --model and --pictures")
    if each and not set(PAIR) <= set(strategies):
        raise BadInput(f"--each compares {' with '.join(PAIR)}: name both with --strategy, or none")
    saved = None if model_path is None else load_saved(model_path, effects=directories)
    asked = Asked(strategies, angles, seeds, Noise(friction_scatter=scatter_percent / 100.0))

    def run(plant: NeedleModel) -> Contest:
        return contest(
            plant,
            asked,
            library,
            saved,
            diagnose=diagnose,
            workers=lambda: worker(jobs, None),
            say=say,
            tell=lambda sentence: click.echo(sentence, err=True),
        )

    over = f"medians (95 % quantiles) over {len(angles)} targets, each {seeds} × relaxed and {seeds} × wound"
    if each:
        plants = {e: bare.with_effects(*parse_effects((e,), library)) for e in effects}
        if as_json:
            told = [{"effect": e} | run(plant).as_json() for e, plant in plants.items()]
            click.echo(json.dumps({"effects": told}, ensure_ascii=False, allow_nan=False))
            return
        click.echo(f"{parameters}: worst error of the shaft in °, {over}")
        click.echo(
            EACH.format("hidden effect", "in the model", "planned", "reed2008", "times", "said before")
        )
        sentences = [_show_one(effect, run(plant)) for effect, plant in plants.items()]
        for sentence in filter(None, sentences):
            click.echo(sentence)
        return
    plant = bare.with_effects(*parse_effects(effects, library))
    found = run(plant)
    if pictures is not None:
        from needle_rig.figures.page import png
        from needle_rig.figures.strategies import strategies_figure

        pictures.mkdir(parents=True, exist_ok=True)
        file = pictures / "strategies.png"
        hidden = ", ".join(e.name() for e in plant.effects) or "rigid tissue"
        title = f"{parameters} ({hidden}), {scatter_percent:g} % scatter of friction"
        file.write_bytes(png(strategies_figure(found.table, title)))
        click.echo(f"picture: {file}", err=True)
    if as_json:
        click.echo(json.dumps(found.as_json(), ensure_ascii=False, allow_nan=False))
        return
    _show(found.table.overall(), f"{parameters}: {over}")


def _targets(text: str) -> tuple[float, ...]:
    try:
        return tuple(float(part) for part in text.split(",") if part.strip())
    except ValueError:
        raise BadInput(f"--targets {text}: write degrees with commas, as in --targets 45,-90") from None


def _show_one(effect: str, found: Contest) -> str:
    """Print one line a hidden effect; the answer says why planning will not help much, or is empty."""
    rows = {row["strategy"]: row for row in found.table.overall()}
    saved, told = found.saved, found.foretold
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
