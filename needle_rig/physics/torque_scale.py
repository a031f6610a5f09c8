"""How large the torques of a shaft are beside those of the needle that the library's numbers were made for.

Mechanics of a shaft is homogeneous in its torques: stiffness, friction and loads that are all k times as
large give the same angles. So every number of the library that has a unit with torque in it (bounds, typical
sizes, sizes that matter, accuracy) is taken times k to the power with which torque enters that unit. k is a
power of ten, and 1 for whatever the needle's numbers can serve as they are.
"""

from __future__ import annotations

import math
import re
from functools import cache

TORQUE_SPAN_NM = 2e-4
"""Span of the base torque of the needle in the experiment: ±0.1 N·mm."""
RIGIDITY_NM2 = 62.56e-6
"""Of that needle."""
AS_THE_NEEDLE = math.sqrt(1000.0)
"""Factor on either side within which a shaft is taken as a needle: bounds reach 50 times the typical size."""
LEAST_OF_RIGIDITY, MOST_OF_RIGIDITY = 0.2, 10.0
"""The torque's ratio lies between these times that of the rigidity: a cell that is all noise makes no machine
of a needle, and bounds of rigidity hold the shaft's own."""

_TORQUE = re.compile(r"(m|µ|u|k)?N·(m|c)?m")


def torque_scale(span_nm: float, rigidity_nm2: float | None) -> float:
    """How large a shaft's torques are over the needle's: a power of ten, without unit.

    `span_nm` is the span of its base torque, 0 where that is not measured.
    """
    ratio = span_nm / TORQUE_SPAN_NM
    if rigidity_nm2 is not None:
        stiff = rigidity_nm2 / RIGIDITY_NM2
        within = min(max(ratio, LEAST_OF_RIGIDITY * stiff), MOST_OF_RIGIDITY * stiff)
        ratio = within if span_nm > 0.0 else stiff
    if not (math.isfinite(ratio) and ratio > 0.0) or 1.0 / AS_THE_NEEDLE <= ratio <= AS_THE_NEEDLE:
        return 1.0
    return float(10.0 ** round(math.log10(ratio)))


@cache
def torque_power(unit: str) -> int:
    """The power with which torque enters a unit as parameters have it: N·mm/rad 1, 1/(N·mm)² −2, ° 0.

    A moment of inertia counts as a torque: it gives one at the same acceleration.
    """
    if unit == "g·cm²":
        return 1
    above, _, below = unit.partition("/")
    power = len(_TORQUE.findall(above))
    for part in re.split(r"/| per ", below):
        squared = re.search(r"\(([^)]*)\)²", part)
        power -= 2 if squared and _TORQUE.search(squared[1]) else len(_TORQUE.findall(part))
    return power
