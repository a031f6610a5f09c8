"""Every latching fault stays and is told, beside whatever else, until a person clears it."""

from __future__ import annotations

from collections.abc import Collection

import pytest

from needle_rig.control.faults import Fault, FaultName
from needle_rig.control.standing import StandingFaults
from needle_rig.records import DriveFault

STOPPED = Fault(FaultName.EMERGENCY_STOP, "drive", "stopped", latching=True)
ENCODER = Fault(FaultName.DRIVE, "drive", "encoder", latching=True, bit=DriveFault.ENCODER)
HEARTBEAT = Fault(FaultName.DRIVE, "drive", "heartbeat", latching=True, bit=DriveFault.HEARTBEAT)
LOST = Fault(FaultName.REFERENCE_LOST, "drive", "lost", latching=True)
DEAD = Fault(FaultName.LINK_DEAD, "hall", "dead", latching=False)
LATE = Fault(FaultName.LATE_TICK, "control", "late", latching=False)


def standing(*ticks: list[Fault]) -> StandingFaults:
    faults = StandingFaults()
    for found in ticks:
        faults.take(found)
    return faults


@pytest.mark.parametrize(
    ("ticks", "all_of_them", "latched"),
    [
        ([], (), False),
        ([[DEAD]], (DEAD,), False),
        ([[DEAD], []], (), False),
        ([[DEAD, LATE]], (DEAD,), False),
        ([[STOPPED], []], (STOPPED,), True),
        ([[DEAD, STOPPED], [DEAD]], (STOPPED, DEAD), True),
        ([[STOPPED], [ENCODER], [STOPPED]], (STOPPED, ENCODER), True),
        ([[ENCODER], [ENCODER, HEARTBEAT], []], (ENCODER, HEARTBEAT), True),
    ],
)
def test_what_latches_stays_and_what_passes_goes(
    ticks: list[list[Fault]], all_of_them: tuple[Fault, ...], latched: bool
) -> None:
    faults = standing(*ticks)
    assert faults.all == all_of_them
    assert (faults.latched, bool(faults)) == (latched, bool(all_of_them))
    assert faults.first == (all_of_them[0] if all_of_them else None)
    assert faults.text == " Also: ".join(fault.text for fault in all_of_them)


def test_the_first_words_of_a_fault_stay() -> None:
    later = Fault(FaultName.EMERGENCY_STOP, "drive", "stopped again", latching=True)
    assert standing([STOPPED], [later]).text == "stopped"


@pytest.mark.parametrize(
    ("some", "text"),
    [
        ({STOPPED}, DEAD.text),
        ({DEAD}, STOPPED.text),
        ((), f"{STOPPED.text} Also: {DEAD.text}"),
        ({STOPPED, DEAD}, ""),
    ],
)
def test_what_stands_beside_some_faults(some: Collection[Fault], text: str) -> None:
    assert standing([STOPPED, DEAD]).beside(some) == text


def test_what_is_settled_goes_and_the_others_stay() -> None:
    faults = standing([STOPPED, LOST])
    faults.settle({LOST})
    assert faults.all == (STOPPED,)


def test_a_person_s_clear_takes_all_of_them() -> None:
    faults = standing([STOPPED, DEAD])
    faults.clear()
    assert (faults.all, faults.text, faults.latched, bool(faults)) == ((), "", False, False)
