"""The paper's experiment on the simulated rig, from the first tick to the verdict."""

from __future__ import annotations

import itertools

import pytest

from needle_rig.config.schema import RigConfig
from needle_rig.control.reports import BrainState
from needle_rig.records import Sample
from needle_rig.units import deg, nmm
from tests.closed_loop.conftest import Align, simulation_of


def test_the_rigid_rig_lags_by_26_degrees_and_ends_aligned(align: Align) -> None:
    run = align("rig_rigid")
    assert deg(run.settled[0].tip_lag_rad) == pytest.approx(26.0, abs=0.5)
    assert abs(deg(run.outcome.tip_lag_rad)) <= 0.5
    assert run.outcome.status == "aligned"
    assert deg(run.outcome.lag_rad) == pytest.approx(26.0, abs=0.5)


def test_the_elastic_rig_lags_by_26_degrees_and_keeps_12(align: Align) -> None:
    run = align("rig_elastic")
    assert deg(run.settled[0].tip_lag_rad) == pytest.approx(26.0, abs=1.0)
    assert deg(run.outcome.tip_lag_rad) == pytest.approx(12.0, abs=1.0)
    assert run.outcome.status == "not_aligned"
    assert "the tip lags 12°" in run.outcome.text
    assert "needle-rig diagnose RUN" in run.outcome.text


def test_twelve_degrees_further_leave_between_3_and_6(align: Align) -> None:
    run = align("rig_elastic", "reed2008_elastic", options={"extra_deg": 12})
    assert 3.0 <= deg(run.outcome.tip_lag_rad) <= 6.0
    assert run.outcome.status == "aligned"


@pytest.mark.whole
def test_the_other_direction_is_the_mirror_image(align: Align) -> None:
    there = align("rig_elastic", noise=False)
    back = align("rig_elastic", target_deg=-45.0, noise=False)
    for a, b in zip(there.settled, back.settled, strict=True):
        assert deg(a.base_angle_rad) == pytest.approx(-deg(b.base_angle_rad), abs=0.05)
        assert nmm(a.torque_nm) == pytest.approx(-nmm(b.torque_nm), abs=1e-3)
    assert back.outcome.tip_lag_rad == pytest.approx(-there.outcome.tip_lag_rad, abs=0.002)
    assert "the tip lags 12°" in back.outcome.text


@pytest.mark.whole
def test_a_second_run_learns_its_extra_turn_from_the_first(config: RigConfig) -> None:
    from needle_rig.control.brain import Brain
    from needle_rig.control.reports import Request
    from needle_rig.model import load_parameters
    from needle_rig.simulation.plant import Plant
    from needle_rig.simulation.run import run_virtual
    from needle_rig.units import rad

    brain, left = Brain(config), list[float]()
    for strategy in ("reed2008", "reed2008_elastic", "reed2008_elastic"):
        plant = Plant(load_parameters("rig_elastic"), simulation_of(config))
        if left:  # another rig for the same brain: a person says where its base stands
            plant.advance(0.005)
            brain.step(plant.read(), 0.005)
            brain.home("here", 0.0)
        run = run_virtual(brain, plant, Request(rad(45.0), strategy))
        left.append(deg(run.outcome.tip_lag_rad))
    assert left[0] == pytest.approx(12.0, abs=1.0)
    assert left[1] == pytest.approx(4.9, abs=0.7)
    assert abs(left[2]) < left[1]


@pytest.mark.parametrize(
    ("gain", "delay_ms", "load_nmm"), list(itertools.product((0.7, 1.3), (0.0, 10.0), (-0.5, 0.5)))
)
def test_the_base_neither_overshoots_nor_stays_away_at_any_corner_of_the_drive(
    config: RigConfig, gain: float, delay_ms: float, load_nmm: float
) -> None:
    import random

    from needle_rig.control.brain import Brain
    from needle_rig.control.reports import Request
    from needle_rig.model import load_parameters
    from needle_rig.simulation.plant import Plant
    from needle_rig.simulation.run import run_virtual
    from needle_rig.units import nm, rad

    settings = simulation_of(config).model_copy(update={"drive_gain": gain, "drive_delay_ms": delay_ms})
    plant = Plant(load_parameters("rig_elastic"), settings, load_nm=nm(load_nmm))
    random_ticks = random.Random(7)
    ticks = (0.005 * random_ticks.uniform(0.7, 1.3) for _ in itertools.count())
    way: dict[str, list[tuple[float, float]]] = {}

    def follow(sample: Sample, state: BrainState) -> None:
        if state.waypoint_rad is not None:
            way.setdefault(sample.motion, []).append((deg(plant.motor.angle_rad), deg(state.waypoint_rad)))

    run = run_virtual(Brain(config), plant, Request(rad(45.0), settle_s=1.5), ticks=ticks, on_tick=follow)
    assert len(run.settled) == 5
    for path in way.values():
        direction = 1.0 if path[0][0] < path[0][1] else -1.0
        assert max((angle - target) * direction for angle, target in path) <= 0.1
    for motion in run.settled:
        assert abs(deg(motion.base_angle_rad - motion.waypoint_rad)) <= 0.1
