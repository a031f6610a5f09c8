"""A control chart over the runs of a rig: the two-sided CUSUM against a reference period.

With values x standardised by the mean x̄ and the standard deviation s of the first m,

    u = (x − x̄) / (s √(1 + 1/m)),
    S⁺ ← max(0, S⁺ + u − k),    S⁻ ← max(0, S⁻ − u − k),

and an alarm when either exceeds the decision interval h (Page, Biometrika 41, 1954; Montgomery, Introduction
to statistical quality control, ch. 9). u is winsorised, so that one run that went wrong is no change (Lucas
and Crosier, Technometrics 24, 1982). Since x̄ and s are estimates, h comes from a simulation of the whole
chart with its reference period, not from tables for known parameters (Jones, Champ, Rigdon, Technometrics 46,
2004).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from needle_rig.numerics import Array

ALLOWANCE = 1.0
"""k: half of the shift, in standard deviations, that is to be found soonest. It must exceed the error of the
mean of 20 runs, 0.6 at worst: with the tables' 0.5 h would be 19 for six charts, with 1.0 it is 6.3."""
FARTHEST = 3.0
"""Standardised values beyond this count as this: one run adds 2 at most, no run alone exceeds h."""
FALSE_ALARM_RATE = 1e-3
"""False alarms a run, of all charts of a rig together: one in a thousand runs."""
HORIZON = 100
"""Runs after the reference period over which that rate is kept."""
PATHS, SEED = 20_000, 1
"""Simulated charts that h is a quantile of: 20 000 leave ± 2 % of it."""
BACK = 3.0
"""How far beyond h a sum grows: of a rig that was mended it has fallen to 0 after about h + 3 runs."""


@dataclass(frozen=True)
class Shift:
    """A change that a chart shows at its end."""

    since: int
    """Place of the first value after it, as the sum dates it: where it left 0."""
    alarm: int
    """Place of the value that raised the alarm."""
    before: float
    """Mean of the reference period."""
    after: float
    """Mean since."""


def shift(values: Array, reference: int, least: float, charts: int, both_ways: bool = True) -> Shift | None:
    """The change that the last of `values` (n,) are in; None where they are in the reference period's range.

    The first `reference` values are the reference period. `least` is the size below which a change does not
    matter: the least standard deviation that is taken. `charts` are all that are looked at beside each other.
    """
    if len(values) <= reference:
        return None
    first, rest = values[:reference], values[reference:]
    spread = max(float(first.std(ddof=1)), least) * np.sqrt(1.0 + 1.0 / reference)
    standard = np.clip((rest - first.mean()) / spread, -FARTHEST, FARTHEST)
    limit = decision_interval(reference, charts)
    for side in (1.0, -1.0) if both_ways else (1.0,):
        total, since, alarm = 0.0, 0, -1
        for place, u in enumerate(side * standard):
            if total == 0.0:
                since = place
            total = min(max(0.0, total + float(u) - ALLOWANCE), limit + BACK)
            if total == 0.0:
                alarm = -1
            elif total > limit and alarm < 0:
                alarm = place
        if alarm >= 0:
            return Shift(
                reference + since, reference + alarm, float(first.mean()), float(rest[since:].mean())
            )
    return None


@lru_cache
def decision_interval(reference: int, charts: int) -> float:
    """h with which `charts` charts of a rig in control give FALSE_ALARM_RATE false alarms a run together.

    Normal values, as many in the reference period as `reference`; the charts share the rate (Bonferroni).
    """
    random = np.random.default_rng([SEED, reference])
    first = random.standard_normal((PATHS, reference))
    centre, spread = first.mean(axis=1), first.std(axis=1, ddof=1) * np.sqrt(1.0 + 1.0 / reference)
    up, down, most = np.zeros(PATHS), np.zeros(PATHS), np.zeros(PATHS)
    for _ in range(HORIZON):
        u = np.clip((random.standard_normal(PATHS) - centre) / spread, -FARTHEST, FARTHEST)
        up, down = np.maximum(0.0, up + u - ALLOWANCE), np.maximum(0.0, down - u - ALLOWANCE)
        most = np.maximum(most, np.maximum(up, down))
    any_false = 1.0 - (1.0 - FALSE_ALARM_RATE) ** HORIZON
    return float(np.quantile(most, 1.0 - any_false / charts))
