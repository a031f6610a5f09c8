"""What the workbench's commands share: how data, models and effects are named, and progress on stderr."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from needle_rig.dataset import Dataset
    from needle_rig.physics.effect import Effect
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.workbench.work import Work

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


def one_thread_each() -> None:
    """Keep linear algebra on small matrices from starting threads; before NumPy is imported."""
    for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ.setdefault(name, "1")


def library(directories: tuple[str, ...]) -> Mapping[str, type[Effect]]:
    """Built-in and users' effects."""
    from needle_rig.model import effect_directories
    from needle_rig.physics.library import find_effects

    return find_effects(effect_directories(directories))


def read_data(paths: tuple[Path, ...]) -> Dataset:
    """One dataset from folders and run files."""
    from needle_rig.dataset import read_dataset

    return read_dataset(list(paths) if len(paths) > 1 else paths[0])


def read_model(path: Path | None, directories: tuple[str, ...]) -> NeedleModel | None:
    """The model of a model file; None for the null model."""
    if path is None:
        return None
    from needle_rig.model import load_model

    return load_model(path, effects=directories).model


def progress() -> Callable[[int, int], None]:
    """Tasks done and time left, on stderr: redrawn on a terminal, silent otherwise."""
    begun = time.monotonic()

    def show(done: int, total: int) -> None:
        nonlocal begun
        if done == 1:
            begun = time.monotonic()
        if not sys.stderr.isatty() or total < 2:
            return
        left = (time.monotonic() - begun) / max(done - 1, 1) * (total - done)
        said = f"\r  {done} of {total} effects, about {left:.0f} s left   "
        click.echo(said if done < total else "\r" + " " * 50 + "\r", nl=False, err=True)

    return show


def worker(jobs: int | None, cluster: str | None) -> Work:
    """Where tasks run, with progress shown."""
    from needle_rig.workbench.work import workers

    return workers(jobs, cluster, progress())


def say(text: str) -> None:
    """One line of progress on stderr."""
    click.echo(f"{text} …", err=True)


def number(value: Any) -> str:
    """A number for a table."""
    if value is None:
        return "—"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
