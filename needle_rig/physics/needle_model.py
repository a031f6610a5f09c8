"""A needle model: the rod with its effects, from the base encoder's path to what the sensors read.

Hooks run in this order: drive (encoder → held end), shape (coefficients), the solver, observe (truth →
reading); effects with the same hook by `stage`, then name, so the order in which they were listed
does not matter. Effects at their off value are left out: the model is then bit for bit the one without them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.numerics import Array
from needle_rig.physics.compiled import torque_law
from needle_rig.physics.effect import Effect, ParameterInfo, Reading, Trial
from needle_rig.physics.rod import Layout, Rod, build_rod
from needle_rig.physics.solution import RodState, Sampled, Solution
from needle_rig.physics.solver import DEFAULT_TOLERANCE_RAD, solve, solve_batch
from needle_rig.units import per_100mm, per_length_n

NMM2_PER_NM2 = 1e6
FRICTION = "friction_nmm_per_100mm"
TORSIONAL_RIGIDITY = "torsional_rigidity_nmm2"
BASE_PARAMETERS: dict[str, ParameterInfo] = {
    FRICTION: ParameterInfo(
        off=0.0,
        lower=0.0,
        upper=5.0,
        typical=0.1,
        smallest=0.002,
        literature=(0.02, 0.6),
        unit="N·mm per 100 mm",
    ),
    TORSIONAL_RIGIDITY: ParameterInfo(
        off=62.56,
        lower=1.0,
        upper=1e4,
        typical=62.56,
        smallest=1.2,
        literature=(50.0, 160.0),
        unit="N·mm²",
        scale="log",
        prior=0.02,
    ),
}
"""What the rod without effects is made of, besides its layout."""

_NO_PATH = np.empty(0)


@dataclass(frozen=True, eq=False)
class NeedleState(RodState):
    """A rod's state and where each drive effect left the held end, to go on from."""

    held_rad: tuple[float, ...] = ()


@dataclass(frozen=True)
class NeedleModel:
    """What a needle in tissue does and what the sensors read. Raises BadInput on values out of bounds."""

    name: str
    layout: Layout
    torsional_rigidity_nm2: float
    friction_n: float
    effects: tuple[Effect, ...] = ()
    element_length_m: float = 0.5e-3
    tolerance_rad: float = DEFAULT_TOLERANCE_RAD
    torque_scale: float = 1.0
    """Size of its torques over the needle's (`physics.torque_scale`): bounds and typical sizes go with it."""

    def __post_init__(self) -> None:
        for name, value in self._base_values().items():
            BASE_PARAMETERS[name].scaled(self.torque_scale).check(value, f"{self.name}.{name}")
        for effect in self.effects:
            effect.check_for(self.torque_scale)
        names = [effect.name() for effect in self.effects]
        if twice := {name for name in names if names.count(name) > 1}:
            raise BadInput(f"{self.name}: effect {min(twice)} is listed twice; give it once")
        ordered = sorted(self.effects, key=lambda effect: (effect.stage, effect.name()))
        object.__setattr__(self, "effects", tuple(ordered))

    def with_effects(self, *effects: Effect) -> NeedleModel:
        """This model with `effects` added, each in place of one of the same name."""
        added = {effect.name() for effect in effects}
        return replace(self, effects=(*(e for e in self.effects if e.name() not in added), *effects))

    def without(self, *names: str) -> NeedleModel:
        """This model without the named effects."""
        return replace(self, effects=tuple(e for e in self.effects if e.name() not in names))

    def finer(self, factor: float = 16.0) -> NeedleModel:
        """This model solved `factor` times finer in space and time: the difference is the solver's error."""
        return replace(
            self,
            element_length_m=self.element_length_m / factor,
            tolerance_rad=self.tolerance_rad / factor,
        )

    def acting(self, hook: str) -> tuple[Effect, ...]:
        """The effects that are not off and have `hook`, in the order in which they act."""
        return tuple(e for e in self.effects if e.has(hook) and not e.is_off())

    def rod(self, trial: Trial) -> Rod:
        """The rod with the effects' shapes and torques in it, for the place of `trial` in its series."""
        return self.rods([trial])[0]

    def rods(self, trials: Sequence[Trial]) -> list[Rod]:
        """The rod of each trial: one object for all where no effect asks for the place in the series."""
        found: list[Rod] = []
        for trial in trials:
            rod, asked = _rod(self, trial.start_s, trial.index, trial.travel_before_rad)
            if not asked:
                return [rod] * len(trials)
            found.append(rod)
        return found

    def held_path(self, trial: Trial, held_rad: Sequence[float] = ()) -> tuple[Array, tuple[float, ...]]:
        """Path of the needle's held end, shape (samples,), and where each drive effect leaves it."""
        effects = self.acting("drive")
        path = np.ascontiguousarray(trial.base_angle_rad, dtype=np.float64)
        left = []
        for i, effect in enumerate(effects):
            start = held_rad[i] if held_rad else None
            path = effect.drive(replace(trial, base_angle_rad=path, held_rad=start))
            left.append(float(path[-1]) if path.size else start or 0.0)
        return path, tuple(left)

    def truth(
        self,
        trial: Trial,
        state: RodState | None = None,
        *,
        shaft: bool = False,
        most_solves: float = math.inf,
    ) -> Solution:
        """What the needle does, before the sensors' imperfections.

        A trial that continues an earlier piece takes that piece's `state`; its first sample is where that
        piece ended. `shaft` also gives the angle of every node. Raises SolverError, also past `most_solves`.
        """
        held = state.held_rad if isinstance(state, NeedleState) else ()
        path, left = self.held_path(trial, held)
        solution = solve(
            self.rod(trial),
            trial.time_s,
            path,
            trial.tip_torque_nm,
            state=state,
            shaft=shaft,
            tolerance_rad=self.tolerance_rad,
            most_solves=most_solves,
        )
        return _with_held(solution, left)

    def observed(self, trial: Trial, solution: Solution | Sampled) -> Reading:
        """What the sensors read of `solution`."""
        return shown(self.acting("observe"), Reading(trial, solution.torque_nm, solution.sensor_rad))[0]

    def predict(self, trial: Trial) -> Reading:
        """What the sensors read in a trial that starts relaxed. Raises SolverError, BadInput."""
        return self.observed(trial, self.truth(trial))

    def _base_values(self) -> dict[str, float]:
        return {
            FRICTION: per_100mm(self.friction_n),
            TORSIONAL_RIGIDITY: self.torsional_rigidity_nm2 * NMM2_PER_NM2,
        }

    def values(self) -> dict[str, float]:
        """Every parameter by name, in units of files: base parameters, `effect.field`, `effect.field[i]`."""
        values = self._base_values()
        for effect in self.effects:
            for field, info in effect.parameters().items():
                place = f"{effect.name()}.{field}"
                if info.per == "one":
                    values[place] = getattr(effect, field)
                else:
                    each = effect.each(field, self.count(info))
                    values |= {f"{place}[{i}]": float(value) for i, value in enumerate(each)}
        return values

    def count(self, info: ParameterInfo) -> int:
        """How many values a parameter has in this layout."""
        return {
            "one": 1,
            "sensor": len(self.layout.sensor_positions_m),
            "section": len(self.layout.tissue_sections_m),
        }[info.per]

    def info(self, name: str) -> ParameterInfo:
        """What is known of the parameter called `name` in `values`. Raises BadInput for another name."""
        if name in BASE_PARAMETERS:
            return BASE_PARAMETERS[name].scaled(self.torque_scale)
        owner, _, field = name.partition(".")
        for effect in self.effects:
            infos = effect.parameters()
            if effect.name() == owner and (bare := field.partition("[")[0]) in infos:
                return infos[bare].scaled(self.torque_scale)
        raise BadInput(f"{self.name}: no parameter {name}; it has {', '.join(self.values())}")

    def replaced(self, values: Mapping[str, float]) -> NeedleModel:
        """This model with parameters replaced by name (names as in `values`). Raises BadInput."""
        for name in values:
            self.info(name)
        all_values = self.values() | dict(values)
        effects = []
        for effect in self.effects:
            fields: dict[str, float | tuple[float, ...]] = {}
            for field, info in effect.parameters().items():
                place = f"{effect.name()}.{field}"
                if info.per == "one":
                    fields[field] = all_values[place]
                else:
                    fields[field] = tuple(all_values[f"{place}[{i}]"] for i in range(self.count(info)))
            effects.append(dataclasses.replace(effect, **fields))  # type: ignore[type-var]
        return replace(
            self,
            friction_n=per_length_n(all_values[FRICTION]),
            torsional_rigidity_nm2=all_values[TORSIONAL_RIGIDITY] / NMM2_PER_NM2,
            effects=tuple(effects),
        )


def shown(
    effects: Sequence[Effect], truth: Reading, states: Sequence[float | None] = ()
) -> tuple[Reading, tuple[float | None, ...]]:
    """What the sensors read of `truth` through `effects`, and the state of each at the last sample.

    A reading that continues an earlier piece takes the `states` at its first sample.
    """
    reading, ends = truth, []
    for place, effect in enumerate(effects):
        reading = effect.observe(replace(reading, state=states[place] if states else None))
        ends.append(reading.state)
    return replace(reading, state=None), tuple(ends)


def predict_batch(
    models: Sequence[NeedleModel], trials: Sequence[Trial], threads: int | None = None
) -> list[Reading]:
    """`models[i].predict(trials[i])` for all i, side by side, with the finest of their tolerances.

    Raises BadInput, SolverError.
    """
    if len(models) != len(trials):
        raise BadInput(f"predict_batch: {len(models)} models for {len(trials)} trials; give one for each")
    paths = [model.held_path(trial)[0] for model, trial in zip(models, trials, strict=True)]
    solutions = solve_batch(
        [model.rod(trial) for model, trial in zip(models, trials, strict=True)],
        [(trial.time_s, path, trial.tip_torque_nm) for trial, path in zip(trials, paths, strict=True)],
        threads=threads,
        tolerance_rad=min((model.tolerance_rad for model in models), default=DEFAULT_TOLERANCE_RAD),
    )
    return [
        model.observed(trial, solution)
        for model, trial, solution in zip(models, trials, solutions, strict=True)
    ]


@lru_cache(maxsize=64)
def _bare_rod(
    layout: Layout, torsional_rigidity_nm2: float, friction_n: float, element_length_m: float
) -> Rod:
    return build_rod(layout, torsional_rigidity_nm2, friction_n, element_length_m)


class _Place(Trial):
    """A trial's place in its series, without a path. Remembers whether an effect asked for it."""

    asked = False

    def __getattribute__(self, name: str) -> Any:
        if name in _OF_PLACE:
            object.__setattr__(self, "asked", True)
        return object.__getattribute__(self, name)


_OF_PLACE = frozenset({"start_s", "index", "travel_before_rad"})


@lru_cache(maxsize=64)
def _rod(model: NeedleModel, start_s: float, index: int, travel_before_rad: float) -> tuple[Rod, bool]:
    """The rod, and whether it is that of this place in the series alone."""
    place = _Place(_NO_PATH, _NO_PATH, start_s, index, travel_before_rad)
    rod = _bare_rod(model.layout, model.torsional_rigidity_nm2, model.friction_n, model.element_length_m)
    if model.torque_scale != 1.0:
        rod = replace(rod, torque_scale=model.torque_scale)
    for effect in model.acting("shape"):
        rod = effect.shape(rod, place)
    laws: Iterable[Effect] = model.acting("torque")
    rod = replace(rod, laws=(*rod.laws, *(torque_law(effect, rod) for effect in laws)))
    return rod, place.asked


def _with_held(solution: Solution, held_rad: tuple[float, ...]) -> Solution:
    state = solution.state
    fields = {f.name: getattr(state, f.name) for f in dataclasses.fields(RodState)}
    return replace(solution, state=NeedleState(**fields, held_rad=held_rad))
