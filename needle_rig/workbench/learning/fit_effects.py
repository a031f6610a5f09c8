"""Named effects fitted to traces, some values held; intervals and correlations of what was fitted.

Each effect that the model lacks is first fitted from the starts that screening finds. Then all of it is
fitted at once, as `compare` does.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.special import stdtrit

from needle_rig.dataset import Dataset
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel
from needle_rig.physics.effect import Effect
from needle_rig.physics.machine import check_fits
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.workbench.estimation.baseline import fit_baseline, null_model
from needle_rig.workbench.estimation.file_units import in_file_units, within_bounds
from needle_rig.workbench.estimation.parameters import shared_names
from needle_rig.workbench.learning.compare import Held, TraceComparison, compare, known_value
from needle_rig.workbench.learning.learn import saved_fit
from needle_rig.workbench.learning.steps import numbered
from needle_rig.workbench.selection.answer import SIGMAS_95, Say
from needle_rig.workbench.selection.candidates import try_effect

CONFIDENCE = 0.95


def fit_effects(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    saved: SavedModel | None = None,
    effects: Sequence[str] = (),
    fixed: Mapping[str, float] | None = None,
    say: Say = lambda _: None,
) -> TraceComparison:
    """Fit the model (default: the null model) with `effects` more; `fixed` values, in file units, stay.

    Raises BadInput, SolverError.
    """
    fixed = fixed or {}
    model = null_model(dataset) if saved is None else saved.model
    for name in effects:
        if name not in library:
            raise BadInput(f"{name}: no such effect; there are {', '.join(sorted(library))}")
        check_fits(library[name], dataset.machine)
    present = {effect.name() for effect in model.effects}
    added = [name for name in dict.fromkeys(effects) if name not in present]
    whole = model.with_effects(*(library[name]() for name in added))
    whole = dataclasses.replace(whole, name=" + ".join((model.name, *added)))
    for name in fixed:
        known_value(whole, name)
    whole = whole.replaced(fixed)
    free = [name for name in added if not _fixed(whole, name, fixed)]
    step = numbered(say, 3 + len(free))
    if free:
        whole = _begun(dataset, library, whole.without(*free), free, fixed, step)
    start = SavedModel(whole, "null" if saved is None else saved.starts_from) if effects or saved else None
    held = Held(refit_only=True, fixed=fixed)
    if not free:
        return compare(dataset, library, start, held, say)
    step("fitting all of it together")
    return compare(dataset, library, start, held)


def intervals(found: TraceComparison) -> dict[str, tuple[float, float]]:
    """The 95 % interval of each value that was fitted, by name, in file units.

    Friction has Student's t: its ± is mostly the scatter of the trials, which is estimated, too.
    """
    of = found.baseline.current
    size = np.sqrt(np.maximum(np.diag(of.covariance), 0.0))
    reach = np.full(size.size, SIGMAS_95)
    reach[0] = float(stdtrit(max(of.scatter_dof - 1.0, 1.0), 0.5 + CONFIDENCE / 2))
    low, high = (
        in_file_units(of.parameters, within_bounds(of.parameters, of.vector.shared + s * reach * size))
        for s in (-1.0, 1.0)
    )
    ends = np.sort(np.stack([low, high]), axis=0).T
    names = shared_names(of.parameters)
    return {
        name: (float(a), float(b))
        for name, (a, b), value in zip(names, ends, found.values.each, strict=True)
        if value.refit_uncertainty is not None
    }


def correlations(found: TraceComparison) -> dict[tuple[str, str], float]:
    """Correlation of each pair of values that were fitted, by their names."""
    of = found.baseline.current
    size = np.sqrt(np.maximum(np.diag(of.covariance), 0.0))
    free = [i for i, value in enumerate(found.values.each) if value.refit_uncertainty and size[i] > 0.0]
    names = shared_names(of.parameters)
    return {
        (names[i], names[k]): float(np.clip(of.covariance[i, k] / (size[i] * size[k]), -1.0, 1.0))
        for i in free
        for k in free
        if i < k
    }


def fitted_model(found: TraceComparison) -> SavedModel:
    """The model of a fit as a model file knows it. A value that was fixed has no uncertainty."""
    saved = saved_fit(found.baseline)
    fixed = found.baseline.problem.fixed
    known = {name: size for name, size in saved.uncertainties.items() if name not in fixed}
    return dataclasses.replace(saved, uncertainties=known, correlations=correlations(found))


def _begun(
    dataset: Dataset,
    library: Mapping[str, type[Effect]],
    model: NeedleModel,
    effects: Sequence[str],
    fixed: Mapping[str, float],
    step: Say,
) -> NeedleModel:
    """The model with each effect fitted on top of those before it: where the fit of all begins."""
    there = model.values()
    began = fit_baseline(
        dataset,
        model,
        library,
        fixed=tuple(name for name in fixed if name in there),
        say=step,
    )
    problem, parent = began.problem, began.current
    for effect in effects:
        step(f"fitting {effect} on top")
        parameters = problem.parameters([effect])
        held = {p.full_name: p.scaled_value(fixed[p.full_name]) for p in parameters if p.full_name in fixed}
        problem = problem.fixing(held)
        found = try_effect(problem, parent, effect).fit
        if found is None:
            raise BadInput(f"{effect} cannot be fitted to {dataset.name}; leave it out, or fix its values")
        parent = found
    whole = problem.model(parent.parameters, parent.vector)
    return dataclasses.replace(whole, name=model.name, element_length_m=began.fine_m)


def _fixed(model: NeedleModel, effect: str, fixed: Mapping[str, float]) -> bool:
    """Whether every value of the effect is fixed."""
    return all(name in fixed for name in model.values() if name.split(".")[0] == effect)
