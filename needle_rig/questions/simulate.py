"""A series of trials as a simulated rig measures them."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from needle_rig.errors import BadInput
from needle_rig.questions.doing import SILENT, Doing
from needle_rig.questions.fields import Within
from needle_rig.questions.question import AnyProtocol, OnSimulatedRig, PathLike
from needle_rig.workbench.virtual.noise import Noise

if TYPE_CHECKING:
    from needle_rig.dataset import Dataset
    from needle_rig.physics.needle_model import NeedleModel
    from needle_rig.physics.rod import Layout


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulate(OnSimulatedRig):
    """Run a protocol on a simulated rig, with noise, and friction that differs from trial to trial."""

    protocol: AnyProtocol = "standard"
    """Name, YAML file, or one that was read."""
    replicates: Annotated[int, Within(1, 100)] = 1
    """Run the protocol so many times."""
    layout: PathLike | None = None
    """experiment, model, a rig file or a dataset folder; None: that of the parameters."""
    seed: Annotated[int, Within(0)] = 1
    """Of noise and scatter."""
    noise: Noise | None = None
    """None: that of the practice datasets."""
    rate_hz: float = 50.0
    """Samples a second."""
    name: str = "simulated"
    out: PathLike | None = None
    """Folder to write the dataset to, which must hold none yet; None: nothing is written."""

    def plant(self, doing: Doing = SILENT) -> NeedleModel:
        """The rig with its hidden effects, in the layout that is asked. Raises BadInput."""
        rig = OnSimulatedRig.plant(self, doing)
        return rig if self.layout is None else replace(rig, layout=layout_named(os.fspath(self.layout)))

    def answer(self, doing: Doing = SILENT) -> Dataset:
        """The simulated dataset; written to `out` where that is given. Raises BadInput, SolverError."""
        from needle_rig.dataset.protocol import Protocol, load_protocol
        from needle_rig.dataset.writer import vacant, write_dataset
        from needle_rig.workbench.virtual.dataset import simulate_dataset

        if self.out is not None:
            vacant(self.out)
        plant, plan = self.plant(doing), self.protocol
        if isinstance(plan, str | os.PathLike):
            plan = load_protocol(plan)
        if not isinstance(plan, Protocol):
            raise BadInput(f"protocol is of type {type(plan).__name__}; name one, or a YAML file")
        doing.say("simulating a series")
        dataset = simulate_dataset(
            plant,
            plan.repeated(self.replicates),
            self.seed,
            self.noise,
            name=self.name,
            rate_hz=self.rate_hz,
            progress=doing.progress,
        )
        if self.out is not None:
            write_dataset(dataset, self.out)
        return dataset


def layout_named(name: str) -> Layout:
    """The layout that `name` stands for: `experiment`, `model`, a rig file or a dataset folder.

    Raises BadInput with file and line.
    """
    from needle_rig.config.loader import load_rig_config
    from needle_rig.control.in_si import layout_of as layout_of_rig
    from needle_rig.dataset.description import layout_of, read_description
    from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT

    if name in (known := {"experiment": EXPERIMENT_LAYOUT, "model": MODEL_LAYOUT}):
        return known[name]
    if os.path.isdir(name):
        description, places = read_description(Path(name))
        return layout_of(description.rig, places)
    if not os.path.lexists(name):
        raise BadInput(f"layout {name}: is neither experiment nor model, nor a rig file or dataset folder")
    return layout_of_rig(load_rig_config(Path(name)))
