"""Recordings of every degenerate shape: channels that nothing moves, two rows, one trial, gaps, constants."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import yaml

NEEDLE: dict[str, object] = {"diameter_mm": 0.39, "density_g_cm3": 6.45}
SHEAR_MODULUS_GPA = 27.5
PLACES_MM = (120.0, 200.0, 300.0, 396.0)
SECTIONS_MM = ([150.0, 180.0], [220.0, 260.0], [310.0, 395.0])

Path_ = Callable[[float], float]


def base_path(draw: random.Random) -> Path_:
    """Base angle, degrees, of the share of the trial that has passed."""
    size_deg = draw.choice((0.0, 0.01, 0.5, 5.0, 45.0, -60.0, 720.0, 1e5))
    kind = draw.choice(("rest", "step", "ramp", "stroke", "staircase", "noise"))
    return {
        "rest": lambda _: size_deg,
        "step": lambda share: size_deg if share > 0.3 else 0.0,
        "ramp": lambda share: size_deg * share,
        "stroke": lambda share: size_deg * min(share, 1.0 - share),
        "staircase": lambda share: size_deg * (int(5 * share) % 3),
        "noise": lambda _: draw.gauss(0.0, abs(size_deg)),
    }[kind]


def channel(draw: random.Random, size: float) -> Callable[[float], str]:
    """What a channel writes at a base angle, degrees."""
    kind = draw.choice(
        ("follows", "lags", "zero", "constant", "noise", "gone", "gaps", "steps", "huge", "turned")
    )
    gain, noise = size * draw.choice((1.0, 0.9, 0.01)), size * draw.choice((0.0, 0.1, 3.0))
    held = 0.0

    def write(base_deg: float) -> str:
        nonlocal held
        held = min(max(held, base_deg - 20.0), base_deg + 20.0)
        value = {
            "follows": gain * base_deg + draw.gauss(0.0, noise),
            "lags": gain * held + draw.gauss(0.0, noise),
            "zero": 0.0,
            "constant": 12.5 * size,
            "noise": draw.gauss(0.0, size),
            "gone": None,
            "gaps": gain * held if draw.random() < 0.3 else None,
            "steps": round(gain * base_deg),
            "huge": 1e12 * gain * base_deg,
            "turned": -gain * base_deg,
        }[kind]
        return "" if value is None else f"{value:.6g}"

    return write


def write_dataset(folder: Path, seed: int) -> Path:
    """A dataset folder of a random degenerate shape; equal seeds give equal files."""
    draw = random.Random(seed)
    sensors = draw.choice((0, 1, 1, 2, 3))
    names = ["hall_1", "hall_2", "tip"][:sensors]
    known = {**NEEDLE, "shear_modulus_gpa": SHEAR_MODULUS_GPA}
    needle = known if draw.random() < 0.7 else {"torsional_rigidity_nmm2": "unknown"}
    columns = [f"{name}_deg" for name in names if draw.random() < 0.9]
    if draw.random() < 0.8:
        columns.append("base_torque_nmm")
    trials = []
    for k in range(draw.choice((1, 1, 2, 4))):
        rows, interval_s = draw.choice((0, 1, 2, 3, 5, 30, 30, 300, 300)), draw.choice((1e-3, 0.02, 0.2, 5.0))
        base, cells = base_path(draw), [channel(draw, 0.01 if "torque" in c else 1.0) for c in columns]
        lines = [",".join(["time_s", "base_angle_deg", *columns])]
        for row in range(rows):
            base_deg = base(row / max(rows - 1, 1))
            lines.append(
                ",".join([f"{row * interval_s:g}", f"{base_deg:.6g}", *(c(base_deg) for c in cells)])
            )
        place = f"trials/{k + 1:02d}.csv"
        (folder / "trials").mkdir(parents=True, exist_ok=True)
        (folder / place).write_text("\n".join(lines) + "\n", encoding="utf-8")
        trials.append({"file": place, "kind": draw.choice(("x", "x", f"x{k}")), "start_s": 1e3 * k})
    rig = {
        "hall_sensors": [
            {"name": name, "position_mm": at}
            for name, at in zip(names, sorted(draw.sample(PLACES_MM, sensors)), strict=True)
        ],
        "needle": needle,
        "needle_length_mm": 397.0,
        "tissue_sections_mm": list(SECTIONS_MM[: draw.randint(0, 3)]),
    }
    text = yaml.safe_dump(
        {"format": "needle-rig-dataset/1", "name": f"shape_{seed}", "rig": rig, "trials": trials}
    )
    (folder / "dataset.yaml").write_text(text, encoding="utf-8")
    return folder
