"""needle-rig demo: from a needle that ends crooked to one that ends straight, by learning what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import effects_option, jobs_option, json_option, library, say


@click.command("demo")
@click.option(
    "--parameters",
    shell_complete=completing("parameters"),
    default="rig_rigid",
    show_default=True,
    help="Parameter set, or a model file.",
)
@click.option(
    "--effect",
    "effects",
    shell_complete=completing("effects"),
    multiple=True,
    metavar="NAME[=VALUE]",
    help="What to hide in the rig; default: tissue_elasticity=0.3.",
)
@click.option("--law", is_flag=True, help="Hide a law that no effect holds; learn has to find it.")
@effects_option
@click.option(
    "--target",
    metavar="DEG",
    type=click.FloatRange(-360.0, 360.0),
    default=45.0,
    show_default=True,
    help="Angle that the needle shall reach, degrees.",
)
@click.option("--runs", type=click.IntRange(1, 100), default=8, show_default=True, help="Fresh needles.")
@click.option("--seed", type=click.IntRange(min=0), default=1, show_default=True)
@click.option(
    "--out", "model_out", type=click.Path(path_type=Path), help="Model file to write what was learnt to."
)
@picture_option(
    "--pictures", "picture", metavar="DIR", type=click.Path(path_type=Path), help="Draw a PNG to this folder."
)
@jobs_option
@json_option
def command(
    parameters: str,
    effects: tuple[str, ...],
    law: bool,
    directories: tuple[str, ...],
    target: float,
    runs: int,
    seed: int,
    model_out: Path | None,
    picture: Path | None,
    jobs: int | None,
    as_json: bool,
) -> None:
    """Go round the whole circle on a simulated rig that hides an effect.

    Runs with reed2008, diagnose, adopt, and planned with the new model on fresh needles of the same rig.
    Takes about a minute; some minutes with --law, where learn takes the place of diagnose.
    """
    from needle_rig.workbench.parallel import one_thread_each

    one_thread_each()
    from needle_rig.cli._workbench import worker
    from needle_rig.errors import BadInput
    from needle_rig.model import load_parameters, save_model
    from needle_rig.physics.effect_text import parse_effects
    from needle_rig.workbench.contest.demo import in_words, tell_law_story, tell_story
    from needle_rig.workbench.contest.untold_law import SECTION

    if target == 0.0:
        raise BadInput("--target 0: there is nothing to turn; give up to ±360 degrees")
    if law and effects:
        raise click.UsageError("--law hides a law of its own; leave --effect out.")
    known = library(directories)
    plant = load_parameters(parameters, effects=directories)
    if law:
        if len(plant.layout.tissue_sections_m) < SECTION:
            raise BadInput(
                f"--law acts in tissue section {SECTION}, and {parameters} has"
                f" {len(plant.layout.tissue_sections_m)}; name another parameter set"
            )
        with TemporaryDirectory(prefix="needle-rig-") as folder:
            draft = _draft(model_out, Path(folder))
            if draft.stem in known:
                raise BadInput(f"{draft.stem}: there is an effect of this name; name --out otherwise")
            story = tell_law_story(
                plant,
                known,
                draft,
                target_deg=target,
                runs=runs,
                seed=seed,
                workers=lambda: worker(jobs, None),
                say=say,
            )
    else:
        hidden = effects or (() if plant.effects else ("tissue_elasticity=0.3",))
        plant = plant.with_effects(*parse_effects(hidden, known))
        story = tell_story(
            plant, known, target_deg=target, runs=runs, seed=seed, work=worker(jobs, None), say=say
        )
    if model_out is not None:
        save_model(model_out, story.lesson.after)
        click.echo(f"model: {model_out}", err=True)
    if picture is not None:
        from needle_rig.figures.demo import demo_figure
        from needle_rig.figures.page import png

        picture.mkdir(parents=True, exist_ok=True)
        file = picture / "demo.png"
        file.write_bytes(png(demo_figure(story)))
        click.echo(f"picture: {file}", err=True)
    if as_json:
        click.echo(json.dumps(story.as_json(), ensure_ascii=False))
        return
    for paragraph in in_words(story):
        click.echo(paragraph)


def _draft(model_out: Path | None, folder: Path) -> Path:
    """Where a law's effect file goes: beside the model file, whose readers then name that folder."""
    return folder / "learnt_law.py" if model_out is None else model_out.with_name(f"{model_out.stem}_law.py")
