"""What was measured of a needle, traces or settled values, to whoever compares, diagnoses and adopts."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from needle_rig.dataset import Dataset
from needle_rig.dataset.settled import SettledData
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import NEEDLE, check_fits
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout
from needle_rig.workbench.estimation.baseline import as_baseline, fit_baseline
from needle_rig.workbench.learning.compare import Held, TraceComparison, compare
from needle_rig.workbench.observations.sources import read_observed
from needle_rig.workbench.parallel import Work
from needle_rig.workbench.published.compare import compare_settled
from needle_rig.workbench.published.diagnose_settled import diagnose_settled
from needle_rig.workbench.published.explanation import by_quantity
from needle_rig.workbench.published.explanation import explanation as settled_explanation
from needle_rig.workbench.published.single_effects import settled_problem, values_to_meet
from needle_rig.workbench.published.single_effects import try_effect as try_settled
from needle_rig.workbench.selection.answer import Answer, Say
from needle_rig.workbench.selection.candidates import try_effect
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.documents import ChannelError, CompareDocument, PlaceError
from needle_rig.workbench.selection.evidence import improves_cross_validation
from needle_rig.workbench.selection.explanation import Explanation, explanation, training_errors
from needle_rig.workbench.selection.values import ComparedValues

Library = Mapping[str, type[Effect]]


class Comparison(Protocol):
    """Where a model fails, for people and programs."""

    @property
    def held_out_error(self) -> float:
        """Error of cross-validation in units of the noise; not finite where nothing could be left out."""

    @property
    def channels(self) -> dict[str, ChannelError]:
        """By channel: rmse, noise, in_noise_units (one over the other), unit, whitened, by_phase."""

    def headline(self) -> tuple[str, str]:
        """The data's name, and what is said of it."""

    def rows(self) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
        """Headings of the table, and its rows."""

    def sentences(self) -> list[str]:
        """Sentences below the table of `rows`."""

    @property
    def values(self) -> ComparedValues:
        """Values of the model beside those of the refit."""

    def value_sentences(self) -> list[str]:
        """Of these, those on `values`, and what is estimated beside them."""

    def places(self) -> list[PlaceError]:
        """All that was compared: channel, motion, state, direction, model, measured, error, noise, unit."""

    def traces(self) -> TraceComparison:
        """What can be drawn. Raises BadInput where there are settled values only."""

    def as_json(self) -> CompareDocument:
        """The stated form of the answer."""


class Observations(Protocol):
    """What was measured of one rig."""

    @property
    def name(self) -> str:
        """As a person called it."""

    def sha256(self) -> str:
        """SHA-256 of everything that was measured and commanded, without the name."""

    def compare(
        self,
        library: Library,
        model: SavedModel | None,
        values: Held | None = None,
        say: Say = lambda _: None,
    ) -> Comparison:
        """Hold the model (default: the null model, fitted) and look where it fails; refit it beside that.

        Raises BadInput, SolverError.
        """

    def diagnose(
        self,
        library: Library,
        model: NeedleModel | None,
        *,
        max_effects: int = 3,
        quick: bool = False,
        work: Work | None = None,
        say: Say = lambda _: None,
    ) -> Answer:
        """Which effect is missing from the model. Raises BadInput, SolverError."""

    def explain(self, library: Library, model: NeedleModel | None, effect: str) -> Explanation | None:
        """The model with `effect`, fitted; None where that cannot be solved. Raises BadInput, SolverError."""

    def errors(self, found: Explanation) -> dict[str, float]:
        """Root mean square error of a fitted model by channel, from one simulation, in the channel's unit.

        Raises BadInput, SolverError.
        """


@dataclass(frozen=True)
class Traces:
    """Time series of torque and angles."""

    data: Dataset

    @property
    def name(self) -> str:
        """As the dataset is called."""
        return self.data.name

    def sha256(self) -> str:
        """SHA-256 of layout, needle, commands and readings."""
        data = self.data
        stated = [_layout(data.layout), asdict(data.needle), data.sensor_names]
        told = [
            [
                t.trial.start_s,
                asdict(t.command),
                *([] if t.start == "relaxed" else [t.start]),
                *t.turns_before_rad,
                *t.turns_before_s,
            ]
            for t in data.trials
        ]
        phases = [t.phase.tolist() for t in data.trials]
        read = [
            part
            for t in data.trials
            for part in (t.trial.time_s, t.base_measured_rad, t.torque_nm, t.hall_rad, t.trial.tip_torque_nm)
            if part is not None
        ]
        return _sha256([stated, told, phases], read)

    def compare(
        self,
        library: Library,
        model: SavedModel | None,
        values: Held | None = None,
        say: Say = lambda _: None,
    ) -> TraceComparison:
        """Hold the model (default: the null model, fitted) and look where it fails; refit it beside that.

        Raises BadInput, SolverError.
        """
        return compare(self.data, library, model, values, say)

    def diagnose(
        self,
        library: Library,
        model: NeedleModel | None,
        *,
        max_effects: int = 3,
        quick: bool = False,
        work: Work | None = None,
        say: Say = lambda _: None,
    ) -> Answer:
        """Which effect is missing from the model. Raises BadInput, SolverError."""
        return diagnose(self.data, library, model, max_effects=max_effects, quick=quick, work=work, say=say)

    def explain(self, library: Library, model: NeedleModel | None, effect: str) -> Explanation | None:
        """The model with `effect`, fitted; None where that cannot be solved. Raises BadInput, SolverError."""
        check_fits(library[effect], self.data.machine)
        baseline = fit_baseline(self.data, model, library)
        tried = try_effect(baseline.problem, baseline.current, effect)
        if tried.fit is None or tried.validation is None:
            return None
        improves = improves_cross_validation(baseline.validation, tried.validation)
        compared = as_baseline(baseline, baseline.problem, tried.fit, tried.validation)
        return explanation(baseline, *compared, improves=improves)

    def errors(self, found: Explanation) -> dict[str, float]:
        """Root mean square error of bin means by channel, from one simulation of each trial at its random
        effect.

        Raises BadInput where the trials are others than those of the fit, SolverError.
        """
        return training_errors(self.data, found)


@dataclass(frozen=True)
class SettledValues:
    """What sensors showed when motions had settled."""

    data: SettledData

    @property
    def name(self) -> str:
        """As the data are called."""
        return self.data.name

    def sha256(self) -> str:
        """SHA-256 of layout, needle, sequences and values, without their places in the file."""
        data = self.data
        stated = [_layout(data.layout), asdict(data.needle), data.sensor_names, data.zeroed_at_rest]
        sequences = [{k: v for k, v in asdict(s).items() if k != "place"} for s in data.sequences]
        return _sha256([stated, sequences, [asdict(v) for v in data.values]], [])

    def compare(
        self,
        library: Library,
        model: SavedModel | None,
        values: Held | None = None,
        say: Say = lambda _: None,
    ) -> Comparison:
        """Hold the model (default: the null model, fitted), show every value beside it, and refit it.

        Raises BadInput, also for values to be fixed or freed one by one.
        """
        if values is not None and (values.fixed or values.free):
            raise BadInput(
                f"{self.data.name} has settled values only, too few to fix or free values of the model one by"
                " one; leave fixed and free out"
            )
        say("fitting the model to the settled values")
        return compare_settled(self.data, library, model, refit_only=bool(values and values.refit_only))

    def diagnose(
        self,
        library: Library,
        model: NeedleModel | None,
        *,
        max_effects: int = 3,  # noqa: ARG002 one effect at a time is tried
        quick: bool = False,  # noqa: ARG002 it always is
        work: Work | None = None,
        say: Say = lambda _: None,
    ) -> Answer:
        """Which one effect is missing from the model. Raises BadInput."""
        with work or Work():  # a few seconds' work: none is handed out
            return diagnose_settled(self.data, library, model, say=say)

    def explain(self, library: Library, model: NeedleModel | None, effect: str) -> Explanation | None:
        """The model with `effect`, fitted; None where it changes none of the values. Raises BadInput."""
        check_fits(library[effect], NEEDLE)
        problem, root = settled_problem(self.data, library, model)
        found = try_settled(problem, root, effect, 1).fit
        return None if found is None else settled_explanation(problem, root, found)

    def errors(self, found: Explanation) -> dict[str, float]:
        """Root mean square error of the weighed values by quantity, from one run of each sequence. Raises
        BadInput, SolverError."""
        problem = values_to_meet(self.data, {}, found.model)
        model = dataclasses.replace(
            found.model, layout=problem.base.layout, element_length_m=problem.base.element_length_m
        )
        return by_quantity(problem, problem.predict(model))


def observations(data: Dataset | SettledData) -> Observations:
    """Either kind, to be asked the same questions."""
    return SettledValues(data) if isinstance(data, SettledData) else Traces(data)


def read_observations(paths: Sequence[str | os.PathLike[str]]) -> Observations:
    """What a person names as DATA; see `read_observed`. Raises BadInput."""
    return observations(read_observed(paths))


def _layout(layout: Layout) -> dict[str, Any]:
    """What a layout states; a free tip is stated by nothing."""
    return {key: value for key, value in asdict(layout).items() if key != "tip_clamped" or value}


def _sha256(stated: Any, read: Sequence[npt.NDArray[np.float64]]) -> str:
    digest = hashlib.sha256(json.dumps(stated, sort_keys=True).encode())
    for part in read:
        # one NaN for all, and no −0, so that equal readings are equal bytes
        numbers = np.where(np.isnan(part), np.nan, part + 0.0)
        digest.update(np.asarray(numbers, dtype="<f8").tobytes())
    return digest.hexdigest()
