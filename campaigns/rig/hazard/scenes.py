"""What the host of a trial is asked to do while something breaks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.units import rad

Order = Callable[[Brain, int, float], None]
"""Asks a brain for something, one way (1, -1) and at a speed in °/s."""


@dataclass(frozen=True)
class Scene:
    """Orders, each given once the one before is done. `left_s` is how long a slow fault is looked at."""

    orders: tuple[Order, ...]
    left_s: float = 0.0


def _turns(steps_deg: Callable[[float], tuple[float, ...]], settle_s: float = 0.2) -> Order:
    def order(brain: Brain, direction: int, speed_deg_s: float) -> None:
        steps = tuple(direction * step for step in steps_deg(speed_deg_s))
        request = Request(
            0.0, "protocol", {"steps_deg": steps}, settle_s=settle_s, speed_rad_s=rad(speed_deg_s)
        )
        brain.compensate(request)

    return order


def _turn_to(angle_deg: float) -> Order:
    return _turns(lambda _: (angle_deg,))


def _to_and_fro(speed_deg_s: float) -> tuple[float, ...]:
    """Three motions of about a second each."""
    first = speed_deg_s * 0.8 + 3.0
    return (first, -0.5 * first, first)


def _hold(brain: Brain, direction: int, speed_deg_s: float) -> None:
    brain.hold()


SCENES = {
    "run": Scene((_turns(_to_and_fro),)),
    "hold": Scene((_hold,)),
    "long hold": Scene((_hold,), left_s=200.0),
    "settle 60 s": Scene((_turns(lambda _: (45.0, -20.0, 45.0), settle_s=60.0),), left_s=195.0),
    "three turns": Scene((_turns(lambda _: (90.0, -45.0, 180.0)),), left_s=60.0),
    "far": Scene((_turns(lambda _: (700.0,)),), left_s=45.0),
    "wind": Scene(tuple(_turn_to(angle) for angle in (240.0, 480.0, 719.0)), left_s=45.0),
}
SLOW = (
    ("long hold", 20.0, "encoder creeps 0.05°/s"),
    ("long hold", 20.0, "encoder creeps 0.1°/s"),
    ("long hold", 20.0, "encoder creeps 0.3°/s"),
    ("settle 60 s", 20.0, "encoder creeps 0.05°/s"),
    ("settle 60 s", 20.0, "encoder creeps 0.1°/s"),
    ("settle 60 s", 20.0, "encoder creeps 0.3°/s"),
    ("three turns", 20.0, "encoder fades to half in 20 s"),
    ("three turns", 20.0, "coupling slips by a tenth"),
    ("three turns", 20.0, "backlash grows 1°/s"),
    ("three turns", 20.0, "torque creeps 0.01 N·mm/s"),
    ("three turns", 20.0, "Hall angle creeps 0.3°/s"),
    ("far", 60.0, "encoder reads 1.05"),
    ("far", 60.0, "encoder reads 0.95"),
    ("far", 60.0, "encoder reads 0.9"),
    ("far", 60.0, "encoder reads 0.7"),
    ("far", 60.0, "encoder fades to half in 20 s"),
    ("wind", 60.0, "needle caught, tip held fast"),
)
"""Scene, speed and fault of the trials that last."""
