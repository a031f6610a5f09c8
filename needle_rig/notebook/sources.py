"""Where measurements and models come from: files, other programs' recordings, the simulated rig."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from needle_rig.dataset.protocol import Protocol
from needle_rig.errors import BadInput
from needle_rig.model import load_saved
from needle_rig.notebook.asking import AnyModel, PathLike, at_work, several
from needle_rig.notebook.catalogue import hidden_effects
from needle_rig.notebook.data import Data
from needle_rig.notebook.model import Model
from needle_rig.notebook.run import Run
from needle_rig.questions.export import Form
from needle_rig.questions.recordings import Understand
from needle_rig.questions.simulate import Simulate
from needle_rig.recording import RunFile
from needle_rig.workbench.observations.sources import read_observed
from needle_rig.workbench.virtual.noise import Noise


def read_dataset(*paths: PathLike) -> Data:
    """The trials of dataset folders and run files, or settled values, by path or by name. Raises BadInput."""
    return Data(read_observed(paths))


def read_run(path: PathLike) -> Run:
    """A run file. Raises BadInput."""
    return Run(RunFile(path))


def read_model(path: PathLike, *, effects: Iterable[PathLike] = ()) -> Model:
    """A model file or a parameter set; `effects` are further folders with effects. Raises BadInput."""
    return Model(load_saved(path, effects=[Path(e) for e in effects]))


def simulate(
    effects: Mapping[str, float | Mapping[str, float]] | None = None,
    *,
    parameters: AnyModel = "rig_rigid",
    protocol: PathLike | Protocol = "standard",
    replicates: int = 1,
    layout: PathLike | None = None,
    seed: int = 1,
    noise: Noise | None = None,
    rate_hz: float = 50.0,
    name: str = "simulated",
    out: PathLike | None = None,
    folders: Sequence[PathLike] = (),
) -> Data:
    """Simulated trials with effects hidden in them, `{"tissue_elasticity": 0.35}` in the units of files.

    An effect of several parameters takes them by name; `folders` are further ones with effects. `parameters`
    is a parameter set or a model. `layout` is `experiment`, `model`, a rig file or a dataset folder, in place
    of the model's own. With `out` the dataset is written there too. Raises BadInput.
    """
    question = Simulate(
        parameters=parameters.saved if isinstance(parameters, Model) else parameters,
        hidden=hidden_effects({} if effects is None else effects, folders),
        effects=several(folders),
        protocol=protocol,
        replicates=replicates,
        layout=layout,
        seed=seed,
        noise=noise,
        rate_hz=rate_hz,
        name=name,
        out=out,
    )
    return Data(question.answer(at_work()))


def import_recording(
    *files: PathLike,
    out: PathLike,
    layout: PathLike | None = None,
    dbc: PathLike | None = None,
    machine: str | None = None,
    lever_mm: float | None = None,
    accept_doubts: bool = False,
) -> Data:
    """Recordings of another laboratory as a new dataset folder `out`, which keeps the mapping.

    A mapping (YAML) among `files` says what is what; without one it is guessed. `layout` says what the shaft
    looks like, or `machine` which other machine it is (joint, cable, shaft, linear); `lever_mm` is the radius
    of what slides. `dbc` decodes logs of a CAN bus that is not this rig's. A guess with doubts is refused,
    doubt by doubt, unless `accept_doubts`. Raises BadInput.
    """
    target = Path(out)
    if os.path.lexists(target):
        raise BadInput(f"{target}: exists already; name another folder with out or remove it first")
    found = Understand(
        files=files, name=target.resolve().name, layout=layout, dbc=dbc, machine=machine, lever_mm=lever_mm
    ).answer(at_work())
    waiting = found.lacks() if accept_doubts else [*found.lacks(), *found.doubts()]
    if waiting:
        accept = "" if found.lacks() else ", or take the guess as it is with accept_doubts=True"
        raise BadInput(f"{'; '.join(waiting)}; say so in a mapping{accept}")
    with found.confirmed().written(target) as imported:
        return Data(imported.dataset)


def export(run: Run | PathLike, out: PathLike, form: Form = "csv") -> Path:
    """Write a run to `out`, which must be new: a folder of CSV or of a dataset, an MCAP or PNG file.

    Raises BadInput.
    """
    return (run if isinstance(run, Run) else read_run(run)).export(out, form)
