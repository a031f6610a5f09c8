"""The bench of messy sets: its plan, its shapes, its judgement."""

from argparse import Namespace
from collections import Counter
from typing import Any

import pytest

from campaigns.run import key
from campaigns.workbench import messy_sets
from campaigns.workbench.messy_shapes import SHAPES, most_plausible, recorded
from campaigns.workbench.noise_kinds import KINDS
from campaigns.workbench.rates import right
from needle_rig.physics.library import find_effects
from needle_rig.workbench.virtual.noise import Noise


def test_an_effect_meets_every_noise_shape_and_pair_of_them_once() -> None:
    pairs = len(KINDS) * len(SHAPES)
    tasks = messy_sets.plan(Namespace(size=pairs, first_seed=0))
    assert len({key(task) for task in tasks}) == len(tasks)
    for name in [*sorted(find_effects())[:3], None]:
        mine = [t for t in tasks if t["effects"] == ([name] if name else [])]
        met = Counter((t["noise"], t["shape"]) for t in mine)
        assert len(met) == pairs
        assert len(set(met.values())) == 1
        first = [t["shape"] for t in mine if t["block"] < len(SHAPES)]
        assert set(first) == set(SHAPES)


def test_a_beginning_has_noises_and_shapes_in_proportion() -> None:
    begun = messy_sets.plan(Namespace(size=5, first_seed=0))
    for field, kinds in (("noise", KINDS), ("shape", SHAPES)):
        count = Counter(task[field] for task in begun)
        assert set(count) == set(kinds)
        assert max(count.values()) - min(count.values()) <= 5


@pytest.mark.parametrize(
    ("shape", "torque", "sensors"),
    [("torque alone", True, 0), ("tip alone", False, 1), ("two sensors anywhere", True, 2)],
)
def test_a_shape_reads_what_it_says(shape: str, torque: bool, sensors: int) -> None:
    data = recorded(SHAPES[shape], (), "white", Noise(), 5)
    for trial in data.trials:
        assert bool(trial.torque_ok.any()) is torque
        assert int(trial.hall_ok.any(axis=0).sum()) == sensors


def test_starts_are_wound_where_a_shape_says_so() -> None:
    starts = [
        [t.start != "relaxed" for t in recorded(SHAPES[name], (), "white", Noise(), 5).trials]
        for name in ("two trials wound", "all trials wound")
    ]
    assert (sum(starts[0]), all(starts[1])) == (2, True)


def test_a_plausible_strength_is_within_every_range() -> None:
    from needle_rig.model import load_parameters
    from needle_rig.workbench.estimation.parameters import free_parameters

    parameters = free_parameters(find_effects(), ["hall_gain"], load_parameters("rig_rigid").layout)
    assert most_plausible(parameters) == pytest.approx(0.1 / 0.05)


def test_a_second_name_is_no_right_answer_and_what_was_not_asked_is_told() -> None:
    row: dict[str, Any] = {
        "effects": ["a"],
        "noise": "white",
        "shape": "tip alone",
        "block": 0,
        "verdict": "effect",
        "named": ["a"],
        "ties": {},
        "rules": [],
        "covered": [True],
    }
    assert right(row)
    more = row | {"named": ["a", "b"], "ties": {"a": [], "b": []}}
    assert not right(more)
    asked = {k: row[k] for k in ("effects", "noise", "shape", "block")}
    told = messy_sets.table([row, more, asked | {"skipped": "does not show"}], Namespace())
    assert "a and b" in told
    assert "Not asked, since it does not show: a (tip alone)." in told
