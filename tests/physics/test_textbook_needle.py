"""The solver beside a needle that shares no code with it; friction falls with the rate as in textbooks."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from needle_rig.physics.effect import Trial
from needle_rig.physics.solution import Solution
from needle_rig.physics.solver import solve
from tests.physics.rods import EXPERIMENT, JG, path, rod
from tests.physics.textbook_needle import TextbookNeedle, needle

RATE_RAD_S = 0.2
KINETIC_N = 0.0996e-2
NO_SLIP_LENGTH_RAD = np.radians(0.05)


def textbook(
    viscous: float, ratio: float = 1.0, exponent: float = 1.0, cell_m: float = 2.5e-3
) -> TextbookNeedle:
    """Damping in N·mm·s per 100 mm; `ratio` is kinetic over static friction."""
    made = needle(
        EXPERIMENT,
        JG,
        kinetic_n=KINETIC_N,
        kinetic_over_static=ratio,
        stribeck_rate_rad_s=RATE_RAD_S,
        exponent=exponent,
        damping_ns=viscous * 1e-2,
    )
    return replace(made, cell_m=cell_m)


def differences(ours: Solution, theirs: TextbookNeedle) -> tuple[float, float]:
    """Largest of angles in degrees and of torque in N·mm."""
    angle = np.abs(ours.sensor_rad - theirs.halls_rad).max()
    return float(np.degrees(angle)), float(np.abs(ours.torque_nm - theirs.torques_nm).max() * 1e3)


@pytest.mark.whole
def test_both_agree_where_friction_does_not_fall() -> None:
    time, base = path([45.0, 20.0], settle_s=0.5)
    found = solve(rod(viscous=0.05), time, base)
    angle_deg, torque_nmm = differences(found, textbook(0.05).moved(Trial(time, base)))
    assert angle_deg < 0.02
    assert torque_nmm < 2e-4


@pytest.mark.whole
def test_inertia_of_the_wire_changes_nothing_that_can_be_measured() -> None:
    time, base = path([8.0], settle_s=0.05)
    plain = textbook(0.06)
    heavy = replace(plain, friction=replace(plain.friction, inertia_kgm=6450 * np.pi * 0.39e-3**4 / 32))
    without, having = plain.moved(Trial(time, base)), heavy.moved(Trial(time, base))
    assert np.degrees(np.abs(without.halls_rad - having.halls_rad).max()) < 0.02


@pytest.mark.whole
@pytest.mark.parametrize("exponent", [1.0, 2.0])
def test_the_solver_follows_the_textbooks_law_where_damping_keeps_it_from_snapping(exponent: float) -> None:
    """The resistance rises with the rate all along: (υ_s − υ_k)/ω_s is 0.125 N·mm·s per 100 mm at most."""
    time, base = path([45.0], settle_s=0.5)
    theirs = textbook(0.2, 0.8, exponent).moved(Trial(time, base))
    law = {"static_excess": 0.25, "stribeck_rate_rad_s": RATE_RAD_S, "weakening_rad": NO_SLIP_LENGTH_RAD}
    ours = solve(rod(viscous=0.2, stribeck_exponent=exponent, **law), time, base)
    angle_deg, torque_nmm = differences(ours, theirs)
    assert angle_deg < 0.03
    assert torque_nmm < 2e-4
    other = solve(rod(viscous=0.2, stribeck_exponent=3.0 - exponent, **law), time, base)
    assert differences(other, theirs)[0] > 0.2


@pytest.mark.whole
def test_where_it_snaps_the_textbooks_law_has_no_answer_but_that_of_its_cells() -> None:
    """Why `stribeck` has a slip length: a front meets the static limit of one cell, however small that is."""
    time, base = path([45.0, 71.0, 25.0], settle_s=1.0)
    tips = [textbook(0.01, 0.5, cell_m=cell).moved(Trial(time, base)).halls_rad for cell in (5e-3, 2.5e-3)]
    assert np.degrees(np.abs(tips[0] - tips[1]).max()) > 1.0
    law: dict[str, Any] = {
        "static_excess": 1.0,
        "stribeck_rate_rad_s": RATE_RAD_S,
        "weakening_rad": 0.2,
        "viscous": 0.05,
    }
    ours = [solve(rod(element_length_m=cell, **law), time, base).sensor_rad for cell in (2e-3, 0.5e-3)]
    assert np.degrees(np.abs(ours[0] - ours[1]).max()) < 0.05
