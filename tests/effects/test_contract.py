"""What every effect is held to: the built-in ones and a user's, found by their files."""

from __future__ import annotations

import ast
import inspect
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.physics.effect import Effect, Reading, Trial
from needle_rig.physics.effects.tip_friction import TipFriction
from needle_rig.physics.library import built_in_effects
from needle_rig.physics.needle_model import NeedleModel, predict_batch
from needle_rig.physics.rod import Rod
from needle_rig.units import nm
from needle_rig.workbench.estimation.simulator import Simulator
from needle_rig.workbench.observations.binning import bin_trial
from needle_rig.workbench.policy import POLICY
from tests.effects.common import LIBRARY, SEQUENCE, SETTLED_S, SHORT, driven, make_effect, path
from tests.workbench.hidden import dataset

PAGE = Path(__file__).parents[2] / "docs/reference/effects.md"


def off(effect: type[Effect]) -> Effect:
    return effect(**{n: i.typical if i.shapes else i.off for n, i in effect.parameters().items()})


def drawn(effect: type[Effect], s: float) -> Effect:
    """An effect `s` times as strong as is typical, kept within its bounds; forms near their typical size."""
    values = {}
    for name, info in effect.parameters().items():
        value = info.typical * min(max(s, 0.5), 2.0) if info.shapes else info.at_strength(s)
        values[name] = min(max(value, info.lower), info.upper)
    return effect(**values)


def same(one: Reading, other: Reading) -> bool:
    return bool((one.torque_nm == other.torque_nm).all() and (one.hall_rad == other.hall_rad).all())


def distance(one: Reading, other: Reading) -> float:
    """Largest difference in units of what matters."""
    angle = np.abs(one.hall_rad - other.hall_rad).max() / np.radians(POLICY.size.largest_deg)
    return float(max(angle, np.abs(one.torque_nm - other.torque_nm).max() / nm(POLICY.size.largest_nmm)))


def test_the_library_has_the_effects_that_its_page_lists() -> None:
    listing = PAGE.read_text(encoding="utf-8").partition("$ needle-rig effects\n")[2].partition("```")[0]
    assert sorted(built_in_effects()) == [line.split()[0] for line in listing.splitlines()]


def test_off_leaves_the_model_bit_for_bit(effect: type[Effect], coarse: NeedleModel) -> None:
    with_it = coarse.with_effects(off(effect))
    assert same(with_it.predict(SHORT), coarse.predict(SHORT))


def test_all_off_together_leave_the_model_bit_for_bit(coarse: NeedleModel) -> None:
    with_them = coarse.with_effects(*[off(e) for e in LIBRARY.values()])
    assert same(with_them.predict(SHORT), coarse.predict(SHORT))


def test_hooks_themselves_do_nothing_at_off(effect: type[Effect], coarse: NeedleModel) -> None:
    # the model leaves out what is off; the laws must vanish there by themselves too
    nothing = off(effect)
    rod = coarse.rod(SHORT)
    if effect.has("shape"):
        shaped = nothing.shape(rod, SHORT)
        for name in ("position_m", "stiffness_nm_per_rad", "slip_plus_nm", "slip_minus_nm"):
            assert (getattr(shaped, name) == getattr(rod, name)).all()
        for name in ("compliance_rad_per_nm", "viscous_nms_per_rad", "static_excess", "ageing_per_decade"):
            assert (getattr(shaped, name) == getattr(rod, name)).all()
        assert not np.isfinite(shaped.creep_stiffness_nm_per_rad).any()
        assert shaped.base_compliance_rad_per_nm == shaped.mount_compliance_rad_per_nm == 0
    if effect.has("torque"):
        angles = np.linspace(-7, 7, 29)
        assert all(nothing.torque(a, 0.3, 1.0, x) == 0 for a in angles for x in (0.18, 0.315))
    if effect.has("drive"):
        assert (nothing.drive(SHORT) == SHORT.base_angle_rad).all()
    if effect.has("observe"):
        reading = coarse.predict(SHORT)
        assert same(nothing.observe(reading), reading)


def test_a_little_of_it_changes_little(effect: type[Effect], coarse: NeedleModel) -> None:
    a_little = coarse.with_effects(drawn(effect, 1e-4))
    assert distance(a_little.predict(SHORT), coarse.predict(SHORT)) < 0.2


def test_its_typical_size_shows(effect: type[Effect], coarse: NeedleModel) -> None:
    # 10 s holds, so that ageing and creep have time
    long = path((0, 0), (0.5, 0), (1.5, 45), (7, 45), (7.6, 71), (9, 71), (10, 20), (12, 20))
    typical = coarse.with_effects(effect.at_strength(1.0))
    assert distance(typical.predict(long), coarse.predict(long)) > 1


def _size_that_matters(effect: type[Effect], field: str, model: NeedleModel) -> tuple[float, float]:
    values = {n: i.typical if i.shapes else i.off for n, i in effect.parameters().items()}
    smallest = effect(**values | {field: effect.parameters()[field].smallest})
    seen, base = (m.predict(SEQUENCE) for m in (model.with_effects(smallest), model))
    at = [int(np.searchsorted(SEQUENCE.time_s, s)) for s in SETTLED_S]
    settled = [Reading(SEQUENCE, r.torque_nm[at], r.hall_rad[at]) for r in (seen, base)]
    moving = driven(SEQUENCE)
    return distance(*settled), distance(model.with_effects(smallest).predict(moving), model.predict(moving))


@pytest.mark.parametrize("name", sorted(built_in_effects()))
def test_the_declared_smallest_size_is_where_it_starts_to_matter(name: str, model: NeedleModel) -> None:
    effect = LIBRARY[name]
    for field, info in effect.parameters().items():
        if not info.shapes:
            settled, anywhere = _size_that_matters(effect, field, model)
            size = settled if settled > 0.1 else anywhere
            assert 0.6 < size < 1.7, f"{field}: {size:.2f} of the size that matters"


def test_parameters_are_fully_described(effect: type[Effect]) -> None:
    for name, info in effect.parameters().items():
        assert info.unit
        assert info.lower < info.upper
        assert info.lower <= info.literature[0] < info.literature[1] <= info.upper
        assert info.shapes or info.lower <= info.off <= info.upper or np.isinf(info.off)
        assert info.shapes or abs(info.smallest - info.off) > 0
        assert _unit_in_name(name, info.unit), f"{name} does not end in its unit {info.unit}"


UNITS = {
    "1": ("",),
    "1/N·mm": ("_per_nmm",),
    "1/(N·mm)²": ("_per_nmm2",),
    "g·cm²": ("_gcm2",),
    "N·mm·s/rad": ("_nmms_per_rad",),
    "1/turn": ("per_turn",),
    "1/decade": ("per_decade",),
    "°": ("deg",),
    "°/s": ("deg_s",),
    "s": ("_s",),
    "ms": ("_ms",),
    "mm": ("_mm",),
    "N·mm": ("_nmm",),
    "N·mm/rad": ("_nmm_per_rad",),
    "N·mm/min": ("_nmm_per_min",),
    "N·mm per 100 mm": ("nmm_per_100mm",),
    "N·mm/rad per 100 mm": ("nmm_per_rad_per_100mm",),
    "N·mm·s/rad per 100 mm": ("nmms_per_rad_per_100mm",),
}


def _unit_in_name(name: str, unit: str) -> bool:
    return name.endswith(UNITS[unit])


def test_text_has_law_source_and_experiment(effect: type[Effect]) -> None:
    text = inspect.getdoc(sys.modules[effect.__module__]) or ""
    law, source, best = (text.index(word) for word in ("\nLaw:", "\nSource:", "\nShows best:"))
    assert law < source < best
    assert any(sign in text[law:source] for sign in "=≤→")
    assert effect.__doc__
    assert not effect.__doc__.startswith(effect.__name__ + "(")


def test_relatives_and_limits_name_effects_and_parameters(effect: type[Effect]) -> None:
    for relative in effect.relatives:
        assert relative in LIBRARY
        assert relative != effect.name()
    for limit, values in effect.limits.items():
        assert limit in LIBRARY
        assert set(values) <= set(effect.parameters())
        effect(**values)


def test_effects_do_not_know_each_other(effect: type[Effect]) -> None:
    tree = ast.parse(inspect.getsource(sys.modules[effect.__module__]))
    imported = [n.module or "" for n in ast.walk(tree) if isinstance(n, ast.ImportFrom)]
    imported += [a.name for n in ast.walk(tree) if isinstance(n, ast.Import) for a in n.names]
    assert not [m for m in imported if m.rpartition(".")[2] in LIBRARY or m.endswith(".effects")]


def test_values_out_of_bounds_are_refused(effect: type[Effect]) -> None:
    for name, info in effect.parameters().items():
        beyond = [info.upper * 1.01 + 1, info.lower - 1, float("nan"), "0.3", True]
        if not info.shapes and np.isinf(info.off):
            beyond.append(-info.off)
        for value in beyond:
            with pytest.raises(BadInput, match=rf"{effect.name()}\.{name}: "):
                effect(**{name: value}).check_for(1.0)


def _against_finer(model: NeedleModel) -> tuple[float, float]:
    """Largest difference to a 16 times finer run, in degrees and N·mm."""
    reading, fine = model.predict(SHORT), model.finer(16).predict(SHORT)
    angle_rad = np.abs(reading.hall_rad - fine.hall_rad).max()
    return float(np.degrees(angle_rad)), float(np.abs(reading.torque_nm - fine.torque_nm).max() * 1e3)


RATE_DEPENDENT = ("viscous_slip", "stribeck", "stiction_ageing", "tissue_viscoelasticity", "bending_torque")


@pytest.mark.parametrize("name", [n for n in LIBRARY if n not in RATE_DEPENDENT])
def test_it_keeps_to_a_16_times_finer_run(name: str, model: NeedleModel) -> None:
    angle_deg, torque_nmm = _against_finer(model.with_effects(LIBRARY[name].at_strength(1.0)))
    assert angle_deg <= 0.02
    assert torque_nmm <= 2e-4


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.parametrize("name", RATE_DEPENDENT)
def test_laws_in_time_keep_to_a_16_times_finer_run(name: str, model: NeedleModel) -> None:
    angle_deg, torque_nmm = _against_finer(model.with_effects(LIBRARY[name].at_strength(1.0)))
    assert angle_deg <= 0.02
    assert torque_nmm <= 2e-4


strength = st.one_of(st.just(1.0), st.floats(0.01, 2.0))


subsets = st.dictionaries(st.sampled_from(sorted(LIBRARY)), strength, max_size=len(LIBRARY)).map(
    lambda chosen: [drawn(LIBRARY[name], s) for name, s in chosen.items()]
)


@pytest.mark.timeout(300)
@settings(max_examples=25)
@given(effects=subsets, speed_deg_s=st.floats(5, 180), target_deg=st.floats(-180, 180))
def test_any_subset_composes_and_stays_finite(
    effects: list[Effect], speed_deg_s: float, target_deg: float
) -> None:
    model = NeedleModel("null", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3, tuple(effects), element_length_m=5e-3)
    turn_s = abs(target_deg) / speed_deg_s + 0.1
    trial = path((0, 0), (turn_s, target_deg), (turn_s + 0.5, target_deg), (2 * turn_s + 0.5, 0))
    reading = model.predict(trial)
    assert reading.torque_nm.shape == trial.time_s.shape
    assert reading.hall_rad.shape == (trial.time_s.size, 4)
    assert np.isfinite(reading.torque_nm).all()
    assert np.isfinite(reading.hall_rad).all()
    assert same(predict_batch([model], [trial])[0], reading)


@settings(max_examples=25)
@given(effects=subsets, random=st.randoms(use_true_random=False))
def test_the_order_of_listing_does_not_matter(effects: list[Effect], random: Random) -> None:
    shuffled = list(effects)
    random.shuffle(shuffled)
    one, other = (NeedleModel("m", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3, tuple(e)) for e in (effects, shuffled))
    assert one == other
    assert one.effects == tuple(sorted(effects, key=lambda e: (e.stage, e.name())))


@settings(max_examples=15)
@given(
    effects=subsets,
    turns=st.lists(st.tuples(st.floats(-90, 90), st.floats(0.2, 1.5)), min_size=2, max_size=4),
)
def test_resistive_effects_never_add_energy(effects: list[Effect], turns: list[tuple[float, float]]) -> None:
    resistive = tuple(e for e in effects if e.resistive)
    model = NeedleModel("null", EXPERIMENT_LAYOUT, 62.56e-6, 1e-3, resistive, element_length_m=5e-3)
    knots, at = [(0.0, 0.0)], 0.0
    for angle, lasting in turns:
        at += lasting
        knots.append((at, angle))
    trial = path(*knots, rate_hz=200)
    held_rad, _ = model.held_path(trial)
    torque_nm = model.truth(trial).torque_nm
    # a needle that starts without twist can never give back more than was put into it
    steps = 0.5 * (torque_nm[1:] + torque_nm[:-1]) * np.diff(held_rad)
    within = np.abs(np.diff(torque_nm) * np.diff(held_rad)).sum() / 2
    assert np.cumsum(steps).min() >= -1e-12 - 0.05 * within


def test_the_energy_test_can_fail(coarse: NeedleModel) -> None:
    # a needle that is driven by its tissue gives back more than was put in
    pushed = coarse.with_effects(
        make_effect("bending_torque", sine_nmm_per_100mm=-0.5, cosine_nmm_per_100mm=0.5)
    )
    trial = path((0, 0), (0.5, 0), (3, 90), rate_hz=200)
    torque_nm = pushed.truth(trial).torque_nm
    steps = 0.5 * (torque_nm[1:] + torque_nm[:-1]) * np.diff(trial.base_angle_rad)
    assert np.cumsum(steps).min() < -1e-6


def test_shapes_commute(coarse: NeedleModel) -> None:
    effects = [e.at_strength(1.0) for e in LIBRARY.values() if e.has("shape")]
    place = Trial(np.empty(0), np.empty(0), 10.0, 2, 5.0)
    forth = back = coarse.rod(place)
    for effect in effects:
        forth = effect.shape(forth, place)
    for effect in reversed(effects):
        back = effect.shape(back, place)
    for field in fields(forth):
        one, other = getattr(forth, field.name), getattr(back, field.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_allclose(one, other, rtol=1e-12, err_msg=field.name)


def test_a_place_in_the_series_is_all_that_shape_is_told(model: NeedleModel) -> None:
    seen = []

    class Nosy(TipFriction):
        def shape(self, rod: Rod, trial: Trial) -> Rod:
            seen.append(trial)
            return super().shape(rod, trial)

    replace(model, effects=(Nosy(0.01),)).rod(replace(SHORT, index=7))
    assert seen[0].index == 7
    assert seen[0].time_s.size == 0


def test_shape_is_asked_once_a_model_and_what_needs_the_trial_once_a_trial(
    effect: type[Effect], coarse: NeedleModel
) -> None:
    asked: Counter[str] = Counter()

    def counted(hook: str) -> Callable[[Effect, *tuple[Any, ...]], Any]:
        own = getattr(effect, hook)

        def call(self: Effect, *given: Any) -> Any:
            asked[hook] += 1
            return own(self, *given)

        return call

    hooks = [hook for hook in ("shape", "drive", "observe") if effect.has(hook)]
    watched: Any = type(effect.__name__, (effect,), {hook: counted(hook) for hook in hooks})
    watched.__module__ = effect.__module__
    trials = [bin_trial(trial) for trial in dataset().trials[:3]]
    model = replace(coarse, layout=dataset().layout, effects=(watched.at_strength(1.0),))
    Simulator().readings([model] * len(trials), trials, [0.9, 1.0, 1.1])
    once_a_trial = dict.fromkeys(("drive", "observe"), len(trials))
    # wear grows from trial to trial: it asks for the place in the series
    expected = {"shape": len(trials) if effect.name() == "friction_wear" else 1, **once_a_trial}
    assert dict(asked) == {hook: expected[hook] for hook in hooks}
