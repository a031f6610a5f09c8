from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
from hypothesis import given
from hypothesis import strategies as st

from needle_rig.control.reports import Outcome
from needle_rig.control.strategies.reed2008 import Reed2008
from needle_rig.control.strategy import SettledMotion, Task
from needle_rig.control.verdict import judge, outcome
from needle_rig.model import EXPERIMENT_LAYOUT
from needle_rig.units import deg, rad


def verdict(
    base_deg: float, torque_nmm: float, halls_deg: Sequence[float], target_deg: float = 45.0
) -> Outcome:
    task = Task(rad(target_deg), EXPERIMENT_LAYOUT, 62.56e-6, 1.0, 3.0)
    base, halls = rad(base_deg), tuple(rad(angle) for angle in halls_deg)
    first = SettledMotion(1, "rotate", 0.0, 4.0, base, base, 1e-4, halls, 0.45, 0.3)
    last = SettledMotion(5, "final", 4.0, 9.0, base, base, torque_nmm * 1e-3, halls, 0.0, base - halls[-1])
    return judge(task, Reed2008(), (first, last), rad(5.0), 0.02e-3, "runs/1.h5")


def test_the_paper_s_final_state_without_its_torque_is_aligned() -> None:
    told = verdict(45.0, 0.015, (45.5, 44.0, 43.0, 42.0))
    assert told.status == "aligned"
    assert told.text == "aligned: base and tip are within 3.0° of 45°, 0.015 N·mm left"
    assert deg(told.mean_rad) == pytest.approx(43.625)
    assert deg(told.range_rad) == pytest.approx(3.5)
    assert deg(told.tip_lag_rad) == pytest.approx(3.0)
    assert told.lag_rad == 0.45


@pytest.mark.parametrize(
    ("base", "torque", "halls", "target", "unmet", "text"),
    [
        (45, 0.0, (36, 35, 34, 33), 45, {"8a", "8c"}, "not aligned: the tip lags 12°; the model behind"),
        (-45, 0.0, (-36, -35, -34, -33), -45, {"8a", "8c"}, "not aligned: the tip lags 12°; the model"),
        (45, 0.0, (50, 51, 51, 52), 45, {"8a", "8c"}, "not aligned: the tip leads 7°; the model"),
        (
            45,
            -0.021,
            (45, 45, 45, 45),
            45,
            {"8b"},
            "not aligned: 0.021 N·mm are left at the base, limit 0.02;",
        ),
        (71, 0.1, (52, 48, 46, 45), 45, {"8a", "8b", "8c"}, "the shaft is twisted by 26° and 0.100 N·mm are"),
        (45, 0.0, (52, 48, 46, 45), 45, {"8a"}, "the tip is there, but the shaft is twisted by 7°"),
        (50.5, 0.0, (50, 50, 50, 49), 45, {"8c"}, "the tip is there, but the shaft is twisted by 2°"),
    ],
)
def test_each_unmet_condition_is_told_with_its_size(
    base: float, torque: float, halls: tuple[float, ...], target: int, unmet: set[str], text: str
) -> None:
    told = verdict(base, torque, halls, target)
    assert told.status == "not_aligned"
    assert {condition.name for condition in told.conditions if not condition.met} == unmet
    assert text in told.text
    assert told.text.endswith("may lack an effect: needle-rig diagnose runs/1.h5")


def test_what_sits_exactly_on_a_limit_is_met() -> None:
    told = verdict(45.0, 0.0, (45.0, 45.0, 45.0, 45.0))
    spread, torque, place = told.conditions
    assert (spread.limit, place.limit) == (rad(5.0), rad(5.0))
    assert torque.limit == 0.02e-3
    assert verdict(45.0, 0.02, (45.0,) * 4).status == "aligned"


@given(st.floats(-90, 90), st.floats(-1, 1), st.lists(st.floats(-90, 90), min_size=4, max_size=4))
def test_the_verdict_is_all_three_conditions(base: float, torque: float, halls: list[float]) -> None:
    told = verdict(base, torque, halls)
    assert (told.status == "aligned") == all(condition.met for condition in told.conditions)
    for condition in told.conditions:
        assert condition.met == (abs(condition.value) <= condition.limit)


def test_an_end_before_anything_settled_has_no_numbers() -> None:
    task = Task(0.5, EXPERIMENT_LAYOUT, 62.56e-6, 1.0, 3.0)
    told = outcome("aborted", "aborted: enough", task, Reed2008(), ())
    assert (told.status, told.text, told.hall_rad, told.conditions) == ("aborted", "aborted: enough", (), ())
    assert all(math.isnan(x) for x in (told.base_angle_rad, told.torque_nm, told.tip_lag_rad, told.lag_rad))
