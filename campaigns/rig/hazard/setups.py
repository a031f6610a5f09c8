"""The rigs that are broken: which drive, how often the host looks, and how old the drive's answers are."""

from __future__ import annotations

from dataclasses import dataclass

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig

SPEEDS_DEG_S = (2.0, 20.0, 60.0)
DISAGREEMENT_DEG = 15.0
"""Encoder, torque and Hall angles may be so far apart before the host calls it a fault: 8° + 5 % of a turn of
60° + half of the largest twist before the first Hall sensor (docs/safety.md)."""
BOUND_DEG = 5.0
"""No single fault may turn the base further than this beyond what was commanded, or asked."""
PAIR_BOUND_DEG = 15.0
FOLLOWING_DEG, RESPONSE_S = 1.5, 0.06
"""Shipped `drive.following_deg` and `drive.response_ms`."""
MOTOR_S = 0.012
"""Dead time and lag of the simulated motor."""
BRAKING_DEG_S2 = 2000.0
"""Quick stop of the simulated CiA 402 drive."""
SETTINGS: dict[str, object] = {
    "simulation.nodes": "firmware",
    "links.torque_age_limit_ms": 50.0,
    "links.hall_age_limit_ms": 50.0,
    "sequence.settle_s": 0.2,
    "sequence.torque_window_s": 0.1,
    "drive.velocity_limit_deg_s": 60.0,
}


@dataclass(frozen=True)
class Setup:
    """One rig: `late_ms` is how long the drive's answers are on their way, `bundle_ms` how often the host's
    adapter hands over what has come (an FTDI chip: every 16 ms)."""

    name: str
    drive: str
    """`own` is this project's node, `cia402` a drive of another make."""
    tick_ms: int
    jitter_ms: int = 0
    late_ms: int = 0
    bundle_ms: int = 1
    age_limit_ms: float = 50.0

    def config(self, seed: int) -> RigConfig:
        """Its rig file."""
        changes = {
            **SETTINGS,
            "simulation.seed": seed,
            "tick_hz": 1000.0 / self.tick_ms,
            "links.drive_age_limit_ms": self.age_limit_ms,
        }
        return load_rig_config(None, changes)

    @property
    def oldest_s(self) -> float:
        """How old an answer may be before the host calls its link dead or itself blind."""
        return min(self.age_limit_ms, 100.0) * 1e-3

    def bound_deg(self, speed_deg_s: float, turns_deg_s: float, *, lies_by_little: bool) -> float:
        """How far one fault may take the base, moved at `speed_deg_s`, when the motor turns at `turns_deg_s`.

        The own node has a guard of motion. A drive of another make is watched by the host alone: until it
        stops, the motor turns through the following error that the host allows, and through v times the
        answer's age, a tick to look, a tick until the drive acts, the motor's lag, and the drive's braking.
        """
        bound_deg = BOUND_DEG
        if self.drive == "cia402":
            unseen_s = self.oldest_s + 2e-3 * (self.tick_ms + self.jitter_ms) + MOTOR_S
            braking_deg = turns_deg_s**2 / (2.0 * BRAKING_DEG_S2)
            allowed_deg = FOLLOWING_DEG + RESPONSE_S * speed_deg_s
            bound_deg = max(bound_deg, allowed_deg + turns_deg_s * unseen_s + braking_deg)
        return max(bound_deg, DISAGREEMENT_DEG) if lies_by_little else bound_deg


def _setups() -> dict[str, Setup]:
    ticks = (("50Hz", 20, 1), ("200Hz", 5, 0), ("1000Hz", 1, 0))
    # own: an answer is as old as its way. CiA 402: one SYNC waits for the answer to the last, so an age grows
    # to twice the way and some milliseconds.
    ways = {
        "own": (("fresh", 0, 50.0), ("near50ms", 45, 50.0), ("near100ms", 95, 250.0)),
        "cia402": (("fresh", 0, 50.0), ("near50ms", 22, 50.0), ("near100ms", 40, 250.0)),
    }
    made = [
        Setup(f"{drive}-{hz}-{way}", drive, tick, jitter, late, age_limit_ms=limit)
        for drive, found in ways.items()
        for way, late, limit in found
        for hz, tick, jitter in ticks
    ]
    made.append(Setup("cia402-200Hz-ftdi", "cia402", 5, bundle_ms=16))
    return {setup.name: setup for setup in made}


SETUPS = _setups()
