"""The solver's tangent, beside central differences of solutions."""

from dataclasses import replace

import numpy as np
import pytest

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.rod import Layout, Rod, build_rod
from needle_rig.physics.solution import Path, Sampled
from needle_rig.physics.solver import in_reach, solve_series
from needle_rig.units import rad
from tests.effects.common import LIBRARY

LAYOUT = Layout(0.25, ((0.05, 0.1), (0.13, 0.22)), (0.115, 0.24))
TIME_S = np.linspace(0.0, 6.0, 241)
BASE_RAD = rad(45.0) * np.interp(TIME_S, [0, 1, 2, 3, 4, 5, 6], [0, 1, 1, 0.3, 1.4, -0.5, 0.2])
PLACE = Trial(TIME_S, BASE_RAD)
PATH = Path.of(TIME_S, BASE_RAD)
MODEL = NeedleModel("null", LAYOUT, 6.2e-5, 1e-3, element_length_m=4e-3)
STEP = 1e-6
REACHED = {
    "tissue_elasticity",
    "layered_friction",
    "tip_friction",
    "platform_friction",
    "guide_friction",
    "mount_compliance",
    "chuck_compliance",
    "direction_asymmetry",
    "friction_wear",
    "insertion_depth",
}


def of(sampled: Sampled) -> Array:
    return np.column_stack([sampled.torque_nm / 1e-4, sampled.sensor_rad])


def changes(rod: Rod, up: Rod, down: Rod, factor_step: float = 0.0) -> tuple[Array, Array]:
    """What the tangent says that `up` changes, and half the difference of solutions of `up` and `down`."""
    more, less = (np.array([1.0 + sign * factor_step]) for sign in (1.0, -1.0))
    (here,), (near,) = solve_series(rod, [PATH], np.ones(1), near=[(up, more)])
    (high,), (low,) = (solve_series(r, [PATH], f)[0] for r, f in ((up, more), (down, less)))
    return of(near) - of(here), 0.5 * (of(high) - of(low))


def agree(tangent: Array, difference: Array) -> None:
    assert np.linalg.norm(difference) > 0.0
    assert np.linalg.norm(tangent - difference) < 2e-3 * np.linalg.norm(difference)


def typical(effect: type[Effect]) -> Rod:
    return MODEL.with_effects(effect.at_strength(1.0)).rod(PLACE)


@pytest.mark.parametrize("field", ["friction_n", "torsional_rigidity_nm2"])
@pytest.mark.parametrize("name", ["none", *sorted(REACHED)])
def test_along_friction_and_rigidity_it_is_what_differences_say(name: str, field: str) -> None:
    model = MODEL if name == "none" else MODEL.with_effects(LIBRARY[name].at_strength(1.0))
    up, down = (replace(model, **{field: getattr(model, field) * (1.0 + s)}) for s in (STEP, -STEP))
    agree(*changes(model.rod(PLACE), up.rod(PLACE), down.rod(PLACE)))


@pytest.mark.parametrize("name", sorted(REACHED - {"friction_wear"}))
def test_along_the_size_of_an_effect_it_is_what_differences_say(name: str) -> None:
    up, down = (MODEL.with_effects(LIBRARY[name].at_strength(1.0 + s)).rod(PLACE) for s in (STEP, -STEP))
    agree(*changes(typical(LIBRARY[name]), up, down))


def test_along_the_friction_of_a_trial_it_is_what_differences_say() -> None:
    rod = typical(LIBRARY["tip_friction"])
    agree(*changes(rod, rod, rod, factor_step=STEP))


def test_it_reaches_rods_that_depend_on_no_rate_and_no_others() -> None:
    shaping = {n: e for n, e in LIBRARY.items() if e.has("shape") or e.has("torque")}
    reached = {n for n, e in shaping.items() if in_reach(typical(e), typical(e))}
    assert reached == REACHED
    plain = MODEL.rod(PLACE)
    assert not in_reach(plain, build_rod(LAYOUT, 6.2e-5, 1e-3, 2e-3))
    assert not in_reach(plain, build_rod(LAYOUT, 6.2e-5, 0.0, 4e-3))


def test_neighbours_that_are_the_rod_itself_take_no_solve_of_their_own() -> None:
    rod = typical(LIBRARY["tissue_elasticity"])
    near = [(rod, np.ones(1))] * 4
    (alone,), *_ = solve_series(rod, [PATH], np.ones(1))
    (together,), *would = solve_series(rod, [PATH], np.ones(1), near=near)
    assert together.solves == alone.solves
    np.testing.assert_array_equal(of(together), of(alone))
    for (each,) in would:
        np.testing.assert_allclose(of(each), of(alone), atol=1e-15)
