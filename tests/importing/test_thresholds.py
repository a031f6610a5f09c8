"""The guess's thresholds lie between what needles show and what noise shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needle_rig.dataset import read_dataset
from needle_rig.importing import signals
from needle_rig.importing.guess.series import COMMON
from needle_rig.importing.guess.units import ROUND
from needle_rig.importing.signals import CLEAR_LAG, CLEAR_WORK

PRACTICE = Path(__file__).parents[2] / "tests/data/practice"
NOISE_RAD = np.radians(0.25)


@pytest.mark.parametrize("name", ["backlash", "bias", "elastic", "layers", "none", "two"])
def test_every_practice_needle_is_beyond_the_thresholds_and_a_copy_of_its_base_within(name: str) -> None:
    random = np.random.default_rng(1)
    for trial in read_dataset(PRACTICE / name).trials:
        time_s, base = trial.trial.time_s, trial.trial.base_angle_rad
        copy = base + random.normal(0.0, NOISE_RAD, len(base))
        assert abs(signals.lag_share(base, copy)) < CLEAR_LAG * 10
        assert signals.difference_share(time_s, copy, time_s, base) < COMMON
        for angle in trial.hall_rad.T:
            if np.isfinite(angle).mean() > 0.9:
                assert signals.lag_share(base, angle) > 20 * CLEAR_LAG
                assert signals.difference_share(time_s, angle, time_s, base) > 5 * COMMON
        torque = signals.from_rest(trial.torque_nm, signals.rest_before_motion(base))
        if np.isfinite(torque).mean() > 0.9:
            assert signals.work_share(base, torque) > 1.4 * CLEAR_WORK


def test_noise_alone_does_no_clear_work() -> None:
    random = np.random.default_rng(2)
    base = np.cumsum(np.full(1000, 0.001))
    shares = [abs(signals.work_share(base, random.normal(size=1000))) for _ in range(200)]
    assert np.quantile(shares, 0.98) < CLEAR_WORK


def test_levels_at_random_are_not_round() -> None:
    random = np.random.default_rng(3)
    found = [signals.roundness(random.uniform(-180, 180, 2)) >= ROUND for _ in range(4000)]
    assert np.mean(found) < 0.02
    assert signals.roundness(np.array([45.02, -30.0, 90.1])) >= ROUND


def test_far_levels_are_round_by_chance_and_near_ones_are_not() -> None:
    near, far = np.array([45.0, -30.0, 90.0]), np.array([565.5, 750.4, 611.7])
    assert signals.round_by_chance(near) < 0.001
    assert signals.roundness(far) == 1.0
    assert signals.round_by_chance(far) > 0.2
    assert signals.round_by_chance(np.empty(0)) == 1.0
