"""The fit beside lmfit and Sherpa: all are asked the same, and the table counts right."""

from __future__ import annotations

import numpy as np
import pytest

import needle_rig as nr
from campaigns.workbench import fit_peers, fit_ways
from needle_rig.dataset import Dataset
from needle_rig.workbench.virtual.noise import Noise

ALIKE = Noise(friction_scatter=0.0)


@pytest.fixture(scope="module")
def data() -> Dataset:
    given = nr.simulate({"tissue_elasticity": 0.35}, seed=1, noise=ALIKE).given
    assert isinstance(given, Dataset)
    return given


def test_the_plain_function_at_the_truth_leaves_the_stated_noise(data: Dataset) -> None:
    readings, sigma = fit_ways.samples(data.trials)
    truth = [fit_ways.MODEL.values()[name] for name in fit_ways.NAMES]
    left = (readings - fit_ways.shaft(data.trials, *truth)) / sigma
    assert np.mean(left**2) == pytest.approx(1.0, abs=0.05)
    rigid = (readings - fit_ways.shaft(data.trials, *truth[:2])) / sigma
    assert np.mean(rigid**2) > 100.0


@pytest.mark.parametrize("way", fit_ways.WAYS, ids=lambda way: way.name)
def test_every_way_finds_the_truth_where_the_trials_are_alike(way: fit_ways.Way, data: Dataset) -> None:
    for package in ("lmfit", "sherpa"):
        if way.name.lower().startswith(package):
            pytest.importorskip(package)
    said = way.read(way.ask(data, False))
    assert np.all(np.abs(said.values - fit_peers.TRUTH) < 5.0 * said.sigmas)
    assert np.all((said.intervals[:, 0] < said.values) & (said.values < said.intervals[:, 1]))
    assert 0.8 < said.redchi < 1.2


def test_the_table_tells_a_small_plus_minus_and_a_missed_truth() -> None:
    truth = fit_peers.TRUTH
    ends = np.stack([0.9 * truth, 1.1 * truth], axis=1)
    ends[2] = 2.0 * truth[2]
    said = {"values": 1.01 * truth, "sigmas": 0.005 * truth, "intervals": ends, "processor_s": 0.5}
    row = {"case": "white noise", "said": {way.name: said for way in fit_ways.WAYS}}
    line = fit_peers.coverage([row, row]).splitlines()[2]
    assert line.startswith("| white noise | needle-rig | 2.0 | 2.0 | 2.0 | 67 % | 1.000 | 1.000 | 1.000 |")


def test_what_is_typed_is_counted_without_empty_lines() -> None:
    assert fit_ways.WAYS[0].lines() == 2
    assert fit_ways.shaft.__name__ in fit_ways.WAYS[1].source()
