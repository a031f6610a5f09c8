"""needle-rig demo: from a needle that ends crooked to one that ends straight, by learning what is missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from needle_rig.cli._complete import completing
from needle_rig.cli._pictures import picture_option
from needle_rig.cli._workbench import effects_option, jobs_option, json_option, of_field, terminal
from needle_rig.questions.demo import Demo


@click.command("demo")
@of_field(Demo, "parameters", shell_complete=completing("parameters"), help="Parameter set, or a model file.")
@of_field(
    Demo,
    "hidden",
    "--effect",
    shell_complete=completing("effects"),
    metavar="NAME[=VALUE]",
    help="What to hide in the rig; default: tissue_elasticity=0.3.",
)
@of_field(Demo, "law", help="Hide a law that no effect holds; learn has to find it.")
@effects_option
@of_field(Demo, "target_deg", "--target", metavar="DEG", help="Angle that the needle shall reach, degrees.")
@of_field(Demo, "runs", help="Fresh needles.")
@of_field(Demo, "seed")
@click.option(
    "--out", "model_out", type=click.Path(path_type=Path), help="Model file to write what was learnt to."
)
@picture_option(
    "--pictures", "picture", metavar="DIR", type=click.Path(path_type=Path), help="Draw a PNG to this folder."
)
@jobs_option
@json_option
def command(
    model_out: Path | None, picture: Path | None, jobs: int | None, as_json: bool, **asked: Any
) -> None:
    """Go round the whole circle on a simulated rig that hides an effect.

    Runs with reed2008, diagnose, adopt, and planned with the new model on fresh needles of the same rig.
    Takes about a minute; some minutes with --law, where learn takes the place of diagnose.
    """
    doing = terminal(jobs)
    # a law's effect file goes beside the model file, whose readers then name that folder
    draft = model_out and model_out.with_name(f"{model_out.stem}_law.py")
    story = Demo(draft=draft, **asked).answer(doing)
    from needle_rig.model import save_model
    from needle_rig.workbench.contest.demo import in_words

    if model_out is not None:
        save_model(model_out, story.lesson.after)
        click.echo(f"model: {model_out}", err=True)
    if picture is not None:
        from needle_rig.figures.demo import demo_figure
        from needle_rig.figures.figure import png

        picture.mkdir(parents=True, exist_ok=True)
        file = picture / "demo.png"
        file.write_bytes(png(demo_figure(story)))
        click.echo(f"picture: {file}", err=True)
    if as_json:
        click.echo(json.dumps(story.as_json(), ensure_ascii=False))
        return
    for paragraph in in_words(story):
        click.echo(paragraph)
