"""How questions are asked from Python: what counts as data and as a model, progress, words of errors."""

from __future__ import annotations

import functools
import os
import re
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ParamSpec, TypeAlias, TypeVar

from needle_rig.dataset import Dataset
from needle_rig.dataset.settled import SettledData
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.model import SavedModel, effect_directories, load_saved
from needle_rig.notebook.data import Data
from needle_rig.notebook.model import Model
from needle_rig.notebook.run import Run
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.workbench.observations.sources import read_observed
from needle_rig.workbench.parallel import Work, on_terminal, workers

PathLike: TypeAlias = str | os.PathLike[str]
AnyData: TypeAlias = Data | Run | Dataset | SettledData | PathLike
"""What may be asked about: what `read_dataset`, `simulate` and `read_run` give, or a path."""
AnyModel: TypeAlias = Model | PathLike
"""A model, a model file's path or a parameter set's name."""

P = ParamSpec("P")
R = TypeVar("R")

_OPTION = re.compile(r"--([a-z][a-z-]*[a-z])")


def in_python(text: str) -> str:
    """A sentence that names options of the command line, with the arguments that they are here."""
    return _OPTION.sub(lambda found: found[1].replace("-", "_"), text)


def asked(question: Callable[P, R]) -> Callable[P, R]:
    """The same function, whose errors name arguments instead of options."""

    @functools.wraps(question)
    def answered(*args: P.args, **kwargs: P.kwargs) -> R:
        try:
            return question(*args, **kwargs)
        except NeedleRigError as error:
            error.args = tuple(in_python(a) if isinstance(a, str) else a for a in error.args)
            raise

    return answered


def observed(data: AnyData) -> Dataset | SettledData:
    """Traces or settled values. Raises BadInput, also for what is neither."""
    if isinstance(data, Data):
        return data.given
    if isinstance(data, Run):
        return data.dataset().given
    if isinstance(data, Dataset | SettledData):
        return data
    if isinstance(data, str | os.PathLike):
        return read_observed([data])
    raise BadInput(f"data is of type {type(data).__name__}; give a path, or what read_dataset gives")


def traces(data: AnyData, purpose: str) -> Dataset:
    """Traces alone, which `purpose` needs. Raises BadInput for settled values."""
    found = observed(data)
    if isinstance(found, SettledData):
        raise BadInput(
            f"{found.name} has settled values only, too few to {purpose}; name a dataset of traces"
        )
    return found


def saved(model: AnyModel | None, effects: Sequence[PathLike] = ()) -> SavedModel | None:
    """What is known of a model; None for the null model. Raises BadInput."""
    if model is None or isinstance(model, Model):
        return None if model is None else model.saved
    if isinstance(model, str | os.PathLike):
        return load_saved(model, effects=[os.fspath(folder) for folder in effects])
    raise BadInput(f"model is of type {type(model).__name__}; give a path, or what read_model or adopt gives")


def library(folders: Sequence[PathLike] = ()) -> Mapping[str, type[Effect]]:
    """Effects by name, those of further folders among them."""
    return find_effects(effect_directories(tuple(os.fspath(folder) for folder in folders)))


def at_work(jobs: int | None) -> Work:
    """Processes that show how far they are; one a core where `jobs` is None."""
    return workers(jobs, None, progress)


def progress(results: Iterable[Any], total: int) -> Iterable[Any]:
    """Hands on `results` with a bar: tqdm's in a notebook that has it, otherwise the terminal's."""
    if "ipykernel" in sys.modules:
        try:
            from tqdm.auto import tqdm
        except ImportError:
            return results
        bar: Iterable[Any] = tqdm(results, total=total, leave=False)
        return bar
    return on_terminal(results, total)
