"""Times one tick of the brain at 1 kHz for `bench tick`: `KIND TIMES` in, seconds and a digest out.

The readings are recorded once, from a base that does what is ordered; then a new brain judges them again and
again, so that the time is the brain's alone. The digest is of everything that it told the drive.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import sys
import time
from collections.abc import Callable

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.records import Command, DriveFault, DriveState, Measurement
from needle_rig.units import nm, rad

TICK_S = 0.001
TICKS = 4000
CONFIG = load_rig_config(None, {"tick_hz": 1000})
SPRING_NM_RAD = nm(0.1007) / rad(26.0)
SHARES = (19.6 / 26.0, 23.2 / 26.0, 25.3 / 26.0, 1.0)
"""Of the twist between base and tip, up to each Hall sensor: the shipped rig's."""
KINDS: dict[str, Callable[[Brain], object]] = {
    "at rest": lambda brain: None,
    "moving": lambda brain: brain.compensate(
        Request(0.0, "protocol", {"steps_deg": (30.0, -10.0, 30.0)}, settle_s=0.2, speed_rad_s=rad(45.0))
    ),
    "holding": lambda brain: brain.hold(),
}


def recorded(start: Callable[[Brain], object]) -> list[Measurement]:
    """The readings of a run; the needle is a spring whose clutch slips."""
    brain, command = Brain(CONFIG), Command()
    base_rad = tip_rad = 0.0
    readings = []
    for tick in range(TICKS):
        base_rad += command.velocity_rad_s * TICK_S if command.enable else 0.0
        tip_rad = base_rad - min(max(base_rad - tip_rad, -rad(26.0)), rad(26.0))
        twist_rad = base_rad - tip_rad
        ages_s = (TICK_S, TICK_S, TICK_S)
        reading = Measurement(
            tick * TICK_S,
            base_rad,
            SPRING_NM_RAD * twist_rad,
            tuple(base_rad - share * twist_rad for share in SHARES),
            DriveState.READY,
            DriveFault.NONE,
            *ages_s,
        )
        readings.append(dataclasses.replace(reading))
        if tick == 10:
            start(brain)
        command, _ = brain.step(reading, TICK_S)
    return readings


def replayed(readings: list[Measurement], start: Callable[[Brain], object]) -> tuple[float, str]:
    """Seconds a tick of processor time, and the digest of what the drive was told."""
    brain, told = Brain(CONFIG), []
    started_s = time.process_time()
    for tick, reading in enumerate(readings):
        if tick == 10:
            start(brain)
        told.append(brain.step(reading, TICK_S)[0])
    spent_s = time.process_time() - started_s
    text = repr([(command.velocity_rad_s, command.enable, command.clear) for command in told])
    return spent_s / len(readings), hashlib.sha256(text.encode()).hexdigest()


def main() -> None:
    readings = {kind: recorded(start) for kind, start in KINDS.items()}
    for line in sys.stdin:
        kind, _, times = line.strip().rpartition(" ")
        runs = [replayed(readings[kind], KINDS[kind]) for _ in range(int(times))]
        print(json.dumps([min(spent_s for spent_s, _ in runs), runs[0][1]]), flush=True)


if __name__ == "__main__":
    main()
