"""The rules of a diagnosis, each as what switches it off, and a memory that makes a second answer cheap."""

from __future__ import annotations

import hashlib
import math
import pickle
import sys
from collections import ChainMap
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

import needle_rig.workbench.estimation.baseline as baseline
import needle_rig.workbench.estimation.cross_validation as cross_validation
import needle_rig.workbench.estimation.discretisation_error as discretisation
import needle_rig.workbench.estimation.map_fit as map_fit
import needle_rig.workbench.estimation.multistart as multistart
import needle_rig.workbench.observations.binning as binning
import needle_rig.workbench.observations.measured_noise as measured_noise
import needle_rig.workbench.observations.noise_terms.offset as offset
import needle_rig.workbench.observations.outliers as outliers
import needle_rig.workbench.observations.shown_terms as shown_terms
import needle_rig.workbench.observations.snaps as snaps
import needle_rig.workbench.selection.candidates as candidates
import needle_rig.workbench.selection.decisions as decisions
import needle_rig.workbench.selection.design as design
import needle_rig.workbench.selection.diagnose as diagnose
import needle_rig.workbench.selection.evidence as evidence
import needle_rig.workbench.selection.lack_of_fit as lack_of_fit
import needle_rig.workbench.selection.notes as notes
import needle_rig.workbench.selection.residual_patterns as residual_patterns
import needle_rig.workbench.selection.rivals as rivals
import needle_rig.workbench.selection.screening as screening
import needle_rig.workbench.selection.search as search
import needle_rig.workbench.selection.shown_noise as shown_noise
import needle_rig.workbench.selection.verdict as verdict
from needle_rig.workbench.policy import POLICY

Undo = Callable[[], None]
Off = Callable[[], list[Undo]]
"""Switches a rule off; what it gives switches it on again."""

REMEMBERED: tuple[tuple[Any, str], ...] = (
    (map_fit, "fit"),
    (multistart, "lowest_fit"),
    (multistart, "over_forms"),
    (multistart, "over_strength"),
    (cross_validation, "cross_validate"),
    (screening, "screen"),
    (discretisation, "with_discretisation_error"),
    (discretisation, "driven_at"),
    (baseline, "judged"),
    (baseline, "_first_fit"),
    (binning, "bin_trial"),
    (measured_noise, "measure_noise"),
    (shown_terms, "with_shown_terms"),
    (shown_terms, "with_motion_scatter"),
    (residual_patterns, "find_residual_patterns"),
    (lack_of_fit, "lack_of_fit"),
    (rivals, "separation"),
    (design, "best_experiment"),
    (snaps, "snaps"),
)
"""Functions of their arguments alone that take the time of a diagnosis."""


class Memory:
    """Results of one dataset's diagnoses by their arguments: without a rule only what is new is computed."""

    def __init__(self) -> None:
        self._results: ChainMap[tuple[Any, ...], tuple[Any, BaseException | None]] = ChainMap()
        self._stamps: ChainMap[int, tuple[Any, bytes]] = ChainMap()
        self.fresh: Collection[str] = ()
        """Functions that the rule which is off works inside of."""

    @contextmanager
    def apart(self, fresh: Collection[str]) -> Iterator[None]:
        """What is computed within is forgotten after it: gigabytes, over all rules. Functions `fresh` are
        asked anew."""
        before = self._results, self._stamps
        self._results, self._stamps = self._results.new_child(), self._stamps.new_child()
        self.fresh = fresh
        try:
            yield
        finally:
            self._results, self._stamps = before
            self.fresh = ()

    def of(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, asked once for the same arguments."""

        def remembered(*args: Any, **kwargs: Any) -> Any:
            key = (
                name,
                name in self.fresh,
                *map(self._stamp, args),
                *((k, self._stamp(v)) for k, v in kwargs.items()),
            )
            if key not in self._results:
                try:
                    self._results[key] = function(*args, **kwargs), None
                except Exception as error:  # noqa: BLE001 raised below, as often as it is asked
                    self._results[key] = None, error
            result, failed = self._results[key]
            if failed is not None:
                raise failed
            return result

        return remembered

    def _stamp(self, thing: Any) -> Any:
        """A small value that stands for the content of `thing`."""
        if thing is None or isinstance(thing, str | int | float | bool | frozenset):
            return thing
        if callable(thing):
            return id(thing)
        if id(thing) not in self._stamps:
            digest = hashlib.sha256(pickle.dumps(thing, protocol=pickle.HIGHEST_PROTOCOL)).digest()
            self._stamps[id(thing)] = thing, digest  # held, so that no other thing gets its identity
        return self._stamps[id(thing)][1]


def everywhere(original: Any, other: Any) -> list[Undo]:
    """Put `other` where modules of the project hold `original`."""
    undo: list[Undo] = []
    for name, module in list(sys.modules.items()):
        if name.startswith("needle_rig"):
            for field, value in list(vars(module).items()):
                if value is original:
                    setattr(module, field, other)
                    undo.append(lambda m=module, f=field: setattr(m, f, original))  # type: ignore[misc]
    return undo


@contextmanager
def remembering() -> Iterator[Memory]:
    """A memory of what is diagnosed here."""
    memory, undo = Memory(), []
    for module, name in REMEMBERED:
        original = getattr(module, name)
        undo += everywhere(original, memory.of(name, original))
    try:
        yield memory
    finally:
        for each in undo:
            each()


def gives(owner: Any, name: str, other: Any) -> Off:
    """`owner.name` is `other` here; elsewhere it stays."""

    def off() -> list[Undo]:
        before = getattr(owner, name)
        setattr(owner, name, other)
        return [lambda: setattr(owner, name, before)]

    return off


def threshold(group: str, name: str, value: Any) -> Off:
    """A threshold at which its rule says nothing."""

    def off() -> list[Undo]:
        part = getattr(POLICY, group)
        before = getattr(part, name)
        object.__setattr__(part, name, value)
        return [lambda: object.__setattr__(part, name, before)]

    return off


def together(*each: Off) -> Off:
    """Several of them."""
    return lambda: [undo for off in each for undo in off()]


def without_verdict(rule: Callable[..., Any]) -> Off:
    """A rule of the verdict."""
    return gives(verdict, "RULES", tuple(r for r in verdict.RULES if r is not rule))


@dataclass(frozen=True)
class Rule:
    """What can be switched off. Functions `fresh` hold the rule: their results are computed anew."""

    name: str
    off: Off
    fresh: tuple[str, ...] = ()
    noise: bool = False
    """It changes the noise, and with it every fit: asked of a share of the datasets."""


def at_once(rules: Sequence[Rule]) -> Rule:
    """All of them switched off together: what nobody misses together, nobody misses alone."""
    fresh = tuple(sorted({name for rule in rules for name in rule.fresh}))
    return Rule("all of: " + "; ".join(rule.name for rule in rules), together(*(r.off for r in rules)), fresh)


def noise_rule(name: str, off: Off, *fresh: str) -> Rule:
    """A rule by which noise is measured."""
    return Rule(f"noise: {name}", off, fresh, noise=True)


def _as_it_is(*given: Any, **_: Any) -> Any:
    return given[0]


def _likelihood_alone(parent: Any, child: Any) -> float:
    return max(float(parent.objective - child.objective), 0.0)


def _never(*_: Any, **__: Any) -> bool:
    return False


def _always(*_: Any, **__: Any) -> bool:
    return True


def _nothing(*_: Any, **__: Any) -> None:
    return None


def _tie_of_general(behind: float, **given: Any) -> bool:
    return _CANNOT_BE_TOLD_APART(behind, **{**given, "gain_over_special": None})


_CANNOT_BE_TOLD_APART = rivals.cannot_be_told_apart


def _none(*_: Any) -> list[Any]:
    return []


def _one_test(parent: Any, child: Any, _: int) -> float:
    return evidence.adjusted_p(parent, child, 1)


def _not_swapped(trace: Any, _: Any) -> Any:
    return trace, trace.best


def _known_noise(_: Any, problem: Any, __: Any) -> Any:
    return problem.noise


def _as_fitted(_: Any, found: Any) -> Any:
    return found


def _none_set_aside(values: Any) -> Any:
    valid = np.isfinite(values)
    where = np.arange(values.size)
    filled = np.interp(where, where[valid], values[valid]) if valid.any() else np.zeros(values.size)
    return filled, valid, np.zeros(values.size, bool)


def _no_offsets(binned: Any, within: Any, floor: Any) -> Any:
    return offset.Offset(np.zeros(len(floor)))


def _no_error(problem: Any, found: Any, *_: Any) -> Any:
    return problem, found


_SMALL_PATTERN = "find_residual_patterns"

RULES: tuple[Rule, ...] = (
    # effects, noise and initial twists in turn
    Rule("noise that shows beside what was found", gives(shown_noise, "with_noise_at", _as_it_is)),
    Rule("initial twists that what was found holds", gives(shown_noise, "with_starts_of", _as_it_is)),
    Rule("driven by every sample", gives(shown_noise, "with_samples_at", _as_it_is)),
    Rule("noise that the residual shows", gives(shown_noise, "left_over", _known_noise)),
    Rule("no turns of effects and noise", gives(diagnose, "renewed", _nothing)),
    # the search
    Rule("negligible effect set aside", threshold("search", "set_aside", 0)),
    Rule("effect of no size taken out", gives(search, "has_size", _always)),
    Rule("swap of effects", gives(search, "_swapped", _not_swapped)),
    Rule("backward elimination", gives(search, "back", _as_it_is)),
    Rule("several sets side by side", threshold("search", "frontier", 1)),
    Rule("only what screening promises is fitted", threshold("screening", "kept", 0.0)),
    Rule("Šidák's adjustment over the library", gives(search, "adjusted_p", _one_test)),
    Rule("gain of steadier friction as F test", gives(evidence, "gain_of", _likelihood_alone)),
    Rule("within the discretisation error", gives(search, "within_discretisation_error", _never)),
    Rule("cross-validation must improve", gives(search, "improves_cross_validation", _always)),
    # fits
    Rule("fit from other forms", gives(candidates, "over_forms", _as_fitted)),
    # the verdict
    *(Rule(f"verdict: {rule.__name__}", without_verdict(rule)) for rule in verdict.RULES),
    Rule("verdict: values beyond what is plausible", gives(diagnose, "contrived", _none)),
    Rule("verdict: a pattern of small size", gives(type(POLICY.size), "small", _never), (_SMALL_PATTERN,)),
    # ties
    Rule("tie: a generalisation must gain", gives(rivals, "cannot_be_told_apart", _tie_of_general)),
    # the noise
    noise_rule("outliers set aside", gives(binning, "set_aside", _none_set_aside), "bin_trial"),
    noise_rule("terms that replicates show", gives(baseline, "with_shown_terms", _as_it_is)),
    noise_rule("scatter from motion to motion", gives(baseline, "with_motion_scatter", _as_it_is)),
    noise_rule("offset of a trial", gives(measured_noise, "measured_offset", _no_offsets), "measure_noise"),
    noise_rule("jitter of the clock", threshold("noise", "clock_jitter_s", 0.0), "measure_noise"),
    noise_rule("nothing after a snap", gives(baseline, "snaps", lambda *_: ())),
    noise_rule(
        "nothing where replicates agree on more",
        threshold("noise", "replicate_misfit", math.inf),
        "with_shown_terms",
    ),
    noise_rule("discretisation error as nuisance", gives(baseline, "with_discretisation_error", _no_error)),
)


@contextmanager
def switched_off(rule: Rule, memory: Memory) -> Iterator[None]:
    """Answers within are those without `rule`."""
    with memory.apart(rule.fresh):
        undo = rule.off()
        try:
            yield
        finally:
            for each in reversed(undo):
                each()


_USED = (decisions, notes, outliers, shown_noise)
"""Imported, so that `everywhere` reaches them."""
