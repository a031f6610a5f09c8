"""The circle closes: the hidden effect is found, and the needle ends straighter on fresh needles."""

from __future__ import annotations

import pytest

from needle_rig.figures.demo import demo_figure
from needle_rig.figures.page import png
from needle_rig.model import effect_directories, load_parameters
from needle_rig.physics.effects.tissue_elasticity import TissueElasticity
from needle_rig.physics.library import find_effects
from needle_rig.workbench.contest.demo import Story, in_words, tell_story
from tests.values import known

CANDIDATES = ("tissue_elasticity", "tip_friction", "chuck_compliance")
"""A small library keeps the diagnosis short; the whole one is the benchmark's matter."""


@pytest.fixture(scope="module")
def story() -> Story:
    library = find_effects(effect_directories(()))
    plant = load_parameters("rig_rigid").with_effects(TissueElasticity(0.3))
    return tell_story(plant, {name: library[name] for name in CANDIDATES}, runs=4)


def test_the_circle_closes(story: Story) -> None:
    told = story.as_json()
    assert told["adopted"] == ["tissue_elasticity"]
    assert told["found"]
    stiffness = told["parameters"]["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"]
    assert stiffness["value"] == pytest.approx(0.3, rel=0.05)
    held = told["held_out_error"]
    floor = known(held["noise_floor"])
    assert known(held["before"]) > 5.0 * floor
    assert known(held["after"]) < 1.6 * floor
    assert told["reed2008"]["worst_deg"]["median"] > 6.0
    planned = known(told["planned"])
    assert planned["worst_deg"]["median"] < 1.0
    assert planned["rotations"] < told["reed2008"]["rotations"]
    assert planned["time_s"] < told["reed2008"]["time_s"] / 2
    assert known(told["times_better"]) > 3.0


def test_it_can_be_read_and_seen(story: Story) -> None:
    words = in_words(story)
    assert words[2].startswith("3. diagnose names tissue_elasticity; adopting brings that error to 1.")
    assert words[3].startswith("4. Before it moves: planned should leave 0.")
    assert words[-1] == "Hidden in the rig was tissue_elasticity. It was exactly that."
    assert png(demo_figure(story))[:4] == b"\x89PNG"
