"""The sequence through slcan and serial in real time ends where it ends in virtual time."""

from __future__ import annotations

import asyncio

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.control.strategy import SettledMotion
from needle_rig.devices.hardware_rig import HardwareRig
from needle_rig.records import Phase
from needle_rig.simulation.bench import process as bench_module
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.run import run_virtual
from needle_rig.units import deg, rad
from tests.bench.ticking import Ticking

pytestmark = pytest.mark.usefixtures("steady")

CONFIG = load_rig_config(None, {"sequence.settle_s": 0.5})


def in_real_time(request: Request, nodes: str) -> tuple[SettledMotion, ...]:
    # A bench of its own: the shaft has to start relaxed at zero.
    bench = bench_module.start(load_rig_config(None, {"sequence.settle_s": 0.5, "simulation.nodes": nodes}))
    config = bench.configured(CONFIG)

    async def scenario() -> tuple[SettledMotion, ...]:
        rig, brain = HardwareRig(config), Brain(config)
        await rig.open()
        ticking = Ticking(rig, brain)
        try:
            await ticking.ready()
            brain.compensate(request)
            await ticking.until(lambda: brain.state.phase in (Phase.DONE, Phase.FAULT), timeout_s=60)
            assert brain.state.phase is Phase.DONE, brain.state.outcome
            return brain.settled
        finally:
            ticking.end()
            await rig.close()

    try:
        return asyncio.run(scenario())
    finally:
        bench.close()


@pytest.mark.parametrize(
    "nodes",
    [
        pytest.param("python", marks=pytest.mark.slow),
        pytest.param("firmware", marks=pytest.mark.slow),
        pytest.param("image", marks=pytest.mark.slow),
    ],
)
def test_real_time_and_virtual_time_agree_within_half_a_degree(nodes: str) -> None:
    request = Request(target_rad=rad(45))
    virtual = run_virtual(Brain(CONFIG), build_plant(CONFIG), request).settled
    real = in_real_time(request, nodes)
    assert [motion.name for motion in real] == [motion.name for motion in virtual]
    for seen, wanted in zip(real, virtual, strict=True):
        assert deg(seen.base_angle_rad) == pytest.approx(deg(wanted.base_angle_rad), abs=0.5)
        assert [deg(angle) for angle in seen.hall_rad] == pytest.approx(
            [deg(angle) for angle in wanted.hall_rad], abs=0.5
        )
    final = real[-1]
    assert deg(final.tip_lag_rad) == pytest.approx(12, abs=1)
