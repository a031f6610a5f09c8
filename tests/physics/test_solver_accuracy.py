"""Default settings against runs with finer samples, steps and cells, for every kind of coefficient."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from needle_rig.physics.reference import KarnoppRod, largest_stable_step_s, paper_literal, simulate
from needle_rig.physics.rod import Rod, TorqueLaw
from needle_rig.physics.solver import solve
from tests.physics.rods import EXPERIMENT, JG, MODEL, compensation, errors, lumped, path, refined, rod

WORST_DEG = 0.02
WORST_NMM = 2e-4


def one_sided(**options: Any) -> Rod:
    plain = rod(**options)
    return replace(plain, slip_plus_nm=1.3 * plain.slip_plus_nm)


def layered(**options: Any) -> Rod:
    plain = rod(**options)
    factor = np.array([0.5, 1.5, 0.2, 1.8, 0.0])[plain.section]
    return replace(
        plain, slip_plus_nm=factor * plain.slip_plus_nm, slip_minus_nm=factor * plain.slip_minus_nm
    )


def bend(
    parameters: np.ndarray, angle_rad: float, rate_rad_s: float, time_s: float, position_m: float
) -> float:
    return float(parameters[0] * np.sin(angle_rad - parameters[1]))


def bent(steady: bool = False, **options: Any) -> Rod:
    plain = rod(**options)
    law = TorqueLaw(bend, np.array([0.03e-2, 0.5]), plain.tissue_length_m, steady)
    return replace(plain, laws=(law,))


DAMPINGS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 2.8)
CASES: dict[str, Callable[..., Rod]] = (
    {"null": rod, "elastic": lambda **o: rod(stiffness=0.278, **o)}
    | {f"viscous {b}": partial(rod, viscous=b) for b in DAMPINGS}
    | {f"viscous {b}, elastic": partial(rod, viscous=b, stiffness=0.278) for b in DAMPINGS}
    | {
        "kelvin-voigt": lambda **o: rod(creep=(0.3, 1.0), **o),
        "standard solid": lambda **o: rod(stiffness=0.5, creep=(0.3, 1.0), **o),
        "maxwell": lambda **o: rod(stiffness=0.5, creep=(0.0, 3.0), **o),
        # a limit that falls faster with slip than the needle unloads snaps, and a snap has no time of its own
        "stribeck": lambda **o: rod(static_excess=0.3, stribeck_rate_rad_s=0.2, weakening_rad=0.2, **o),
        "stribeck, elastic": lambda **o: rod(static_excess=0.3, stiffness=0.278, weakening_rad=0.2, **o),
        "stribeck, viscous": lambda **o: rod(static_excess=0.3, viscous=0.05, weakening_rad=0.03, **o),
        "stribeck, as the effect is": lambda **o: rod(
            static_excess=0.3, stribeck_rate_rad_s=np.radians(6.0), weakening_rad=np.radians(8.0), **o
        ),
        "ageing": lambda **o: rod(ageing_per_decade=0.1, weakening_rad=0.03, **o),
        "ageing, as the effect is": lambda **o: rod(ageing_per_decade=0.2, weakening_rad=0.02, **o),
        "ageing, elastic": lambda **o: rod(ageing_per_decade=0.1, stiffness=0.278, weakening_rad=0.03, **o),
        "soft chuck": lambda **o: rod(base_compliance_rad_per_nm=1 / 0.256e-3, **o),
        "tip": lambda **o: lumped("tip", 0.02, **o),
        "platforms": lambda **o: lumped("sensors", 0.004, **o),
        "guide": lambda **o: lumped("entry", 0.02, **o),
        "one-sided": one_sided,
        "layered": layered,
        "bending": bent,
        "bending, known to be steady": lambda **o: bent(steady=True, **o),
        "bending, viscous": lambda **o: bent(viscous=0.2, **o),
    }
)


@pytest.mark.parametrize("finer", [4, pytest.param(16, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", CASES)
def test_default_settings_meet_a_much_finer_run(name: str, finer: int) -> None:
    make = CASES[name]
    time, base = path(compensation())
    fine = refined(time, base, finer)
    exact = solve(make(element_length_m=0.5e-3 / finer), *fine, tolerance_rad=1e-5)
    angle_deg, torque_nmm = errors(solve(make(), time, base), exact, finer)
    assert angle_deg < WORST_DEG
    assert torque_nmm < WORST_NMM


def test_torque_is_right_in_a_needle_far_stiffer_than_the_tissue() -> None:
    """Angles hardly differ there while torques do."""
    time, base = path([10.0, -5.0], settle_s=1.0)
    plain = rod(creep=(0.3, 1.0))
    stiff = replace(plain, stiffness_nm_per_rad=100.0 * plain.stiffness_nm_per_rad)
    exact = solve(stiff, time, base, tolerance_rad=1e-7)
    found = solve(stiff, time, base)
    assert np.abs(found.torque_nm - exact.torque_nm).max() * 1e3 < WORST_NMM


@pytest.mark.whole
@pytest.mark.parametrize("inertia", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_the_papers_explicit_scheme_agrees(inertia: bool) -> None:
    """An independent implementation: Karnopp friction with static = kinetic, explicit steps."""
    viscous = 0.06
    disks = KarnoppRod(EXPERIMENT, JG, 0.0996e-2, 0.0996e-2, viscous * 1e-2, 1e-9)
    if inertia:
        disks = replace(disks, inertia_kgm=6450 * np.pi * 0.39e-3**4 / 32)
        assert largest_stable_step_s(disks) == pytest.approx(2.4e-7, rel=0.02)
    time, base = path([8.0], settle_s=0.05) if inertia else path([30.0, 15.0], settle_s=0.1)
    explicit = simulate(disks, time, base, 0.8 * largest_stable_step_s(disks) if inertia else 1e-6)
    ours = solve(rod(viscous=viscous), time, base)
    assert np.degrees(np.abs(ours.sensor_rad - explicit.sensor_rad).max()) < WORST_DEG
    assert np.abs(ours.torque_nm - explicit.torque_nm).max() * 1e3 < WORST_NMM


@pytest.mark.whole
def test_the_papers_literal_law_depends_on_an_unstated_velocity_band() -> None:
    """No kinetic level: inside the band the 0.45 N·mm hold the tip at 0°, below it the tip nearly follows."""
    assert largest_stable_step_s(paper_literal(MODEL)) == pytest.approx(5.6e-5, rel=0.01)
    time, base = path([45.0], settle_s=20.0)
    tips = [
        np.degrees(simulate(paper_literal(MODEL, band), time, base, 5e-5).tip_rad[-1]) for band in (1e-3, 1.0)
    ]
    assert tips[0] > 30.0
    assert tips[1] == 0.0
