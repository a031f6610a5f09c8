"""Strategies on one simulated rig: the model that planned learns first, what is predicted, what came."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from needle_rig.dataset import Dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.model import SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.records import JsonObject
from needle_rig.workbench.contest.strategies_table import (
    Bout,
    Predicted,
    Table,
    check_asked,
    compare_strategies,
    predicted,
)
from needle_rig.workbench.learning.learn import fit_known, learn
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import Noise

Say = Callable[[str], None]


@dataclass(frozen=True)
class Asked:
    """What is run: which strategies to which targets, and how often each from either start."""

    strategies: tuple[str, ...]
    targets_deg: tuple[float, ...]
    seeds: int
    noise: Noise


@dataclass(frozen=True)
class Contest:
    """The strategies on one rig: the model that planned had, what was said beforehand, and what came."""

    saved: SavedModel | None
    predicted: Predicted | None
    table: Table

    def as_json(self) -> JsonObject:
        """The stated form of the answer."""
        told = self.predicted.sentence if self.predicted else ""
        document: JsonObject = {"rows": self.table.rows(), "overall": self.table.overall(), "predicted": told}
        if self.saved is not None:
            document["model"] = {
                name: {"value": value, "uncertainty": self.saved.uncertainties.get(name)}
                for name, value in self.saved.model.values().items()
                if abs(value) != float("inf")
            }
            document["model_error_over_floor"] = self.saved.error_over_floor
        return document


def contest(
    plant: NeedleModel,
    asked: Asked,
    library: Mapping[str, type[Effect]],
    saved: SavedModel | None = None,
    *,
    diagnose: bool = False,
    work: Work,
    say: Say = lambda _: None,
    tell: Say = lambda _: None,
) -> Contest:
    """Run the strategies on `plant`; planned works with `saved`, or a model identified from runs on it.

    With `diagnose` that model's effects are found, otherwise they are those of the plant. `tell` hears what
    is predicted before the plant is touched. Raises BadInput, SolverError.
    """
    check_asked(asked.strategies, asked.targets_deg)
    if saved is None and "planned" in asked.strategies:
        say("making eight runs with reed2008 and fitting a model to them")
        dataset = simulate_dataset(plant, load_protocol("standard"), seed=1, noise=asked.noise)
        if diagnose:
            saved = learn(dataset, library, work=work, say=say).after
        else:
            work.share(library)
            present = [e.name() for e in plant.effects if not e.is_off()]
            saved = work.run(_identified, [(dataset, present)])[0]
    bout = Bout(plant, plant.torsional_rigidity_nm2, asked.noise, saved)
    told = None
    if saved is not None:
        told = predicted(bout, asked.targets_deg, work=work)
        tell(told.sentence)
    say(f"running {len(asked.strategies)} strategies to {len(asked.targets_deg)} targets")
    table = compare_strategies(bout, asked.strategies, asked.targets_deg, asked.seeds, work=work)
    return Contest(saved, told, table)


def _identified(library: Mapping[str, type[Effect]], dataset: Dataset, present: Sequence[str]) -> SavedModel:
    return fit_known(dataset, library, present)
