"""What a model expects while a run goes: a true one is not left, a wrong one is, however the needle began."""

from __future__ import annotations

import math

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.model import SavedModel, load_parameters
from needle_rig.numerics import Array
from needle_rig.physics.effect import Trial
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.physics.settled_needle import SettledNeedle
from needle_rig.units import deg, nmm
from needle_rig.web.expectation import ALARM_SIGMA, Expectation, Expectations

RATE_HZ = 30.0
UNCERTAIN = {"friction_nmm_per_100mm": 0.001}


def rows(plant: NeedleModel, corners: list[tuple[float, float]], seed: int = 1) -> Array:
    """Time, base angle, torque and Hall angles (samples, channels) as the base goes by `corners` (s, °)."""
    random = np.random.default_rng(seed)
    time_s = np.arange(0.0, corners[-1][0], 1.0 / RATE_HZ)
    base_rad = np.radians(np.interp(time_s, *np.array(corners).T))
    read = SettledNeedle.relaxed(plant, base_rad[0]).moved(Trial(time_s, base_rad)).readings
    hall = deg(read.hall_rad) + random.normal(0.0, 0.25, read.hall_rad.shape)
    torque = nmm(read.torque_nm) + random.normal(0.0, 0.0008, time_s.size)
    return np.column_stack([time_s, np.degrees(base_rad), torque, hall])


def worst(of: Expectation, seen: Array, pieces: int) -> float:
    """The largest distance that was told while the run came in so many pieces."""
    found = [of.after(part.tolist())["off"] for part in np.array_split(seen, pieces)]
    return float(np.abs(found).max())


TURN = [
    (0.0, 0.0),
    (1.0, 0.0),
    (2.0, 45.0),
    (5.0, 45.0),
    (6.0, 10.0),
    (9.0, 10.0),
    (10.0, 45.0),
    (13.0, 45.0),
]


@pytest.mark.parametrize("plant", ["rig_elastic", "rig_rigid"])
def test_the_true_model_is_not_left_and_the_other_is(plant: str) -> None:
    needle = load_parameters(plant)
    seen = rows(needle, TURN)
    rest = [0.0, 0.0, 0.0, *(0.0,) * len(needle.layout.sensor_positions_m)]
    assert worst(Expectation(SavedModel(needle, plant, UNCERTAIN), rest), seen, 40) < ALARM_SIGMA
    other = load_parameters("rig_rigid" if plant == "rig_elastic" else "rig_elastic")
    assert worst(Expectation(SavedModel(other, "", UNCERTAIN), rest), seen, 40) > ALARM_SIGMA


def test_pieces_and_the_whole_expect_the_same() -> None:
    needle = load_parameters("rig_elastic")
    seen, rest = rows(needle, TURN), [0.0] * (3 + len(needle.layout.sensor_positions_m))
    saved = SavedModel(needle, "", UNCERTAIN)
    whole = np.array(Expectation(saved, rest).after(seen.tolist())["mean"])
    of = Expectation(saved, rest)
    pieces = np.hstack(
        [of.after(part.tolist())["mean"] for part in np.array_split(seen, 17)[1:] if len(part)]
    )
    first = len(np.array_split(seen, 17)[0])
    assert whole.shape[1] == len(seen) - 1, "the rest itself is known"
    assert pieces[0] == pytest.approx(whole[0, first - 1 :], abs=0.002)
    assert pieces[1:] == pytest.approx(whole[1:, first - 1 :], abs=0.5)


def test_a_needle_that_rests_wound_is_expected_to_hold_its_torque() -> None:
    needle = load_parameters("rig_elastic")
    wound = rows(needle, [(0.0, 0.0), (1.0, 40.0), (4.0, 40.0)])
    rest = wound[-15:].mean(axis=0)
    assert rest[2] > 0.05
    of = Expectation(SavedModel(needle, "", UNCERTAIN), [4.0, *rest[1:].tolist()])
    still = of.after([[4.0 + k / RATE_HZ, *rest[1:].tolist()] for k in range(1, 31)])
    assert still["mean"][0][-1] == pytest.approx(rest[2], abs=0.004)
    assert max(map(abs, still["off"])) < ALARM_SIGMA


def test_what_comes_is_expected_from_where_the_base_stands() -> None:
    needle = load_parameters("rig_elastic")
    of = Expectation(SavedModel(needle, "", UNCERTAIN), [0.0] * (3 + len(needle.layout.sensor_positions_m)))
    ahead = of.ahead(45.0, 1.0, 1.0)
    seen = rows(needle, [(0.0, 0.0), (1.0, 45.0), (2.1, 45.0)])
    at = np.interp(ahead["time_s"], seen[:, 0], seen[:, 2])
    assert ahead["time_s"][-1] == 2.0
    assert ahead["mean"][0] == pytest.approx(at, abs=0.006)
    assert of.after([])["time_s"] == [], "nothing has moved yet"


def test_a_model_of_another_rig_and_a_run_whose_beginning_was_not_seen_are_sentences() -> None:
    needle = load_parameters("rig_elastic")
    with pytest.raises(BadInput, match="Hall sensors, the rig 1; choose a model"):
        Expectation(SavedModel(needle, ""), [0.0, 0.0, 0.0, 0.0])
    with pytest.raises(BadInput, match="was not seen"):
        Expectations().after("a run", [], None)


def test_noise_alone_raises_no_alarm_in_a_thousand_seconds() -> None:
    needle = load_parameters("rig_elastic")
    channels = len(needle.layout.sensor_positions_m)
    of = Expectation(SavedModel(needle, "", UNCERTAIN), [0.0] * (3 + channels))
    random = np.random.default_rng(3)
    count = int(1000 * RATE_HZ)
    time_s = np.arange(1, count + 1) / RATE_HZ
    noise = np.column_stack([random.normal(0, 0.0008, count), random.normal(0, 0.25, (count, channels))])
    still = np.column_stack([time_s, np.zeros(count), noise])
    assert worst(of, still, 200) < ALARM_SIGMA
    assert math.isfinite(of.noise.sum())
