"""The workbench for notebooks and scripts: `import needle_rig as nr`, and results that show themselves.

Results have `table()`, a NumPy structured array that `pandas.DataFrame` takes as it is, `plot()`, a
Matplotlib figure, and a picture of themselves in Jupyter. Angles are in degrees and torques in N·mm here, as
in files and commands. Errors are the commands' own: `needle_rig.errors.BadInput` says place, value and next
step.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from needle_rig.control.strategy import make_strategy
from needle_rig.dataset import Dataset, write_dataset
from needle_rig.dataset.settled import SettledData
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel, effect_directories, load_parameters, load_saved, save_model
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.recording import RunFile
from needle_rig.simulation.protocol import Protocol, load_protocol
from needle_rig.units import deg, nmm
from needle_rig.workbench.contest.strategies_table import Bout
from needle_rig.workbench.learning.adopt import adopt as _adopt
from needle_rig.workbench.learning.adopt import adopt_diagnosis
from needle_rig.workbench.learning.compare import Held, compared
from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis, keep, save_diagnosis
from needle_rig.workbench.learning.history import ladder
from needle_rig.workbench.learning.observations import Comparison as _Compared
from needle_rig.workbench.learning.observations import Observations, observations
from needle_rig.workbench.observations.runs import runs_as_dataset
from needle_rig.workbench.observations.sources import read_observed
from needle_rig.workbench.parallel import workers
from needle_rig.workbench.selection.answer import Answer
from needle_rig.workbench.selection.diagnose import Diagnosis as FromTraces
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import NO_NOISE, Noise
from needle_rig.workbench.virtual.settled_run import SettledRun

if TYPE_CHECKING:
    from needle_rig.figures.page import Figure

Table = npt.NDArray[Any]
PathLike = str | os.PathLike[str]


class Shown:
    """A result with a headline, a table and a picture."""

    def headline(self) -> str:
        """What it says, in one sentence."""
        raise NotImplementedError

    def table(self) -> Table:
        """Its numbers, one row each."""
        raise NotImplementedError

    def plot(self) -> Figure:
        """Its picture."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return self.headline()

    def _repr_html_(self) -> str:
        from needle_rig.figures import page

        rows = self.table()
        head = rows.dtype.names or ()
        body = [page.row(str(each[0]), [_cell(value) for value in list(each)[1:]]) for each in rows.tolist()]
        return page.paragraph(self.headline()) + page.table(head, body)

    def _repr_png_(self) -> bytes:
        from needle_rig.figures.page import png

        return png(self.plot())


@dataclass(frozen=True, repr=False)
class Comparison(Shown):
    """Where a model fails on measurements."""

    found: _Compared

    @property
    def held_out_error(self) -> float:
        """Error on commands left out, in units of the noise; NaN where there is one command only."""
        return self.found.held_out_error

    @property
    def worst(self) -> tuple[str, ...]:
        """The places above three times their noise, the worst first, in words."""
        return tuple(f"{_or_nan(p['sigmas']):.0f}σ  {p['words']}" for p in self.found.as_json()["worst"])

    def headline(self) -> str:
        """Dataset, model, the error with its values as they stand and on commands left out."""
        return " ".join(self.found.headline())

    def table(self) -> Table:
        """A row a channel: error, noise, and error in units of the noise; NaN where no noise is stated."""
        return _table(
            {
                "channel": name,
                "rmse": float(v["rmse"]),
                "noise": _or_nan(v["noise"]),
                "unit": v["unit"],
                "in_noise_units": _or_nan(v["in_noise_units"]),
            }
            for name, v in self.found.channels.items()
        )

    def parameters(self) -> Table:
        """A row a value: of the model, of the refit, each with its σ, and their distance in σ of both.

        NaN where there is none: the null model has no values, a fixed one no σ.
        """
        return _table(
            {
                "parameter": p["name"],
                "model": _or_nan(p["model"]),
                "model_sigma": _or_nan(p["model_uncertainty"]),
                "refit": _or_nan(p["refit"]),
                "refit_sigma": _or_nan(p["refit_uncertainty"]),
                "sigmas": _or_nan(p["sigmas"]),
                "unit": p["unit"],
            }
            for p in self.found.as_json()["parameters"]
        )

    def places(self) -> Table:
        """A row for every channel, motion, state and direction."""
        return _table(
            {
                "channel": p["channel"],
                "motion": p["motion"],
                "state": p["state"],
                "direction": p["direction"],
                "unit": p["unit"],
                "model": p["model"],
                "measured": p["measured"],
                "error": p["error"],
                "noise": _or_nan(p["noise"]),
                "sigmas": _or_nan(p["sigmas"]),
            }
            for p in self.found.places()
        )

    def plot(self, what: str = "residuals") -> Figure:
        """`residuals`: error over noise by channel, phase and direction; or another figure by its name.

        There are `traces`, `pulls`, `loop`, `strips`, `over_time`, `over_model`, `qq`, `autocorrelation`,
        `correlation`, `profile` and `band`. Raises BadInput, also for settled values, which have no traces.
        """
        from needle_rig.figures.residuals import drawn

        return drawn(self.found.traces(), what)


@dataclass(frozen=True, repr=False)
class Diagnosis(Shown):
    """Which effect is missing."""

    found: Answer
    observed: Observations
    started: SavedModel | None
    """The model that was diagnosed; None for the null model."""

    @property
    def verdict(self) -> str:
        """`effect`, `none` or `unknown`."""
        return self.found.verdict

    @property
    def effects(self) -> tuple[str, ...]:
        """What is missing, when the verdict is `effect`."""
        return self.found.effects

    @property
    def notes(self) -> tuple[str, ...]:
        """What else is to be known: of the data, of what was taken for noise, of what was not asked."""
        return self.found.notes

    def _repr_html_(self) -> str:
        from needle_rig.figures import page

        return super()._repr_html_() + "".join(map(page.paragraph, self.notes))

    def headline(self) -> str:
        """The verdict with the error left out, before and after."""
        found = self.found
        return (
            f"{found.dataset} against the model {found.model}: {found.sentence()} {found.errors_sentence()}"
        )

    @property
    def model_values(self) -> tuple[str, ...]:
        """Whether the values of the model hold as they stand, in words; empty for the null model."""
        if self.started is None or not isinstance(self.found, FromTraces):
            return ()
        held = compared(self.found.baseline, self.started)
        return tuple(held.verdict_on_values(structure_holds=self.verdict == "none"))

    def table(self) -> Table:
        """The ranking: a row a candidate."""
        return _table(
            {
                "effect": row.effect,
                "held_out_error": _or_nan(row.held_out_error),
                "error_removed": row.error_removed,
                "for": row.in_favour,
                "against": row.against,
            }
            for row in self.found.ranking
        )

    def values(self) -> Table:
        """The fitted parameters of what is named, with 95 % intervals."""
        return _table(
            {"effect": row.effect, "parameter": v.name, "value": v.value, "low": v.low, "high": v.high,
             "unit": v.unit}
            for row in self.found.ranking[: len(self.found.effects)]
            for v in row.values
        )  # fmt: skip

    def plot(self) -> Figure:
        """Error on commands left out by candidate, beside the current model and the noise."""
        from needle_rig.figures.diagnosis import ranking_figure

        return ranking_figure(self.found)

    @cached_property
    def kept(self) -> KeptDiagnosis:
        """The diagnosis with its fits, as it is written."""
        return keep(self.found, self.observed, self.started)

    def save(self, path: PathLike) -> None:
        """Write the diagnosis file that `needle-rig adopt` takes."""
        save_diagnosis(path, self.kept)


@dataclass(frozen=True, repr=False)
class Model(Shown):
    """A model with its uncertainties and the steps in which it was learnt."""

    saved: SavedModel

    @property
    def values(self) -> Mapping[str, Any]:
        """Every parameter by name, in the units of files."""
        return self.saved.model.values()

    def headline(self) -> str:
        """The model's name and effects."""
        effects = ", ".join(e.name() for e in self.saved.model.effects) or "no effect"
        steps = f"{len(self.saved.history)} steps from {self.saved.starts_from}"
        return f"{self.saved.model.name}: {effects}, {steps}"

    def table(self) -> Table:
        """The ladder: a row a step, errors in units of the noise."""
        return _table(
            {
                "step": step.label,
                "date": step.date,
                "dataset": step.dataset,
                "training": np.nan if step.training is None else step.training,
                "held_out": np.nan if step.held_out is None else step.held_out,
                "noise_floor": np.nan if step.floor is None else step.floor,
            }
            for step in ladder(self.saved)
        )

    def plot(self) -> Figure:
        """How the error fell, over all and for each channel."""
        from needle_rig.figures.ladder import ladder_figure

        return ladder_figure(self.saved)

    def save(self, path: PathLike) -> None:
        """Write the model file that commands take as --model."""
        save_model(path, self.saved)


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """A sequence of motions carried out on the model, and where it leaves the needle."""

    target_deg: float
    strategy: str
    run: SettledRun

    def headline(self) -> str:
        """What it leaves, and what it costs."""
        left_deg = deg(abs(self.run.history[-1].base_angle_rad - self.run.tip_rad))
        return (
            f"{self.strategy} to {self.target_deg:g}°: the tip lags {left_deg:.1f}°,"
            f" {nmm(abs(self.run.torque_nm)):.3f} N·mm are left, after {self.run.rotations} rotations and"
            f" {self.run.time_s:.0f} s"
        )

    def table(self) -> Table:
        """A row a motion, after it has settled."""
        return _table(
            {
                "motion": m.name,
                "waypoint_deg": deg(m.waypoint_rad),
                "base_deg": deg(m.base_angle_rad),
                "torque_nmm": nmm(m.torque_nm),
                "tip_lag_deg": deg(m.tip_lag_rad),
                "time_s": m.time_s,
            }
            for m in self.run.history[1:]
        )

    def plot(self) -> Figure:
        """The base on its way, and the shaft at the end."""
        from needle_rig.figures.plan import plan_figure

        return plan_figure(self.run, self.target_deg, self.strategy)


@dataclass(frozen=True, repr=False)
class Run(Shown):
    """A recorded run."""

    file: RunFile

    def headline(self) -> str:
        """Its name and how it ended."""
        result = self.file.result
        return f"{self.file.name}: {'cut off' if result is None else result['status']}"

    def table(self, name: str = "ticks") -> Table:
        """All rows of a table of the run (`ticks`, `torque`, `hall`, `drive`), in SI units."""
        return self.file.table(name)

    def dataset(self) -> Dataset:
        """The run as a dataset of one trial."""
        return runs_as_dataset([self.file])

    def plot(self) -> Figure:
        """Angles and torque over time, and the shaft after each motion."""
        from needle_rig.figures.run import run_figure

        return run_figure(self.file)

    def _repr_html_(self) -> str:
        from needle_rig.figures.page import paragraph

        return paragraph(self.headline())


def read_dataset(*paths: PathLike) -> Dataset | SettledData:
    """The trials of dataset folders and run files, or settled values, by path or by name. Raises BadInput."""
    return read_observed(paths)


def read_run(path: PathLike) -> Run:
    """A run file. Raises BadInput."""
    return Run(RunFile(path))


def read_model(path: PathLike, *, effects: Iterable[PathLike] = ()) -> Model:
    """A model file or a parameter set; `effects` are further folders with effects. Raises BadInput."""
    return Model(load_saved(path, effects=[Path(e) for e in effects]))


def simulate(
    effects: Mapping[str, float | Mapping[str, float]] | None = None,
    *,
    parameters: str = "rig_rigid",
    protocol: str | Protocol = "standard",
    seed: int = 1,
    noise: Noise | None = None,
    rate_hz: float = 50.0,
    name: str = "simulated",
    out: PathLike | None = None,
) -> Dataset:
    """Simulated trials with effects hidden in them, `{"tissue_elasticity": 0.35}` in the units of files.

    An effect of several parameters takes them by name. With `out` the dataset is written there too. Raises
    BadInput.
    """
    library, hidden = find_effects(), []
    for effect, value in (effects or {}).items():
        if effect not in library:
            raise BadInput(f"{effect}: no such effect; there are {', '.join(sorted(library))}")
        fields = value if isinstance(value, Mapping) else {next(iter(library[effect].parameters())): value}
        hidden.append(library[effect](**fields))
    model = load_parameters(parameters)
    model = model.with_effects(*hidden) if hidden else model
    plan_ = load_protocol(protocol) if isinstance(protocol, str) else protocol
    dataset = simulate_dataset(model, plan_, seed, noise or Noise(), name=name, rate_hz=rate_hz)
    if out is not None:
        write_dataset(dataset, Path(out))
    return dataset


def compare(
    data: Dataset | SettledData,
    model: Model | str | None = None,
    *,
    refit: bool = False,
    fixed: Mapping[str, float] | None = None,
    free: Sequence[str] = (),
    effects: Sequence[PathLike] = (),
) -> Comparison:
    """Hold `model` against `data` with its values as they stand, and beside them those of a refit.

    Without a model the null model is fitted. A model may be a parameter set's name. `refit` leaves the values
    as they stand out; `fixed` are values that replace the model's and that no fit moves; `free` are fitted
    also where the others stand. Raises BadInput, SolverError.
    """
    if isinstance(model, str):
        model = read_model(model, effects=effects)
    values = Held(refit, fixed or {}, tuple(free))
    return Comparison(observations(data).compare(_library(effects), model.saved if model else None, values))


def diagnose(
    data: Dataset | SettledData,
    model: Model | None = None,
    *,
    effects: Sequence[PathLike] = (),
    max_effects: int = 3,
    quick: bool = False,
    seed: int = 0,
    jobs: int | None = 1,
) -> Diagnosis:
    """Which effect is missing from `model` (default: the null model). Raises BadInput, SolverError.

    `quick` looks for one effect alone, in half the time or less; its notes say what it left out. `jobs`
    processes try the effects; None takes one a core. The answer does not depend on it.
    """
    observed, saved = observations(data), model.saved if model else None
    found = observed.diagnose(
        _library(effects),
        saved.model if saved else None,
        max_effects=max_effects,
        quick=quick,
        seed=seed,
        work=workers(jobs, None),
    )
    return Diagnosis(found, observed, saved)


def adopt(diagnosis: Diagnosis, *effects: str, force: bool = False) -> Model:
    """The model that was diagnosed with all effects that the diagnosis names, as they were fitted.

    `effects` chooses among ties. Raises Refused when the error on commands left out does not fall, BadInput.
    """
    return Model(adopt_diagnosis(diagnosis.kept, effects=effects, force=force))


def add_effect(
    data: Dataset | SettledData,
    effect: str,
    model: Model | None = None,
    *,
    effects: Sequence[PathLike] = (),
    force: bool = False,
) -> Model:
    """`model` (default: the null model) with the effect of this name, everything fitted again to `data`.

    Raises Refused when the error on commands left out does not fall, BadInput.
    """
    saved = model.saved if model else None
    return Model(_adopt(observations(data), effect, _library(effects), saved, force=force))


def plan(model: Model, target_deg: float, strategy: str = "planned") -> Plan:
    """A strategy's sequence to `target_deg`, carried out on `model` itself without noise. Raises BadInput."""
    needle = model.saved.model
    bout = Bout(needle, needle.torsional_rigidity_nm2, NO_NOISE, model.saved)
    return Plan(target_deg, strategy, bout.run(make_strategy(strategy, {}), target_deg, "relaxed", 0))


def _library(directories: Sequence[PathLike]) -> Mapping[str, type[Effect]]:
    return find_effects(effect_directories(tuple(str(d) for d in directories)))


def _table(rows: Iterable[Mapping[str, Any]]) -> Table:
    """Rows as a structured array: text as it is long, everything else as float."""
    listed = [dict(row) for row in rows]
    if not listed:
        return np.empty(0)
    columns = {
        name: np.array([row[name] for row in listed], dtype=str if isinstance(value, str) else float)
        for name, value in listed[0].items()
    }
    table = np.empty(len(listed), dtype=[(name, column.dtype) for name, column in columns.items()])
    for name, column in columns.items():
        table[name] = column
    return table


def _or_nan(value: float | str | None) -> float:
    return np.nan if value is None else float(value)


def _cell(value: Any) -> str | float:
    return value if isinstance(value, str) else float(value)
