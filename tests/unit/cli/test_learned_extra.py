"""The extra turn that a run teaches the next one."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from needle_rig.cli._runs import learned_extra_deg
from needle_rig.errors import BadInput


def run(side: float, extra_deg: float, lag_left_deg: float, **changes: Any) -> Any:
    result = {
        "status": "not_aligned",
        "target_deg": side * 45.0,
        "lag_deg": side * 26.0,
        "motions": [
            {"phase": "overshoot", "base_deg": side * (71.0 + extra_deg)},
            {"phase": "final", "base_deg": side * 45.0, "hall_deg": [0.0, side * (45.0 - lag_left_deg)]},
        ],
    }
    return SimpleNamespace(name="a run", result=result | changes)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize(("extra_deg", "lag_left_deg"), [(0.0, 12.0), (12.0, 4.9), (17.0, -2.0)])
def test_what_was_used_and_what_was_left(side: float, extra_deg: float, lag_left_deg: float) -> None:
    assert learned_extra_deg(run(side, extra_deg, lag_left_deg)) == pytest.approx(extra_deg + lag_left_deg)


@pytest.mark.parametrize("changes", [{"status": "aborted"}, {"motions": []}])
def test_a_run_that_teaches_nothing(changes: dict[str, object]) -> None:
    with pytest.raises(BadInput, match="--after a run: is no run of reed2008"):
        learned_extra_deg(run(1.0, 0.0, 12.0, **changes))


@pytest.mark.parametrize(
    "changes",
    [
        {"motions": 3},
        {"motions": [5]},
        {"motions": [{"phase": "overshoot"}, {"phase": "final"}]},
        {"motions": [{"phase": "overshoot", "base_deg": 1.0}, {"phase": "final", "hall_deg": []}]},
        {"target_deg": "45"},
        {"lag_deg": float("nan")},
    ],
)
def test_a_damaged_result_teaches_nothing(changes: dict[str, object]) -> None:
    with pytest.raises(BadInput, match="--after a run: its result "):
        learned_extra_deg(run(1.0, 0.0, 12.0, **changes))
