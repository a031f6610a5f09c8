from typing import Any

import numpy as np

from needle_rig.physics.effect import Trial
from needle_rig.physics.trial_variables import clock_s, direction, rate_rad_s, stop_time_s, travel_rad

TIME_S = np.arange(0.0, 6.0, 0.02)
BASE_RAD = np.interp(TIME_S, [0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 0.5, 0.5, 0.2])
TRIAL = Trial(TIME_S, BASE_RAD, start_s=100.0)
STILL = Trial(TIME_S, np.zeros_like(TIME_S))


def at(values: Any, time_s: Any) -> Any:
    return float(values[round(time_s / 0.02)])


def test_the_rate_is_that_of_the_base() -> None:
    rate = rate_rad_s(TRIAL)
    assert at(rate, 0.5) == 0.0
    assert abs(at(rate, 1.5) - 0.5) < 1e-9
    assert abs(at(rate, 3.5) + 0.3) < 1e-9


def test_travel_adds_up_both_ways() -> None:
    assert abs(at(travel_rad(TRIAL), 2.5) - 0.5) < 1e-9
    assert abs(at(travel_rad(TRIAL), 5.0) - 0.8) < 1e-9


def test_the_time_since_the_stop_begins_anew_with_each_motion() -> None:
    stopped = stop_time_s(TRIAL)
    assert at(stopped, 1.5) == 0.0
    assert abs(at(stopped, 2.8) - 0.8) < 0.03
    assert at(stopped, 3.5) == 0.0
    assert abs(at(stopped, 5.0) - 1.0) < 0.03


def test_the_direction_stays_that_of_the_last_motion() -> None:
    way = direction(TRIAL)
    assert [at(way, t) for t in (0.5, 1.5, 2.5, 3.5, 5.0)] == [0.0, 1.0, 1.0, -1.0, -1.0]


def test_the_clock_goes_on_from_the_start_of_the_trial() -> None:
    assert at(clock_s(TRIAL), 3.0) == 103.0


def test_a_base_that_never_moves_has_no_direction_and_no_travel() -> None:
    assert not direction(STILL).any()
    assert not travel_rad(STILL).any()
    assert at(stop_time_s(STILL), 3.0) == 3.0


def test_a_single_sample_has_no_rate() -> None:
    assert rate_rad_s(Trial(np.zeros(1), np.ones(1))) == 0.0
