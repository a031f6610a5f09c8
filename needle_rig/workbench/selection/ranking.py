"""How well each effect does, with what speaks for it and against it."""

from __future__ import annotations

from typing import Any

import numpy as np

from needle_rig.workbench.estimation.cross_validation import CrossValidation
from needle_rig.workbench.estimation.problem import Fit
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection.answer import SIGMAS_95, Ranked, Value
from needle_rig.workbench.selection.candidates import Candidate
from needle_rig.workbench.selection.evidence import adjusted_p, improves_cross_validation
from needle_rig.workbench.selection.rivals import Rival
from needle_rig.workbench.selection.search import SearchTrace
from needle_rig.workbench.selection.values import spelt_sigmas

TOLD_PULL_SIGMAS = 3.0
"""Pull of the stated rigidity from which it is reported against an effect."""
TOLD_RIVALS = 2
"""Ties that are reported against an effect, the closest first."""
TOLD_TIMES = 1.1
"""Ratio of errors on commands left out, with and without an effect, from which it is reported."""


def order(search: SearchTrace, named: list[str]) -> list[str]:
    """Effects in the order of what each would leave unexplained if it were missing."""
    here = search.fits[search.best][0].objective

    def loss(effect: str) -> float:
        rest = frozenset(search.best - {effect})
        return search.fits[rest][0].objective - here if rest in search.fits else np.inf

    return sorted(named, key=lambda e: (-loss(e), e))


def values_of(fit: Fit, effect: str) -> tuple[Value, ...]:
    """Fitted parameters of one effect with their 95 % intervals."""
    found = []
    for parameter, at, error in zip(fit.parameters, fit.vector.scaled_values, fit.scaled_errors, strict=True):
        if parameter.effect != effect:
            continue
        ends = [
            parameter.value(float(np.clip(at + s * SIGMAS_95 * error, *parameter.bounds))) for s in (-1, 1)
        ]
        value = parameter.value(float(at))
        low, high = parameter.info.literature
        plausible = low <= value <= high or value == parameter.info.off
        found.append(Value(parameter.name, value, min(ends), max(ends), parameter.info.unit, plausible))
    return tuple(found)


def rank(
    search: SearchTrace,
    ordered: list[str],
    rivals: dict[str, list[Rival]],
    verdict: str,
    adopted: Fit,
    validation: CrossValidation,
) -> list[Ranked]:
    """The named effects in the order given, then every other by what it does alone.

    `adopted` and `validation` are those of the named set, as a baseline of its own model.
    """
    problem = search.problem
    ranked = []
    root = search.root
    best, _ = search.fits[search.best]
    done = set()
    if verdict == "effect":
        for effect in ordered:
            tied = tuple(r.effect for r in rivals[effect] if r.tied)
            rest = search.fits.get(frozenset(search.best - {effect}))
            alone = rest[0].objective - best.objective if rest else np.inf
            apart = [r for r in rivals[effect] if r.separation_sigma is not None]
            ranked.append(
                Ranked(
                    effect,
                    validation.error,
                    _removed(problem, root, best)
                    if len(ordered) == 1
                    else min(1.0, alone / _room(problem, root)),
                    values_of(adopted, effect),
                    tied,
                    apart[0].separation_sigma if apart else None,
                    _favour(search, best) + _without(search, effect, validation),
                    _against(adopted, effect, rivals[effect]),
                )
            )
            done.add(effect)
        for effect in ordered:
            for rival in rivals[effect]:
                if rival.tied and rival.effect not in done:
                    found, found_validation = search.fits[rival.key]
                    error = found_validation.error if found_validation else None
                    ranked.append(
                        Ranked(
                            rival.effect,
                            error,
                            _removed(problem, root, found),
                            values_of(found, rival.effect),
                            (effect,),
                            rival.separation_sigma,
                            _favour(search, found),
                            _against(found, rival.effect, []) or f"{effect} fits as well",
                        )
                    )
                    done.add(rival.effect)
    others = [c for c in search.children.get(search.start, ()) if c.fit is not None and c.effect not in done]
    others.sort(key=lambda c: (c.fit.objective if c.fit else 0.0, c.effect))
    for candidate in others:
        ranked.append(_single(search, candidate))
    return ranked


def _single(search: SearchTrace, candidate: Candidate) -> Ranked:
    found = candidate.fit
    assert found is not None
    seen = adjusted_p(search.root, found, len(search.names)) < POLICY.evidence.significance
    predicts = improves_cross_validation(search.root_validation, candidate.validation) or not np.isfinite(
        search.root_validation.error
    )
    removed = _removed(search.problem, search.root, found)
    favour = (
        f"alone it removes {100 * removed:.0f} % of the error above the noise"
        if seen
        else "nothing beyond chance"
    )
    against = "" if seen and predicts else "what it gains does not carry over to commands left out"
    return Ranked(
        candidate.effect,
        candidate.validation.error if candidate.validation else None,
        removed,
        values_of(found, candidate.effect),
        (),
        None,
        favour,
        against if seen else "a gain like this comes by chance",
    )


def _room(problem: Any, root: Fit) -> float:
    return float(max(root.chi2 - problem.size, 1.0))


def _removed(problem: Any, root: Fit, found: Fit) -> float:
    """Share of the error above the noise that a fit removes, 0 to 1."""
    gain = root.objective - found.objective
    return float(
        np.clip(gain / max(root.objective - min(found.objective, problem.size), gain, 1e-9), 0.0, 1.0)
    )


def _favour(search: SearchTrace, found: Fit) -> str:
    removed = 100 * _removed(search.problem, search.root, found)
    names = "it" if len(found.effects) - len(search.start) == 1 else "the model with it"
    told = " and predicts commands left out" if np.isfinite(search.root_validation.error) else ""
    return f"{names} removes {removed:.0f} % of the error above the noise{told}"


def _without(search: SearchTrace, effect: str, validation: CrossValidation) -> str:
    """What is lost without an effect that is named: by how much commands left out are missed then."""
    rest = search.best - {effect}
    if rest not in search.fits:
        return ""
    fit, left_out = search.fits[rest]
    apart = spelt_sigmas(np.sqrt(max(fit.objective - search.fits[search.best][0].objective, 0.0)))
    times = left_out.error / validation.error if left_out else np.nan
    if not TOLD_TIMES < times < np.inf:
        return f"; without it the fit is {apart} worse"
    decimals = max(0, 1 - int(np.log10(times)))
    return f"; without it the error on them is {times:.{decimals}f} times as large ({apart})"


def _against(found: Fit, effect: str, rivals: list[Rival]) -> str:
    parts = [
        f"{v.name} = {v.value:.3g} {v.unit} is outside what is plausible"
        for v in values_of(found, effect)
        if not v.plausible
    ]
    tied = [r for r in rivals if r.tied]
    for rival in tied[:TOLD_RIVALS]:
        apart = "" if rival.separation_sigma is None else f" ({spelt_sigmas(rival.separation_sigma)} apart)"
        parts.append(f"{rival.effect} fits as well{apart}")
    if abs(found.pull_rigidity) > TOLD_PULL_SIGMAS:
        parts.append(f"the stated constants of the needle are off by {spelt_sigmas(found.pull_rigidity)}")
    return "; ".join(parts)
