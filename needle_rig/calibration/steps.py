"""The steps of a calibration: measure, fit, write picture, page and calibration file."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.calibration.fits import HallFit, fit_hall, fit_line
from needle_rig.calibration.kept import FORMAT
from needle_rig.calibration.stand import Stand, collect, jog, make_ready
from needle_rig.config.places import write_yaml
from needle_rig.errors import RigFault
from needle_rig.figures.calibration import draw_hall, draw_line
from needle_rig.firmware.pages import (
    NEUTRAL_MID_COUNTS,
    HallSensorPage,
    drive_page,
    hall_page,
    torque_page,
    write_page,
)
from needle_rig.records import JsonObject
from needle_rig.units import deg
from needle_rig.version import VERSION

NMM_PER_COUNT = 1e-5
"""Of a neutral torque node."""
COUNTS_PER_DEG = 1000
"""Of a neutral drive node."""
SPEED_DEG_S = 30.0
SPARE_DEG = 15.0


@dataclass(frozen=True)
class Calibration:
    """What a calibration wrote, and what it says in words."""

    page: bytes
    values: Mapping[str, object]
    lines: tuple[str, ...]
    files: tuple[Path, ...]


@dataclass(frozen=True)
class Target:
    """Where a calibration goes: folder, serial number of the node, day."""

    folder: Path
    serial: int
    date: datetime.date

    def write(
        self, kind: str, page: bytes, values: Mapping[str, object], lines: list[str], png: Path
    ) -> Calibration:
        """Write page and calibration file beside the picture; gives them back with the files' paths."""
        hex_file, text_file = self.folder / f"{kind}.hex", self.folder / f"{kind}.yaml"
        write_page(hex_file, page)
        head = {"format": FORMAT, "written_by": VERSION, "node": kind, "serial": self.serial}
        document = {**head, "date": self.date.isoformat(), **values, "applied_by": "the node, from its page"}
        text_file.write_text(write_yaml(document), encoding="utf-8")
        return Calibration(page, values, tuple(lines), (text_file, hex_file, png))


async def calibrate_drive(stand: Stand, target: Target) -> Calibration:
    """Write the drive's calibration from a base turned by hand, mark to mark, there and back.

    Values: `counts_per_turn` (signed) and the worst residual in degrees. Raises RigFault.
    """
    places, counts, at = [], [], 0.0
    for turn in (0.0, 1.0, 1.0, -1.0, -1.0):
        if turn:
            await stand.hand_turn(turn)
        at += turn
        readings = await collect(stand, 0.5)
        places.append(at)
        counts.append(float(np.mean(np.degrees(readings.base_rad))) * COUNTS_PER_DEG)
    fit = fit_line(np.array(places), np.array(counts), "encoder")
    counts_per_turn = round(fit.slope)
    png = draw_line(
        fit.x,
        fit.residual / fit.slope * 360.0,
        target.folder / "drive.png",
        title=f"Encoder after calibration: {counts_per_turn} counts a turn",
        x_label="turns by hand",
        y_label="residual / °",
    )
    worst_deg = float(np.max(np.abs(fit.residual))) / abs(fit.slope) * 360.0
    values = {"counts_per_turn": counts_per_turn, "worst_residual_deg": round(worst_deg, 4)}
    lines = [f"encoder: {counts_per_turn} counts a turn, worst residual {worst_deg:.3f}°"]
    return target.write("drive", drive_page(counts_per_turn, target.serial, target.date), values, lines, png)


async def check_drive(stand: Stand) -> str:
    """Jog the base with its page flashed; a sentence with its speed over the commanded one, both ways.

    Raises RigFault when either is off by more than 5 %.
    """
    await make_ready(stand)
    ratios = []
    for speed in (SPEED_DEG_S, -SPEED_DEG_S):
        moved = np.degrees((await jog(stand, speed, 1.5)).base_rad)
        last = moved[len(moved) // 3 :]
        ratios.append((last[-1] - last[0]) / ((len(last) - 1) * 0.005) / speed)
    worst = max(ratios, key=lambda ratio: abs(ratio - 1.0))
    if abs(worst - 1.0) > 0.05:
        raise RigFault(f"jog: the base turns at {worst:.2f} of the commanded speed; is the new page flashed?")
    return f"jog at ±{SPEED_DEG_S:g}°/s: the base turns at {ratios[0]:.3f} and {ratios[1]:.3f} of the command"


async def calibrate_torque(stand: Stand, target: Target, weights_nmm: tuple[float, ...]) -> Calibration:
    """Write the load cell's calibration from weights that are hung on it, up and down again.

    Values: offset in counts, gain in N·mm per count, worst residual in N·mm. Raises RigFault.
    """
    loads, readings = [], []
    for weight in (*weights_nmm, *reversed(weights_nmm[:-1])):
        await stand.hang(weight)
        await collect(stand, 0.3)
        loads.append(weight)
        readings.append(float(np.mean((await collect(stand, 1.0)).torque_nmm)) / NMM_PER_COUNT)
    fit = fit_line(np.array(loads), np.array(readings), "load cell")
    gain = 1.0 / fit.slope
    residual_nmm = fit.residual * gain
    png = draw_line(
        fit.x,
        residual_nmm,
        target.folder / "torque.png",
        title=f"Load cell after calibration: {gain * 1e3:.5f} N·mm per 1000 counts",
        x_label="weight / N·mm",
        y_label="residual / N·mm",
    )
    worst = float(np.max(np.abs(residual_nmm)))
    values = {
        "offset_counts": round(fit.offset, 1),
        "nmm_per_count": float(f"{gain:.6g}"),
        "worst_residual_nmm": float(f"{worst:.3g}"),
    }
    lines = [
        f"load cell: offset {fit.offset:.0f} counts, {gain * 1e3:.5f} N·mm per 1000 counts, "
        f"worst residual {worst:.5f} N·mm"
    ]
    return target.write(
        "torque", torque_page(fit.offset, gain, target.serial, target.date), values, lines, png
    )


async def calibrate_hall(stand: Stand, target: Target) -> Calibration:
    """Write the Hall sensors' calibration; the drive turns the free needle a full turn there and back.

    Values of each sensor: offsets and amplitudes of its field, in counts; its zero and its eccentricity
    against the base, in degrees. Raises RigFault.
    """
    await make_ready(stand)
    seconds = (360.0 + SPARE_DEG) / SPEED_DEG_S
    runs = [await jog(stand, SPEED_DEG_S, seconds), await jog(stand, -SPEED_DEG_S, seconds)]
    base = np.concatenate([run.base_rad for run in runs])
    raw = np.concatenate([run.raw_rad for run in runs])
    field = np.concatenate([run.field for run in runs])
    names = [sensor.name for sensor in stand.config.layout.hall_sensors]
    fits = {name: fit_hall(base, raw[:, i], field[:, i]) for i, name in enumerate(names)}
    residuals = {name: (fit.angle_rad, fit.residual_rad) for name, fit in fits.items()}
    png = draw_hall(residuals, target.folder / "hall.png")
    page = hall_page([_page_of(fit) for fit in fits.values()], target.serial, target.date)
    lines = [
        f"{name}: offsets {fit.sine_offset:+.1f} and {fit.cosine_offset:+.1f} counts, "
        f"gain of the sine {fit.sine_amplitude / fit.cosine_amplitude:.4f} of the cosine's, "
        f"zero {deg(fit.zero_rad):+.2f}°, eccentricity {deg(fit.amplitude_rad[0]):.2f}°, "
        f"residual {deg(float(np.std(fit.residual_rad))):.3f}° (one standard deviation)"
        for name, fit in fits.items()
    ]
    values = {"sensors": [{"name": name, **_values_of(fit)} for name, fit in fits.items()]}
    return target.write("hall", page, values, lines, png)


def _page_of(fit: HallFit) -> HallSensorPage:
    return HallSensorPage(
        NEUTRAL_MID_COUNTS + fit.sine_offset,
        NEUTRAL_MID_COUNTS + fit.cosine_offset,
        *fit.gains,
        fit.zero_rad,
        fit.amplitude_rad,
        fit.phase_rad,
    )


def _values_of(fit: HallFit) -> JsonObject:
    return {
        "sine_offset_counts": round(fit.sine_offset, 2),
        "cosine_offset_counts": round(fit.cosine_offset, 2),
        "sine_gain": round(fit.gains[0], 5),
        "cosine_gain": round(fit.gains[1], 5),
        "zero_deg": round(deg(fit.zero_rad), 4),
        "eccentricity_deg": [round(deg(amplitude), 4) for amplitude in fit.amplitude_rad],
        "phase_deg": [round(math.degrees(phase), 2) for phase in fit.phase_rad],
        "residual_deg": round(deg(float(np.std(fit.residual_rad))), 4),
    }
