"""The picture of a run: angles and torque over time, and the angle along the shaft after each motion."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg

from needle_rig.config.places import show_path
from needle_rig.config.schema import RigConfig
from needle_rig.errors import BadInput, NeedleRigError
from needle_rig.figures.figure import Figure
from needle_rig.numerics import Array
from needle_rig.recording import RunFile
from needle_rig.recording.tables import Rows
from needle_rig.units import deg, mm, nmm

# Okabe and Ito's palette: told apart by people with colour-blindness and in grey.
BASE = "#000000"
SENSORS = ("#56B4E9", "#0072B2", "#009E73", "#D55E00", "#CC79A7", "#E69F00", "#8C6D31", "#7F7F7F")
MOTIONS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C6D31")
SHADES = ("#F1F1EE", "#E2E5E8")
FONT_PT = 9


@dataclass(frozen=True)
class Motion:
    """One motion of a run, from where its waypoint was set to where the rig had settled."""

    name: str
    begin_s: float
    end_s: float
    waypoint_deg: float
    last: int
    """Place of its last tick in the table."""
    settled: bool
    """Whether the sequence went on from here, or ended; False when it was stopped or cut off."""


def draw_run(run: RunFile, png_path: str | os.PathLike[str]) -> Path:
    """Write the picture of `run` to `png_path`, 1500 pixels wide, and return the path.

    Raises BadInput when the run has no tick to draw, NeedleRigError when the file cannot be written.
    """
    figure, target = run_figure(run), Path(png_path)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(target, format="png")
    except OSError as error:
        raise NeedleRigError(
            f"{show_path(target)}: the picture cannot be written: {error.strerror}"
        ) from None
    return target


def run_figure(run: RunFile) -> Figure:
    """Angles and torque over time, and the shaft after each motion; BadInput when there is no tick."""
    ticks = run.table("ticks")
    if len(ticks) < 2:
        raise BadInput(f"{show_path(run.path)}: holds no tick, so there is nothing to draw")
    config = run.config
    begin_s = float(ticks["time_s"][0])
    motions = find_motions(ticks)
    settled = settled_angles(ticks, motions, config.sequence.torque_window_s)
    figure = Figure(figsize=(12.5, 10.5), dpi=120, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    angles, torque, shaft = figure.subplots(3, 1, height_ratios=(1.35, 0.85, 1.25))
    torque.sharex(angles)
    _draw_angles(angles, ticks, begin_s, config, _number(run.attributes.get("target_deg")))
    _draw_torque(torque, run, ticks, begin_s, config)
    for axes in (angles, torque):
        _shade(axes, motions, begin_s, named=axes is angles)
    _mark_end(angles, run, begin_s)
    _draw_shaft(shaft, run, motions, settled, config)
    figure.suptitle(_title(run), fontsize=12, fontweight="bold", x=0.01, ha="left")
    return figure


def find_motions(ticks: Rows) -> tuple[Motion, ...]:
    """The motions in a table of ticks, in order; the rest before the first is none of them."""
    names = ticks["motion"]
    active = ~np.isin(ticks["phase"], (b"idle", b"done", b"aborted", b"fault"))
    edges = np.flatnonzero((names[1:] != names[:-1]) | (active[1:] != active[:-1])) + 1
    starts = np.concatenate(([0], edges))
    ends = np.concatenate((edges, [len(ticks)]))
    motions = []
    for start, end in zip(starts, ends, strict=True):
        name = names[start].decode("utf-8", "replace")
        if active[start] and name not in ("", "rest"):
            after = min(int(end), len(ticks) - 1)
            motions.append(
                Motion(
                    name=name,
                    begin_s=float(ticks["time_s"][start]),
                    end_s=float(ticks["time_s"][after]),
                    waypoint_deg=float(deg(ticks["waypoint_rad"][start])),
                    last=int(end) - 1,
                    settled=end < len(ticks) and ticks["phase"][after] not in (b"aborted", b"fault"),
                )
            )
    return tuple(motions)


def settled_angles(ticks: Rows, motions: tuple[Motion, ...], window_s: float) -> Array:
    """Mean base and Hall angles in degrees over the end of each motion, (motions, 1 + sensors)."""
    angles = np.column_stack([ticks["base_angle_rad"], ticks["hall_rad"]])
    means = np.full((len(motions), angles.shape[1]), np.nan)
    for number, motion in enumerate(motions):
        last_s = ticks["time_s"][motion.last]
        since = max(last_s - window_s, motion.begin_s)
        window = (ticks["time_s"] >= since) & (ticks["time_s"] <= last_s)
        means[number] = deg(angles[window].mean(axis=0))
    return means


def _draw_angles(axes: Axes, ticks: Rows, begin_s: float, config: RigConfig, target_deg: float) -> None:
    time_s = ticks["time_s"] - begin_s
    tolerance = config.sequence.aligned_deg
    if np.isfinite(target_deg):
        axes.axhspan(target_deg - tolerance, target_deg + tolerance, color="#F0E442", alpha=0.35, lw=0)
        axes.axhline(target_deg, color="#9A8F00", lw=1, ls=(0, (5, 3)), label=f"target ±{tolerance:g}°")
    for number, sensor in enumerate(config.layout.hall_sensors):
        axes.plot(
            time_s,
            deg(ticks["hall_rad"][:, number]),
            color=SENSORS[number % len(SENSORS)],
            lw=1.1,
            label=f"{sensor.name} ({sensor.position_mm:g} mm)",
        )
    axes.plot(time_s, deg(ticks["base_angle_rad"]), color=BASE, lw=1.8, label="base")
    axes.plot(time_s, deg(ticks["waypoint_rad"]), color=BASE, lw=0.9, ls=":", label="waypoint")
    axes.set_ylabel("angle / °")
    axes.tick_params(labelbottom=False)
    _tidy(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), frameon=False, fontsize=FONT_PT)


def _draw_torque(axes: Axes, run: RunFile, ticks: Rows, begin_s: float, config: RigConfig) -> None:
    raw = run.table("torque") if "torque" in run.tables else ticks
    raw = raw if len(raw) else ticks
    axes.plot(
        raw["time_s"] - begin_s,
        nmm(raw["torque_nm"]),
        color="#B0B7BD",
        lw=0.5,
        label="cell, every reading",
    )
    window_s = config.sequence.torque_window_s
    axes.plot(
        ticks["time_s"] - begin_s,
        nmm(_running_mean(ticks["time_s"], ticks["torque_nm"], window_s)),
        color="#0072B2",
        lw=1.6,
        label=f"mean of the last {window_s:g} s",
    )
    limit = config.sequence.aligned_torque_nmm
    axes.axhspan(-limit, limit, color="#F0E442", alpha=0.35, lw=0, label=f"aligned: ±{limit:g} N·mm")
    axes.set_ylabel("base torque / N·mm")
    axes.set_xlabel("time / s")
    _tidy(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), frameon=False, fontsize=FONT_PT)


def _running_mean(time_s: Array, values: Array, window_s: float) -> Array:
    total = np.concatenate(([0.0], np.cumsum(np.nan_to_num(values))))
    first = np.searchsorted(time_s, time_s - window_s)
    places = np.arange(1, len(values) + 1)
    mean: Array = (total[places] - total[first]) / (places - first)
    return mean


def _shade(axes: Axes, motions: tuple[Motion, ...], begin_s: float, *, named: bool) -> None:
    low, high = axes.get_xlim()
    for number, motion in enumerate(motions):
        left, right = motion.begin_s - begin_s, motion.end_s - begin_s
        axes.axvspan(left, right, color=SHADES[number % 2], lw=0, zorder=-10)
        if named:
            crowded = (right - left) / (high - low) < 0.07
            axes.annotate(
                motion.name if crowded else f"{motion.name}\nto {motion.waypoint_deg:.1f}°",
                ((left + right) / 2, 1.0),
                xytext=(0, 4),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                ha="left" if crowded else "center",
                va="bottom",
                rotation=35 if crowded else 0,
                color="#333333",
                fontsize=FONT_PT,
            )
    axes.set_xlim(low, high)


def _mark_end(axes: Axes, run: RunFile, begin_s: float) -> None:
    """A line where a run was stopped by a person or a fault, or cut off, with the words for it."""
    status = str((run.result or {}).get("status", "")) if run.complete else "cut off"
    if status not in ("aborted", "fault", "cut off"):
        return
    last_s = run.span_s[1] - begin_s
    axes.axvline(last_s, color="#B00020", lw=1.5)
    axes.annotate(
        status,
        (last_s, 0.02),
        xycoords=("data", "axes fraction"),
        xytext=(-4, 0),
        textcoords="offset points",
        ha="right",
        color="#B00020",
        fontweight="bold",
        fontsize=10,
    )


def _draw_shaft(
    axes: Axes,
    run: RunFile,
    motions: tuple[Motion, ...],
    settled: Array,
    config: RigConfig,
) -> None:
    viridis = colormaps["viridis"]
    for number, (start, end) in enumerate(config.layout.tissue_sections_mm):
        axes.axvspan(start, end, color="#F3DFD2", lw=0, zorder=-10, label="tissue" if number == 0 else None)
    places_mm = np.array([0.0, *(sensor.position_mm for sensor in config.layout.hall_sensors)])
    order = np.argsort(places_mm)
    along_m, pictures = run.attributes.get("shaft_position_m"), None
    if along_m is not None and "shaft" in run.tables:
        pictures = run.table("shaft")
    for number, motion in enumerate(motions):
        colour = MOTIONS[number] if len(motions) <= len(MOTIONS) else viridis(number / len(motions))
        final = number == len(motions) - 1
        width = 2.4 if final else 1.3
        picture = _picture_of(motion, pictures)
        if picture is not None:
            axes.plot(mm(np.asarray(along_m)), deg(picture), color=colour, lw=width, zorder=2)
        else:
            axes.plot(places_mm[order], settled[number][order], color=colour, lw=width, ls="--", zorder=2)
        axes.plot(
            places_mm,
            settled[number],
            color=colour,
            marker="o" if final else "s",
            ms=7 if final else 5,
            ls="",
            mec="white",
            mew=0.8,
            zorder=3,
        )
        axes.plot(
            [],
            [],
            color=colour,
            lw=width,
            marker="o",
            label=f"{'after' if motion.settled else 'stopped in'} {motion.name}",
        )
    target_deg = _number(run.attributes.get("target_deg"))
    if np.isfinite(target_deg):
        axes.axhline(target_deg, color="#9A8F00", lw=1, ls=(0, (5, 3)), zorder=1, label="target")
    axes.set_xlim(-4, max(config.needle.length_mm, float(places_mm.max())) + 4)
    lines = "dashes only join them" if pictures is None else "lines: the simulated shaft"
    axes.set_xlabel(f"distance from the base / mm   (marks: measured; {lines})")
    axes.set_ylabel("angle after each motion / °")
    _tidy(axes)
    axes.legend(loc="center left", bbox_to_anchor=(1.005, 0.5), frameon=False, fontsize=FONT_PT)


def _picture_of(motion: Motion, pictures: Rows | None) -> Array | None:
    """The last picture of the simulated shaft within `motion`, in radians."""
    if pictures is None:
        return None
    within = np.flatnonzero(
        (pictures["time_s"] > motion.begin_s) & (pictures["time_s"] <= motion.end_s + 0.01)
    )
    return np.asarray(pictures["angle_rad"][within[-1]]) if len(within) else None


def _tidy(axes: Axes) -> None:
    axes.grid(color="#CCCCCC", lw=0.5, alpha=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.005)


def _title(run: RunFile) -> str:
    known, result = run.attributes, run.result or {}
    target = _number(known.get("target_deg"))
    parts = [f"{known.get('strategy', 'run')} to {target:g}°" if np.isfinite(target) else run.name]
    if run.simulated:
        parts.append(f"simulated {known.get('parameters') or 'rig'}")
    parts.append(str(result.get("status", "cut off")).replace("_", " "))
    final = result.get("final")
    if isinstance(final, dict) and isinstance(final.get("tip_lag_deg"), int | float):
        parts.append(f"tip lag {final['tip_lag_deg']:.1f}°")
    return "  ·  ".join([*parts, run.name])


def _number(value: Any) -> float:
    return float(value) if isinstance(value, int | float) else float("nan")
