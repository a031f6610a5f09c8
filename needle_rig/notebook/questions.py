"""The questions: thin views of what the workbench answers, on all cores and with their progress shown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from needle_rig.control.strategy import make_strategy
from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.notebook.asking import (
    AnyData,
    AnyModel,
    PathLike,
    asked,
    at_work,
    library,
    observed,
    saved,
    traces,
)
from needle_rig.notebook.catalogue import hidden_effects
from needle_rig.notebook.fit import Fit, Identification
from needle_rig.notebook.learnt import Experiment, Laws, Strategies
from needle_rig.notebook.model import Model, Plan
from needle_rig.notebook.results import Comparison, Diagnosis
from needle_rig.workbench.contest.contest import FRICTION_SCATTER, SEEDS, TARGETS_DEG, Asked, contest
from needle_rig.workbench.contest.strategies_table import Bout, all_strategies
from needle_rig.workbench.learning.adopt import adopt as _adopt
from needle_rig.workbench.learning.adopt import adopt_diagnosis
from needle_rig.workbench.learning.compare import Held
from needle_rig.workbench.learning.experiment import propose_experiment
from needle_rig.workbench.learning.fit_effects import fit_effects
from needle_rig.workbench.learning.identify import identify as _identify
from needle_rig.workbench.learning.identify import update as _update
from needle_rig.workbench.learning.learn_law import laws_of
from needle_rig.workbench.learning.observations import Traces, observations
from needle_rig.workbench.virtual.noise import NO_NOISE, Noise


@asked
def compare(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    refit: bool = False,
    fixed: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    effects: Sequence[PathLike] = (),
) -> Comparison:
    """Hold `model` against `data` with its values as they stand, and beside them those of a refit.

    Without a model the null model is fitted. `refit` leaves the values as they stand out; `fixed` are values
    that replace the model's and that no fit moves; `free` are fitted also where the others stand; `effects`
    are further folders with effects. Raises BadInput, SolverError.
    """
    values = Held(refit, _numbers("fixed", fixed), tuple(free))
    question = observations(observed(data))
    return Comparison(question.compare(library(effects), saved(model, effects), values))


@asked
def fit(
    data: AnyData,
    effects: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    model: AnyModel | None = None,
    *,
    folders: Sequence[PathLike] = (),
) -> Fit:
    """Fit `model` (default: the null model) with the named `effects` to traces.

    `fixed` are values by name, in the units of files, that no fit moves. `folders` are further ones with
    effects. Raises BadInput, SolverError.
    """
    names = (effects,) if isinstance(effects, str) else tuple(effects)
    dataset = traces(data, "fit values one by one")
    values = _numbers("fixed", fixed)
    return Fit(fit_effects(dataset, library(folders), saved(model, folders), names, values))


@asked
def identify(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    update: bool = False,
    effects: Sequence[PathLike] = (),
) -> Identification:
    """Friction, its scatter, rigidity, damping and the values of `model`, or what would give them.

    With `update` what the model file knows counts, too. Raises Contradiction where the data are not what it
    predicts, BadInput, SolverError.
    """
    dataset, known, before = traces(data, "identify constants"), library(effects), saved(model, effects)
    if update:
        if before is None:
            raise BadInput("update needs a model whose values count; name one")
        return Identification(_update(dataset, known, before), before)
    return Identification(_identify(dataset, known, before.model if before else None), None)


@asked
def diagnose(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    max_effects: int = 3,
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = None,
) -> Diagnosis:
    """Which effect is missing from `model` (default: the null model). Raises BadInput, SolverError.

    `quick` looks for one effect alone, in half the time or less; its notes say what it left out. `jobs`
    processes try the effects, by default one a core. The answer does not depend on it.
    """
    question, known = observations(observed(data)), saved(model, effects)
    found = question.diagnose(
        library(effects),
        known.model if known else None,
        max_effects=max_effects,
        quick=quick,
        seed=seed,
        work=at_work(jobs),
    )
    return Diagnosis(found, question, known)


@asked
def adopt(diagnosis: Diagnosis, *effects: str, force: bool = False) -> Model:
    """The model that was diagnosed with all effects that the diagnosis names, as they were fitted.

    `effects` chooses among ties. Raises Refused when the error on commands left out does not fall, BadInput.
    """
    if not isinstance(diagnosis, Diagnosis):
        raise BadInput(f"diagnosis is of type {type(diagnosis).__name__}; give what diagnose answers")
    return Model(adopt_diagnosis(diagnosis.kept, effects=effects, force=force))


@asked
def add_effect(
    data: AnyData,
    effect: str,
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    force: bool = False,
) -> Model:
    """`model` (default: the null model) with the effect of this name, everything fitted again to `data`.

    Raises Refused when the error on commands left out does not fall, BadInput.
    """
    question = observations(observed(data))
    return Model(_adopt(question, effect, library(effects), saved(model, effects), force=force))


@asked
def learn(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    seed: int = 0,
    jobs: int | None = None,
) -> Laws:
    """A law that no effect holds: where it acts, its curve, a short formula. Raises BadInput, SolverError."""
    dataset, known = traces(data, "learn a curve"), saved(model, effects)
    return Laws(
        laws_of(
            Traces(dataset),
            library(effects),
            known.model if known else None,
            seed=seed,
            workers=lambda: at_work(jobs),
        )
    )


@asked
def experiment(
    data: AnyData,
    between: Sequence[str],
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    rig: PathLike | None = None,
) -> Experiment:
    """The trial that would best tell two effects apart, within the limits of a rig file.

    Raises BadInput, SolverError.
    """
    if isinstance(between, str) or len(between) != len(("one", "other")):
        raise BadInput(f"between is {between!r}; name two effects")
    known = saved(model, effects)
    return Experiment(
        propose_experiment(
            traces(data, "fit both effects"),
            (between[0], between[1]),
            library(effects),
            known.model if known else None,
            rig=None if rig is None else Path(rig),
        )
    )


@asked
def plan(model: AnyModel, target_deg: float, strategy: str = "planned") -> Plan:
    """A strategy's sequence to `target_deg`, carried out on `model` itself without noise. Raises BadInput."""
    known = saved(model)
    if known is None:
        raise BadInput("a plan needs a model; name one")
    bout = Bout(known.model, known.model.torsional_rigidity_nm2, NO_NOISE, known)
    return Plan(target_deg, strategy, bout.run(make_strategy(strategy, {}), target_deg, "relaxed", 0))


@asked
def strategies(
    *names: str,
    parameters: str = "rig_elastic",
    effects: Mapping[str, float | Mapping[str, float]] | None = None,
    model: AnyModel | None = None,
    targets_deg: Sequence[float] = TARGETS_DEG,
    seeds: int = SEEDS,
    friction_scatter: float = FRICTION_SCATTER,
    folders: Sequence[PathLike] = (),
    jobs: int | None = None,
) -> Strategies:
    """Every strategy, or those named, on a simulated rig with `effects`, from relaxed and from wound.

    planned works with `model`; without one it is identified from eight runs on that rig. `friction_scatter`
    is a fraction, from run to run. Raises BadInput, SolverError.
    """
    plant = load_parameters(parameters, effects=[Path(folder) for folder in folders])
    plant = plant.with_effects(*hidden_effects({} if effects is None else effects, folders))
    question = Asked(
        names or all_strategies(), tuple(targets_deg), seeds, Noise(friction_scatter=friction_scatter)
    )
    found = contest(plant, question, library(folders), saved(model, folders), workers=lambda: at_work(jobs))
    hidden = ", ".join(effect.name() for effect in plant.effects) or "rigid tissue"
    return Strategies(found, f"{parameters} ({hidden})")


def _numbers(name: str, given: Mapping[str, float] | None) -> Mapping[str, float]:
    """Values by name. Raises BadInput for anything else."""
    values = {} if given is None else given
    if not isinstance(values, Mapping):
        raise BadInput(f"{name} is of type {type(given).__name__}; give values by name, as a dict")
    for key, value in values.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise BadInput(f"{name}: {key} is {value!r}, not a number")
    return values
