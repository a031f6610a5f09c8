from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.config.schema import RigConfig, SimulationSection
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.model import load_parameters
from needle_rig.simulation.plant import Plant
from needle_rig.simulation.run import VirtualRun, run_virtual
from needle_rig.units import rad

Align = Callable[..., VirtualRun]


def simulation_of(config: RigConfig) -> SimulationSection:
    """How its rig is simulated."""
    assert config.simulation is not None
    return config.simulation


@pytest.fixture(scope="session")
def config() -> RigConfig:
    return load_rig_config(None)


@pytest.fixture(scope="session")
def align(config: RigConfig) -> Align:
    """A whole run in virtual time on a published needle, as quiet as asked."""

    def run(
        parameters: str = "rig_elastic",
        strategy: str = "reed2008",
        target_deg: float = 45.0,
        options: dict[str, Any] | None = None,
        effects: tuple[Any, ...] = (),
        noise: bool = True,
        settle_s: float = 3.0,
        layout: Any = None,
        seed: int = 1,
        **simulation: Any,
    ) -> VirtualRun:
        quiet = {} if noise else {"torque_noise_nmm": 0.0, "hall_noise_deg": 0.0}
        settings = simulation_of(config).model_copy(update={"seed": seed, **quiet, **simulation})
        model = load_parameters(parameters, layout=layout) if layout else load_parameters(parameters)
        plant = Plant(model.with_effects(*effects), settings)
        rig = config
        if layout is not None:
            needle = config.needle.model_copy(update={"length_mm": layout.needle_length_m * 1e3})
            sections = tuple((a * 1e3, b * 1e3) for a, b in layout.tissue_sections_m)
            sensors = tuple(
                config.layout.hall_sensors[i].model_copy(update={"position_mm": place * 1e3})
                for i, place in enumerate(layout.sensor_positions_m)
            )
            seen = config.layout.model_copy(update={"tissue_sections_mm": sections, "hall_sensors": sensors})
            rig = config.model_copy(update={"needle": needle, "layout": seen})
        request = Request(rad(target_deg), strategy, options or {}, settle_s=settle_s)
        return run_virtual(Brain(rig), plant, request, shafts=True)

    return run
