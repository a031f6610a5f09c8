"""Every effect acts in a part that some machine has, and a machine is offered what fits it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from needle_rig.cli.effects import command
from needle_rig.errors import BadInput
from needle_rig.physics.effect import Reading, Trial
from needle_rig.physics.library import built_in_effects
from needle_rig.physics.machine import MACHINES, NEEDLE, MachineName, check_fits, fitting
from tests.effects.common import make_effect

LIBRARY = built_in_effects()
OF_DRIVES = {"gear_backlash", "rotor_inertia"}


def test_no_effect_acts_where_no_machine_has_a_part() -> None:
    parts = frozenset().union(*(machine.parts for machine in MACHINES.values()))
    assert {e.part for e in LIBRARY.values() if e.part} == parts


def test_a_needle_has_all_but_what_a_drive_has() -> None:
    assert set(fitting(LIBRARY, NEEDLE)) == set(LIBRARY) - OF_DRIVES


@pytest.mark.parametrize("machine", sorted(set(MACHINES) - {NEEDLE}))
def test_another_machine_has_no_chuck_and_no_tissue(machine: MachineName) -> None:
    found = set(fitting(LIBRARY, machine))
    assert found > OF_DRIVES | {
        "bearing_drag",
        "stribeck",
        "viscous_slip",
        "torque_ripple",
        "transmission_error",
    }
    assert not {n for n in found if n.startswith(("chuck_", "tissue_", "guide_", "insertion_", "mount_"))}
    result = CliRunner().invoke(command, ["--machine", machine, "--json"])
    assert {e["name"] for e in json.loads(result.output)["effects"]} == found


def test_an_effect_of_another_machine_is_a_sentence() -> None:
    check_fits(LIBRARY["gear_backlash"], "joint")
    with pytest.raises(BadInput, match=r"chuck_backlash: acts in a part \(chuck\) that a joint lacks"):
        check_fits(LIBRARY["chuck_backlash"], "joint")


def test_the_twins_of_a_drive_have_the_laws_of_the_chuck() -> None:
    time_s = np.linspace(0.0, 2.0, 201)
    trial = Trial(time_s, np.sin(3.0 * time_s))
    for drive, chuck in (("gear_backlash", "chuck_backlash"), ("rotor_inertia", "chuck_inertia")):
        here, there = make_effect(drive, 7.0), make_effect(chuck, 7.0)
        if here.has("drive"):
            assert (here.drive(trial) == there.drive(trial)).all()
        else:
            nothing = Reading(trial, np.zeros(201), np.zeros((201, 0)))
            assert (here.observe(nothing).torque_nm == there.observe(nothing).torque_nm).all()
