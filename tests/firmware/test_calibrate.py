"""Calibration finds what was planted: with its pages flashed, every reading of the rig is true."""

from __future__ import annotations

import asyncio
import datetime
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from needle_rig.calibration.fits import fit_hall, fit_line
from needle_rig.calibration.stand import BenchStand, collect, jog, make_ready
from needle_rig.calibration.steps import check_drive
from needle_rig.cli.calibrate import command
from needle_rig.config.loader import read_yaml
from needle_rig.errors import BadInput, RigFault
from needle_rig.firmware.pages import read_page, torque_page, write_page
from needle_rig.simulation.nodes.analogue import SensorErrors
from needle_rig.units import deg

SEED = 3
ERRORS = {"simulation.sensor_errors_seed": SEED}


@pytest.fixture(scope="module")
def pages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("calibration")
    for node in ("drive", "torque", "hall"):
        words = [node, "--rig", "bench", "--serial", "12", "--yes", "--errors", str(SEED), "--out", str(out)]
        done = CliRunner().invoke(command, words, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        assert f"wrote {out / node}.hex" in done.output
        assert (out / f"{node}.png").stat().st_size > 5000
    return out


@pytest.mark.whole
def test_with_the_pages_flashed_every_reading_is_true(pages: Path) -> None:
    stand = BenchStand("none of them", pages, ERRORS)
    plant = stand.rig.plant

    async def turn() -> tuple[float, float]:
        await make_ready(stand)
        worst_base = worst_hall = 0.0
        for _ in range(27):
            await jog(stand, 45.0, 0.3)
            readings = await collect(stand, 0.4)
            truth = plant.motor.angle_rad
            worst_base = max(worst_base, abs(float(np.mean(readings.base_rad)) - truth))
            # The mean of angles that may lie on both sides of pi.
            seen = np.angle(np.mean(np.exp(1j * readings.raw_rad), axis=0))
            away = [math.remainder(a - b, math.tau) for a, b in zip(seen, plant.hall_rad, strict=True)]
            worst_hall = max(worst_hall, *map(abs, away))
        return deg(worst_base), deg(worst_hall)

    worst_base_deg, worst_hall_deg = asyncio.run(turn())
    assert deg(plant.motor.angle_rad) > 300
    assert worst_base_deg < 0.2
    assert worst_hall_deg < 0.2


@pytest.mark.whole
def test_the_calibrated_load_cell_weighs_right(pages: Path) -> None:
    stand = BenchStand("none of them", pages, ERRORS)

    async def weigh(weight: float) -> float:
        await stand.hang(weight)
        await collect(stand, 0.2)
        return float(np.mean((await collect(stand, 0.5)).torque_nmm))

    for weight in (-1.0, 0.0, 0.3, 2.0):
        assert asyncio.run(weigh(weight)) == pytest.approx(weight, abs=0.0005 + 0.001 * abs(weight))


@pytest.mark.whole
def test_it_finds_what_was_planted(pages: Path) -> None:
    planted = SensorErrors.planted(SEED, 4)
    documents: list[Any] = [read_yaml(pages / f"{node}.yaml")[0] for node in ("drive", "torque", "hall")]
    drive, torque, hall = documents
    assert drive["counts_per_turn"] == pytest.approx(360_000 * planted.encoder_gain, rel=1e-3)
    assert torque["nmm_per_count"] == pytest.approx(1e-5 / planted.torque_gain, rel=1e-3)
    assert torque["offset_counts"] == pytest.approx(planted.torque_offset_counts, abs=50)
    for found, wrong in zip(hall["sensors"], planted.hall, strict=True):
        assert found["sine_offset_counts"] == pytest.approx(wrong.sine_offset, abs=1)
        assert found["cosine_offset_counts"] == pytest.approx(wrong.cosine_offset, abs=1)
        ratio = wrong.cosine_gain / wrong.sine_gain
        assert found["sine_gain"] / found["cosine_gain"] == pytest.approx(ratio, rel=0.01)
        assert found["eccentricity_deg"][0] == pytest.approx(deg(wrong.eccentricity_rad[0]), abs=0.2)
    for document in (drive, torque, hall):
        assert document["serial"] == 12
        assert document["date"] == datetime.date.today().isoformat()


def test_without_its_page_the_drive_is_not_let_go(tmp_path: Path) -> None:
    stand = BenchStand("drive", tmp_path, ERRORS)
    with pytest.raises(RigFault, match=r"encoder calibrated|new page flashed"):
        asyncio.run(check_drive(stand))


def test_pages_go_to_flash_and_back(tmp_path: Path) -> None:
    page = torque_page(-12.0, 2e-5, 7, datetime.date(2026, 1, 2))
    write_page(tmp_path / "torque.hex", page)
    assert read_page(tmp_path / "torque.hex") == page
    (tmp_path / "empty.hex").write_text(":00000001FF\n")
    for name in ("empty.hex", "missing.hex"):
        with pytest.raises(BadInput, match=r"page|0x080E0000"):
            read_page(tmp_path / name)


def test_measurements_that_tell_nothing_are_refused() -> None:
    half = np.linspace(0.0, math.pi, 100)
    with pytest.raises(RigFault, match="full turn"):
        fit_hall(half, half, np.full(100, 27_000.0))
    with pytest.raises(RigFault, match="one point"):
        fit_line(np.ones(3), np.arange(3.0), "load cell")
    with pytest.raises(RigFault, match="do not follow"):
        fit_line(np.arange(4.0), np.array([1.0, -1.0, 1.0, -1.0]), "load cell")


@pytest.mark.parametrize("weights", ["1", "1,1", "a,b"])
def test_weights_that_make_no_line_are_refused(weights: str, tmp_path: Path) -> None:
    words = [
        "torque",
        "--rig",
        "bench",
        "--serial",
        "1",
        "--yes",
        "--out",
        str(tmp_path),
        "--weights",
        weights,
    ]
    with pytest.raises(BadInput, match="--weights"):
        CliRunner().invoke(command, words, catch_exceptions=False)
