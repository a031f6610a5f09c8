"""The plant that a rig file describes."""

from __future__ import annotations

from dataclasses import replace

from needle_rig.config.schema import RigConfig
from needle_rig.control.in_si import layout_of
from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.rig import RawReadings
from needle_rig.simulation.drive.drive_guard import guard_settings
from needle_rig.simulation.plant import Plant


def build_plant(config: RigConfig, raw: RawReadings | None = None) -> Plant:
    """Needle, motor and sensors of `config`'s simulation section. Raises BadInput when it has none."""
    if config.simulation is None:
        raise BadInput(f"the rig file of {config.name!r} has no simulation section; see config/rig.yaml")
    model = load_parameters(config.simulation.parameters, layout=layout_of(config))
    if config.simulation.free_needle:
        model = replace(model, friction_n=0.0, effects=())
    return Plant(model, config.simulation, raw=raw, guard=guard_settings(config.drive))
