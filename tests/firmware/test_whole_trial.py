"""A whole compensation in virtual time around the firmware: library and image say the same bytes."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest

from needle_rig.config.loader import load_rig_config
from needle_rig.control.brain import Brain
from needle_rig.control.reports import Request
from needle_rig.simulation.build import build_plant
from needle_rig.simulation.firmware_rig import FirmwareRig
from needle_rig.simulation.run import VirtualRun, run_virtual
from needle_rig.units import deg, rad

REQUEST = Request(target_rad=rad(45))


@cache
def trial(nodes: str) -> tuple[VirtualRun, tuple[bytes, ...]]:
    config = load_rig_config(None, {"sequence.settle_s": 0.5, "simulation.nodes": nodes})
    plant = build_plant(config)
    frames: list[bytes] = []
    rig: Any = plant if nodes == "python" else FirmwareRig(config, plant, heard=frames.append)
    return run_virtual(Brain(config), rig, REQUEST), tuple(frames)


@pytest.mark.slow
def test_image_and_library_send_the_same_frames_over_a_whole_trial() -> None:
    (library, library_frames), (image, image_frames) = trial("firmware"), trial("image")
    assert len(library_frames) > 10_000 * 3
    pairs = enumerate(zip(library_frames, image_frames, strict=True))
    assert next(((i, a.hex(), b.hex()) for i, (a, b) in pairs if a != b), None) is None
    assert library.settled == image.settled


@pytest.mark.whole
@pytest.mark.parametrize("nodes", ["firmware", pytest.param("image", marks=pytest.mark.slow)])
def test_it_ends_where_the_plant_alone_ends(nodes: str) -> None:
    (plant, _), (firmware, _) = trial("python"), trial(nodes)
    assert [motion.name for motion in firmware.settled] == [motion.name for motion in plant.settled]
    for seen, wanted in zip(firmware.settled, plant.settled, strict=True):
        assert deg(seen.base_angle_rad) == pytest.approx(deg(wanted.base_angle_rad), abs=0.5)
        assert [deg(angle) for angle in seen.hall_rad] == pytest.approx(
            [deg(angle) for angle in wanted.hall_rad], abs=0.5
        )
