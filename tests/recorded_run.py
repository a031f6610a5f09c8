"""A recorded run to test with: the real brain against a needle that slips at its tip, in virtual time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.recording import RunWriter, run_attributes, run_tables, sample_row
from needle_rig.records import DriveState, Measurement, Phase

LAG_RAD = np.radians([19.6, 23.2, 25.3, 26.0])
"""Of the sensors behind the base while the whole needle slips, and the torque then."""
STIFFNESS_NM_PER_RAD = 0.0996e-3 / LAG_RAD[3]


class PlayNeedle:
    """The tip follows the base by at most its lag; the shaft between them is a spring."""

    def __init__(self) -> None:
        self.base_rad, self.sensor_rad, self.velocity_rad_s = 0.0, np.zeros(4), 0.0

    def turn(self, velocity_rad_s: float, dt_s: float) -> None:
        self.base_rad += velocity_rad_s * dt_s
        self.velocity_rad_s = velocity_rad_s
        tip_rad = np.clip(self.sensor_rad[3], self.base_rad - LAG_RAD[3], self.base_rad + LAG_RAD[3])
        self.sensor_rad = self.base_rad - LAG_RAD * (self.base_rad - tip_rad) / LAG_RAD[3]

    @property
    def torque_nm(self) -> float:
        return float(STIFFNESS_NM_PER_RAD * (self.base_rad - self.sensor_rad[3]))


def write_run(path: Path, *, target_deg: float = 45.0, pictures: bool = True, settle_s: float = 1.0) -> Path:
    """A whole run of reed2008 in `path`, with raw readings at 1 kHz."""
    config = load_rig_config(None, {"sequence.settle_s": settle_s})
    brain, needle, noise = Brain(config), PlayNeedle(), np.random.default_rng(1)
    along_m = np.array([0.0, 0.175, 0.22, 0.285, 0.35, 0.396])
    attributes = run_attributes(
        config, strategy="reed2008", target_deg=target_deg, parameters="rig_rigid", shaft_position_m=along_m
    )
    tables = run_tables(sensors=4, shaft_nodes=len(along_m) if pictures else 0)
    dt_s, raw_per_tick = 1.0 / config.tick_hz, 5
    ticks: list[Any] = []
    raw: dict[str, list[Any]] = {"torque": [], "hall": [], "drive": [], "shaft": []}
    time_s = 1000.0
    settled = 0
    with RunWriter(path, attributes, tables) as writer:
        while True:
            for step in range(raw_per_tick):
                needle.turn(needle.velocity_rad_s, dt_s / raw_per_tick)
                now_s = time_s + step * dt_s / raw_per_tick
                count = len(raw["torque"])
                torque_nm = needle.torque_nm + noise.normal(0.0, 0.8e-6)
                hall_rad = needle.sensor_rad + noise.normal(0.0, math.radians(0.25), 4)
                raw["torque"].append((now_s, now_s % 60, count, torque_nm))
                raw["hall"].append((now_s, now_s % 60, count, *hall_rad))
                raw["drive"].append((now_s, now_s % 60, count, needle.base_rad, 2, 0))
            entry_rad = needle.base_rad - 0.6 * (needle.base_rad - needle.sensor_rad[0])
            raw["shaft"].append((now_s, needle.base_rad, entry_rad, *needle.sensor_rad))
            measurement = Measurement(
                now_s, needle.base_rad, torque_nm, tuple(hall_rad), DriveState.RUNNING, torque_age_s=0.0,
                hall_age_s=0.0, drive_age_s=0.0,
            )  # fmt: skip
            if not ticks:
                brain.step(measurement, dt_s)
                brain.compensate(Request(math.radians(target_deg)))
            command, sample = brain.step(measurement, dt_s)
            ticks.append(sample_row(sample))
            needle.turn(command.velocity_rad_s if command.enable else 0.0, 0.0)
            if len(brain.state.settled) > settled:
                settled += 1
                motion = brain.state.settled[-1]
                writer.event(motion.time_s, "settled", motion.name)
            time_s += dt_s
            if sample.phase is Phase.DONE:
                break
        assert len(ticks) < 20_000
        writer.append("ticks", ticks)
        for name, rows in raw.items():
            if name in tables:
                writer.append(name, rows)
        assert brain.state.outcome is not None
        writer.close({"status": brain.state.outcome.status, "target_deg": target_deg}, time_s=time_s)
    return path
