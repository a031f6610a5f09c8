"""What the workbench's commands share: how data, models and effects are named, and progress on stderr."""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from needle_rig.dataset import Dataset
    from needle_rig.dataset.settled import SettledData
    from needle_rig.physics.effect import Effect
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.workbench.parallel import Work

data_argument = click.argument("data", nargs=-1, required=True, type=click.Path(path_type=Path))
model_option = click.option(
    "--model", "model_path", type=click.Path(path_type=Path), help="Model file; default: the null model."
)
effects_option = click.option(
    "--effects", "directories", multiple=True, metavar="DIR", help="Further folder with effects."
)
json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
seed_option = click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
jobs_option = click.option(
    "--jobs", type=click.IntRange(min=1), help="Processes; default: one a core. Results do not depend on it."
)
cluster_option = click.option("--cluster", metavar="ADDRESS", help="Dask scheduler, as tcp://host:8786.")


def library(directories: tuple[str, ...]) -> Mapping[str, type[Effect]]:
    """Built-in and users' effects."""
    from needle_rig.model import effect_directories
    from needle_rig.physics.library import find_effects

    return find_effects(effect_directories(directories))


def read_data(paths: tuple[Path, ...]) -> Dataset:
    """One dataset from folders, run files and names of datasets in config/datasets."""
    from needle_rig.recording import is_run_file, mark_read
    from needle_rig.workbench.observations.sources import read_measurements

    found = _found(paths)
    read = read_measurements(found)
    for path in found:
        if is_run_file(str(path)):
            mark_read(path)
    return read


def read_settled_values(paths: tuple[Path, ...]) -> SettledData | None:
    """The settled values that DATA names; None where it names traces. Raises BadInput for both at once."""
    from needle_rig.dataset.settled import is_settled, read_settled
    from needle_rig.errors import BadInput

    found = _found(paths)
    settled = [path for path in found if is_settled(path)]
    if settled and len(found) > 1:
        raise BadInput(f"{settled[0]} holds settled values; give it alone")
    return read_settled(settled[0]) if settled else None


def _found(paths: tuple[Path, ...]) -> list[Path]:
    """The paths, those that do not exist looked for by name in config/datasets; `last` is the newest run."""
    from needle_rig.dataset.settled import shipped_datasets

    known = {} if all(os.path.lexists(path) for path in paths) else shipped_datasets()
    return [path if os.path.lexists(path) else known.get(str(path)) or _run_or(path) for path in paths]


def _run_or(path: Path) -> Path:
    from needle_rig.cli._runs import the_run

    return the_run("last", None, None).path if str(path) == "last" else path


def read_model(path: Path | None, directories: tuple[str, ...]) -> NeedleModel | None:
    """The model of a model file; None for the null model."""
    if path is None:
        return None
    from needle_rig.model import load_model

    return load_model(path, effects=directories).model


def progress(results: Iterable[Any], total: int) -> Iterable[Any]:
    """Hands on `results` with a bar and the time left on stderr: on a terminal, silent otherwise."""
    from rich.console import Console
    from rich.progress import track

    silent = total < 2 or not sys.stderr.isatty()
    return track(results, "", total, console=Console(stderr=True), transient=True, disable=silent)


def worker(jobs: int | None, cluster: str | None) -> Work:
    """Where tasks run, with progress shown."""
    from needle_rig.workbench.parallel import workers

    return workers(jobs, cluster, progress)


def say(text: str) -> None:
    """One line of progress on stderr."""
    click.echo(f"{text} …", err=True)


def left_out_error(error: float | None) -> str:
    """An error on commands left out, or a dash where there was only one command."""
    return "—" if error is None or not math.isfinite(error) else f"{error:.2f}"


def number(value: Any) -> str:
    """A number for a table."""
    if value is None:
        return "—"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
