"""The questions as functions, which complete and are typed; what is asked is `needle_rig.questions`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from needle_rig.control.strategy import make_strategy
from needle_rig.errors import BadInput
from needle_rig.notebook.asking import AnyData, AnyModel, PathLike, at_work, given, known, several
from needle_rig.notebook.catalogue import hidden_effects
from needle_rig.notebook.fit import Fit, Identification
from needle_rig.notebook.learnt import Experiment, Laws, Strategies
from needle_rig.notebook.model import Model, Plan
from needle_rig.notebook.results import Comparison, Diagnosis
from needle_rig.questions.adopt import AddEffect, Adopt
from needle_rig.questions.compare import Compare
from needle_rig.questions.diagnose import Diagnose
from needle_rig.questions.experiment import Experiment as ExperimentQuestion
from needle_rig.questions.fit import Fit as FitQuestion
from needle_rig.questions.identify import Identify
from needle_rig.questions.learn import Learn
from needle_rig.questions.question import Question
from needle_rig.questions.strategies import Strategies as StrategiesQuestion
from needle_rig.workbench.contest.strategies_table import Bout
from needle_rig.workbench.virtual.noise import NO_NOISE


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
    question = Compare(
        data=given(data),
        model=known(model),
        effects=several(effects),
        refit=refit,
        fixed=fixed or {},
        free=several(free),
    )
    return Comparison(question.answer(at_work()))


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
    question = FitQuestion(
        data=given(data),
        model=known(model),
        effects=several(folders),
        added=several(effects),
        fixed=fixed or {},
    )
    return Fit(question.answer(at_work()))


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
    question = Identify(data=given(data), model=known(model), effects=several(effects), update=update)
    return Identification(question.answer(at_work()))


def diagnose(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    max_effects: int = 3,
    quick: bool = False,
    jobs: int | None = None,
) -> Diagnosis:
    """Which effect is missing from `model` (default: the null model). Raises BadInput, SolverError.

    `quick` looks for one effect alone, in half the time or less; its notes say what it left out. `jobs`
    processes try the effects, by default one a core. The answer does not depend on it.
    """
    question = Diagnose(
        data=given(data),
        model=known(model),
        effects=several(effects),
        max_effects=max_effects,
        quick=quick,
    )
    return Diagnosis(question.answer(at_work(jobs)))


def adopt(diagnosis: Diagnosis, *effects: str, force: bool = False) -> Model:
    """The model that was diagnosed with all effects that the diagnosis names, as they were fitted.

    `effects` chooses among ties. Raises Refused when the error on commands left out does not fall, BadInput.
    """
    if not isinstance(diagnosis, Diagnosis):
        raise BadInput(f"diagnosis is of type {type(diagnosis).__name__}; give what diagnose answers")
    question = Adopt(diagnosis=diagnosis.answer.keep(), chosen=effects, force=force)
    return Model(question.answer(at_work()))


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
    question = AddEffect(
        data=given(data), model=known(model), effects=several(effects), effect=effect, force=force
    )
    return Model(question.answer(at_work()))


def learn(
    data: AnyData,
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    jobs: int | None = None,
) -> Laws:
    """A law that no effect holds: where it acts, its curve, a short formula. Raises BadInput, SolverError."""
    question = Learn(data=given(data), model=known(model), effects=several(effects))
    return Laws(question.answer(at_work(jobs)).found)


def experiment(
    data: AnyData,
    between: tuple[str, str],
    model: AnyModel | None = None,
    *,
    effects: Sequence[PathLike] = (),
    rig: PathLike | None = None,
    jobs: int | None = None,
) -> Experiment:
    """The trial that would best tell two effects apart, within the limits of a rig file.

    Raises BadInput, SolverError.
    """
    question = ExperimentQuestion(
        data=given(data), model=known(model), effects=several(effects), between=between, rig=rig
    )
    return Experiment(question.answer(at_work(jobs)))


def plan(model: AnyModel, target_deg: float, strategy: str = "planned") -> Plan:
    """A strategy's sequence to `target_deg`, carried out on `model` itself without noise. Raises BadInput."""
    saved = Question().read_model(known(model))
    if saved is None:
        raise BadInput("a plan needs a model; name one")
    bout = Bout(saved.model, saved.model.torsional_rigidity_nm2, NO_NOISE, saved)
    return Plan(target_deg, strategy, bout.run(make_strategy(strategy, {}), target_deg, "relaxed", 0))


def strategies(
    *names: str,
    parameters: str = "rig_elastic",
    effects: Mapping[str, float | Mapping[str, float]] | None = None,
    model: AnyModel | None = None,
    diagnose: bool = False,
    targets_deg: Sequence[float] = (15.0, -15.0, 45.0, -45.0, 90.0, -90.0, 180.0, -180.0),
    seeds: int = 3,
    friction_scatter: float = 0.05,
    folders: Sequence[PathLike] = (),
    jobs: int | None = None,
) -> Strategies:
    """Every strategy, or those named, on a simulated rig with `effects`, from relaxed and from wound.

    planned works with `model`; without one it is identified from eight runs on that rig, its effects found
    with `diagnose`, else taken as known. `friction_scatter` is a fraction, from run to run. Raises BadInput,
    SolverError.
    """
    question = StrategiesQuestion(
        names=names,
        parameters=parameters,
        hidden=hidden_effects({} if effects is None else effects, folders),
        effects=several(folders),
        model=known(model),
        diagnose=diagnose,
        targets_deg=targets_deg,
        seeds=seeds,
        friction_scatter=friction_scatter,
    )
    found = question.answer(at_work(jobs))
    hidden = ", ".join(effect.name() for effect in question.plant().effects) or "rigid tissue"
    return Strategies(found, f"{parameters} ({hidden})")
