"""Jog, hold, release and home on a whole simulated rig, and a zero that is lost and found."""

from __future__ import annotations

from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.errors import RigFault
from needle_rig.records import STOP, Command, DriveState, Phase
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.firmware_rig import FirmwareRig
from needle_rig.units import deg, rad

TICK_S = 0.005
OVER = (Phase.DONE, Phase.FAULT, Phase.ABORTED)


class Loop:
    """Brain and rig, tick by tick."""

    def __init__(self, kind: str) -> None:
        config = load_rig_config(None, {"simulation.nodes": "python" if kind == "plant" else kind})
        plant = build_plant(config)
        self.rig: Any = plant if kind == "plant" else FirmwareRig(config, plant)
        self.brain = Brain(config)
        self.command: Command = STOP
        self.run(0.2)

    def run(self, seconds: float, *phases: Phase) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.rig.advance(TICK_S)
            self.command, sample = self.brain.step(self.rig.read(), TICK_S)
            self.rig.write(self.command)
            if sample.phase in phases:
                return
        assert not phases, f"still {self.brain.state.phase}"

    @property
    def true_deg(self) -> float:
        return float(deg(self.rig.true_base_rad))

    def turn_by_hand(self, by_deg: float, seconds: float) -> None:
        ticks = round(seconds / TICK_S)
        for _ in range(ticks):
            if isinstance(self.rig, FirmwareRig):
                self.rig.hand_rad_s = rad(by_deg) / seconds
                self.run(TICK_S)
                self.rig.hand_rad_s = 0.0
            else:
                self.rig.turn_by_hand(rad(by_deg) / ticks / TICK_S, TICK_S)
                self.command, _ = self.brain.step(self.rig.read(), TICK_S)
                self.rig.write(self.command)


@pytest.fixture(
    params=[
        "plant",
        pytest.param("python", marks=pytest.mark.whole),
        pytest.param("firmware", marks=pytest.mark.whole),
    ]
)
def loop(request: pytest.FixtureRequest) -> Loop:
    return Loop(request.param)


def test_jog_hold_release_a_hand_and_home(loop: Loop) -> None:
    loop.brain.jog(by_rad=rad(30.0))
    loop.run(10.0, *OVER)
    assert loop.true_deg == pytest.approx(30.0, abs=0.15)
    loop.brain.hold()
    loop.run(5.0)
    assert loop.brain.state.phase is Phase.HOLDING
    assert loop.true_deg == pytest.approx(30.0, abs=0.15)
    loop.brain.release()
    loop.run(0.3)
    assert (loop.brain.state.fault, loop.brain.state.released) == (None, True)
    now = loop.rig.read()
    assert (now.drive_state, now.supply_on) == (DriveState.SILENT, False)
    loop.turn_by_hand(-50.0, 1.0)
    assert loop.brain.state.fault is None
    # a motor follows with a time constant of 10 ms, here 0.5°
    assert loop.true_deg == pytest.approx(-19.5, abs=0.2)
    loop.brain.home()
    loop.run(10.0, *OVER)
    assert loop.brain.state.fault is None
    assert loop.true_deg == pytest.approx(0.0, abs=0.15)


@pytest.mark.parametrize("by", ["hall", "here", "index"])
def test_a_zero_that_a_reset_lost_is_found_again(loop: Loop, by: str) -> None:
    loop.brain.compensate(Request(rad(45.0), "none", settle_s=0.5))
    loop.run(1.2)
    loop.rig.reset_drive()
    loop.run(2.0)
    lost_deg = loop.true_deg
    assert loop.brain.state.fault_name == "reference_lost"
    loop.brain.clear()
    loop.run(0.5)
    with pytest.raises(RigFault, match="find it again"):
        loop.brain.compensate(Request(rad(45.0), "none"))
    if by == "here":
        loop.brain.home("here", rad(lost_deg))
    else:
        loop.brain.home(by)
    loop.run(60.0 if by == "index" else 1.0, *(OVER if by == "index" else ()))
    loop.run(0.5)
    assert loop.brain.state.fault is None
    assert deg(loop.rig.read().base_angle_rad) == pytest.approx(loop.true_deg, abs=2.5)
    loop.brain.compensate(Request(rad(45.0), "none", settle_s=0.5))
    loop.run(20.0, *OVER)
    assert loop.true_deg == pytest.approx(45.0, abs=2.5)
