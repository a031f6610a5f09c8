"""How questions are asked from Python: what counts as data and as a model, progress."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterable, Sequence
from typing import Any, TypeAlias

from needle_rig.dataset import Dataset
from needle_rig.dataset.settled import SettledData
from needle_rig.model import SavedModel
from needle_rig.notebook.data import Data
from needle_rig.notebook.model import Model
from needle_rig.notebook.run import Run
from needle_rig.questions.doing import Doing
from needle_rig.workbench.parallel import on_terminal

PathLike: TypeAlias = str | os.PathLike[str]
AnyData: TypeAlias = Data | Run | Dataset | SettledData | PathLike
"""What may be asked about: what `read_dataset`, `simulate` and `read_run` give, or a path."""
AnyModel: TypeAlias = Model | PathLike
"""A model, a model file's path or a parameter set's name."""

WARNING = "warning: "


def given(data: AnyData) -> Dataset | SettledData | PathLike:
    """Data as questions take them; what is none is refused there."""
    if isinstance(data, Data):
        return data.given
    return data.dataset().given if isinstance(data, Run) else data


def known(model: AnyModel | None) -> SavedModel | PathLike | None:
    """A model as questions take it; what is none is refused there."""
    return model.saved if isinstance(model, Model) else model


def several(given: PathLike | Sequence[Any]) -> Sequence[Any]:
    """One name or folder as a sequence of it."""
    return (given,) if isinstance(given, str | os.PathLike) else given


def at_work(jobs: int | None = None) -> Doing:
    """Processes that show how far they are, one a core where `jobs` is None."""
    return Doing(jobs=jobs, say=step, tell=told, progress=progress)


def told(sentence: str) -> None:
    """A warning points at the cell or the line that asked; anything else is printed as a step is."""
    if sentence.startswith(WARNING):
        warnings.warn(sentence.removeprefix(WARNING), stacklevel=5)
    else:
        step(sentence)


def in_notebook() -> bool:
    """Whether a notebook's kernel runs this."""
    return "ipykernel" in sys.modules


def step(text: str) -> None:
    """The step that begins: a line on a terminal and in a notebook, and nothing in the output of a script."""
    if in_notebook():
        print(f"{text} …")  # noqa: T201 - stderr is red there, as an error is
    elif sys.stderr.isatty():
        print(f"{text} …", file=sys.stderr)  # noqa: T201 - how far a script is


def progress(results: Iterable[Any], total: int) -> Iterable[Any]:
    """Hands on `results` with a bar: tqdm's in a notebook that has it, otherwise the terminal's."""
    if in_notebook():
        try:
            from tqdm.auto import tqdm
        except ImportError:
            return results
        bar: Iterable[Any] = tqdm(results, total=total, leave=False)
        return bar
    return on_terminal(results, total)
