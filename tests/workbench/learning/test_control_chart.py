"""The control chart alone: false alarms at the stated rate, changes within a stated number of runs."""

import numpy as np
import pytest

from needle_rig.workbench.learning.control_chart import (
    ALLOWANCE,
    FALSE_ALARM_RATE,
    FARTHEST,
    HORIZON,
    decision_interval,
    shift,
)

REFERENCE, CHARTS = 20, 6


def alarms(series: np.ndarray, charts: int = CHARTS) -> bool:
    """Whether the chart raises an alarm at any of the runs, as a watch after each of them."""
    return any(
        shift(series[:end], REFERENCE, 0.0, charts) is not None
        for end in range(REFERENCE + 1, len(series) + 1, 4)
    )


def test_runs_in_control_raise_alarms_at_most_at_the_stated_rate() -> None:
    random = np.random.default_rng(2026)
    series = random.normal(0.1, 0.003, (120, CHARTS, REFERENCE + HORIZON))
    rigs = sum(any(alarms(one) for one in charts) for charts in series)
    most = 1.0 - (1.0 - FALSE_ALARM_RATE) ** HORIZON
    # 120 rigs: three standard errors above the stated rate
    assert rigs / 120 <= most + 3.0 * np.sqrt(most * (1.0 - most) / 120)


@pytest.mark.parametrize(("reference", "charts"), [(10, 1), (20, 6), (50, 6)])
def test_the_decision_interval_is_above_what_one_run_can_add(reference: int, charts: int) -> None:
    assert decision_interval(reference, charts) > FARTHEST - ALLOWANCE


def test_more_charts_and_a_shorter_reference_period_ask_for_more() -> None:
    assert decision_interval(20, 1) < decision_interval(20, 6) < decision_interval(10, 6)


def test_one_run_that_went_wrong_is_no_change() -> None:
    values = np.random.default_rng(1).normal(0.1, 0.003, 40)
    values[30] = 5.0
    assert shift(values, REFERENCE, 0.0, CHARTS) is None


def test_a_shift_is_dated_and_sized() -> None:
    values = np.random.default_rng(3).normal(0.1, 0.003, 45)
    values[35:] += 0.012
    found = shift(values, REFERENCE, 0.0, CHARTS)
    assert found is not None
    assert abs(found.since - 35) <= 1
    assert found.alarm <= 39
    assert found.after - found.before == pytest.approx(0.012, abs=0.004)


def test_a_rig_that_was_mended_is_in_its_range_again() -> None:
    values = np.random.default_rng(4).normal(0.1, 0.003, 110)
    values[30:60] += 0.012
    assert shift(values[:60], REFERENCE, 0.0, CHARTS) is not None
    assert shift(values, REFERENCE, 0.0, CHARTS) is None


def test_a_change_that_does_not_matter_is_none_however_small_the_scatter() -> None:
    values = np.r_[np.random.default_rng(5).normal(1.0, 1e-6, 20), np.full(40, 1.004)]
    assert shift(values, REFERENCE, 0.0, CHARTS) is not None
    assert shift(values, REFERENCE, 0.02, CHARTS) is None


def test_a_series_within_its_reference_period_says_nothing() -> None:
    assert shift(np.arange(20.0), REFERENCE, 0.0, CHARTS) is None
