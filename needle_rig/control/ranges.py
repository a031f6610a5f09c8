"""How slow, how long and how many: what requests, options and strategies may ask of the rig."""

from __future__ import annotations

import numbers
from typing import Any

from needle_rig.errors import BadInput
from needle_rig.units import deg, rad

SLOWEST_DEG_S = 0.1
"""At a slower speed a turn over the whole range would last longer than four hours."""
SLOWEST_RAD_S = rad(SLOWEST_DEG_S)
FASTEST_DEG_S = 360.0
SETTLE_S = (0.1, 600.0)
MOST_MOTIONS = 200
"""Of one sequence: far more than any alignment takes, and as many steps as an order may list."""
MOST_DEG = 3600.0
"""The largest drive.angle_limit_deg that a rig file may set."""


def speed_fault(speed_rad_s: float, limit_rad_s: float) -> str | None:
    """What is wrong with a speed under the drive's limit, as a clause; None when nothing is."""
    if SLOWEST_RAD_S <= speed_rad_s <= limit_rad_s:
        return None
    return (
        f"the speed {deg(speed_rad_s):g}°/s is outside {SLOWEST_DEG_S:g} to"
        f" {deg(limit_rad_s):g}°/s (drive.velocity_limit_deg_s)"
    )


def settle_fault(settle_s: float) -> str | None:
    """What is wrong with a settling time, as a clause; None when nothing is."""
    if SETTLE_S[0] <= settle_s <= SETTLE_S[1]:
        return None
    return f"the settling time {settle_s} s is outside {SETTLE_S[0]:g} to {SETTLE_S[1]:g} s"


def is_number(value: Any) -> bool:
    """Whether it is a number, also one of NumPy's; True is none."""
    return not isinstance(value, bool) and isinstance(value, numbers.Real)


def check_option(name: str, value: Any) -> None:
    """Refuse what no option of that name can be, by the unit in its name; raises BadInput.

    Speeds and times among them must let the run end.
    """
    low, high = _option_range(name)
    if isinstance(value, list | tuple) and len(value) > MOST_MOTIONS:
        raise BadInput(f"option {name} has {len(value)} values; give up to {MOST_MOTIONS}")
    for one in value if isinstance(value, list | tuple) else [value]:
        if one is None or (one is value and isinstance(one, bool)):
            continue
        if not is_number(one):
            raise BadInput(f"option {name} is {one!r:.60}; give a number")
        if not low <= one <= high:
            raise BadInput(f"option {name} is {one!s:.60}; give {low:g} to {high:g}")


def _option_range(name: str) -> tuple[float, float]:
    if name.endswith("_deg_s"):
        return SLOWEST_DEG_S, FASTEST_DEG_S
    if name.endswith("_s"):
        return SETTLE_S
    return -MOST_DEG, MOST_DEG
