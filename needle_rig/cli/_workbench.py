"""What the workbench's commands share: how data, models and effects are named, and progress on stderr."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from needle_rig.cli._complete import completing

if TYPE_CHECKING:
    from needle_rig.config.own_things import Library
    from needle_rig.dataset import Dataset
    from needle_rig.model import SavedModel
    from needle_rig.physics.effect import Effect
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.workbench.learning.observations import Observations
    from needle_rig.workbench.parallel import Work

Thing = TypeVar("Thing")

data_argument = click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
model_option = click.option(
    "--model",
    "model_path",
    shell_complete=completing("parameters"),
    metavar="FILE|NAME",
    type=click.Path(path_type=Path),
    help="Model file, or a parameter set as rig_elastic; default: the null model.",
)
effects_option = click.option(
    "--effects",
    "directories",
    multiple=True,
    metavar="DIR",
    help="Further folder with effects, Python that will be run; config/effects is always searched.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), help="Processes; default: one a core. Results do not depend on it."
)
cluster_option = click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, as tcp://host:8786.")


def library(directories: tuple[str, ...]) -> Mapping[str, type[Effect]]:
    """Built-in effects and one's own; each that is broken gets a warning line."""
    from needle_rig.model import effect_directories
    from needle_rig.physics.library import find_effects

    return warned(find_effects(effect_directories(directories)))


def warned(found: Library[Thing]) -> Library[Thing]:
    """`found`, after a line on stderr for each thing of one's own that cannot be used."""
    for _, sentence in found.broken:
        click.echo(f"warning: {sentence}", err=True)
    return found


def read_data(paths: tuple[Path, ...]) -> Dataset:
    """One dataset of traces from folders, run files and names of datasets in config/datasets."""
    from needle_rig.workbench.observations.sources import read_measurements

    found = _found(paths)
    read = read_measurements(found)
    _mark_read(found)
    return read


def read_observations(paths: tuple[Path, ...]) -> Observations:
    """Traces, or the settled values that DATA names. Raises BadInput for both at once."""
    from needle_rig.workbench.learning.observations import read_observations as read

    found = _found(paths)
    measured = read(found)
    _mark_read(found)
    return measured


def _found(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The paths; `last` is the newest run where no file has that name."""
    from needle_rig.cli._runs import the_run

    newest = [path for path in paths if str(path) == "last" and not os.path.lexists(path)]
    run = the_run("last", None, None).path if newest else Path()
    return tuple(run if path in newest else path for path in paths)


def _mark_read(paths: tuple[Path, ...]) -> None:
    from needle_rig.recording import is_run_file, mark_read

    for path in paths:
        if is_run_file(str(path)):
            mark_read(path)


def read_model(path: Path | None, directories: tuple[str, ...]) -> NeedleModel | None:
    """The model of a model file or a parameter set; None for the null model."""
    saved = read_saved(path, directories)
    return None if saved is None else saved.model


def read_saved(path: Path | None, directories: tuple[str, ...]) -> SavedModel | None:
    """A model file with its history, or a parameter set; None for the null model."""
    if path is None:
        return None
    from needle_rig.model import load_saved

    return load_saved(path, effects=directories)


def worker(jobs: int | None, cluster: str | None) -> Work:
    """Where tasks run, with progress shown."""
    from needle_rig.workbench.parallel import on_terminal, workers

    return workers(jobs, cluster, on_terminal)


def say(text: str) -> None:
    """One line of progress on stderr."""
    click.echo(f"{text} …", err=True)


def number(value: Any) -> str:
    """A number for a table."""
    if value is None:
        return "—"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
