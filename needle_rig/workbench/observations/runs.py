"""Recorded runs as trials of a dataset, so that a model can be held against them."""

from __future__ import annotations

import datetime
import math
from collections.abc import Sequence

import numpy as np

from needle_rig.control.in_si import layout_of, torsional_rigidity_nm2
from needle_rig.dataset import Dataset, DatasetTrial, Needle, TrialCommand, in_series
from needle_rig.dataset.records import Start
from needle_rig.dataset.samples import AT_REST_DEG, LeftOut, checked_trial
from needle_rig.errors import BadInput
from needle_rig.recording import RunFile
from needle_rig.units import m, rad

BEGIN_S = 0.2
_ACTIVE = (b"rest", b"moving", b"settling", b"measuring")


def runs_as_dataset(runs: Sequence[RunFile], name: str = "", start: Start | None = None) -> Dataset:
    """`runs` of one rig as a dataset, in the order in which they were made.

    Without `start` a run that began with the base at 0° began relaxed, another one wound. Raises BadInput for
    a run without a sequence, and for runs of rigs that differ in layout or needle, or of which some are
    simulated.
    """
    if not runs:
        raise BadInput("no run was named; list them with: needle-rig runs")
    first = min(_started_s(run) for run in runs)
    config = runs[0].config
    for run in runs[1:]:
        if (run.config.layout, run.config.needle) != (config.layout, config.needle):
            raise BadInput(
                f"{run.path}: its layout or needle differs from that of {runs[0].path}; keep them apart"
            )
    if len({run.simulated for run in runs}) > 1:
        shown = next(run.path for run in runs if run.simulated)
        raise BadInput(f"{shown}: was made on a simulated rig, others were not; keep them apart")
    diameter_m = m(config.needle.diameter_mm)
    trials = in_series(tuple(run_as_trial(run, _started_s(run) - first, start) for run in runs))
    return Dataset(
        name=name or runs[0].name,
        layout=layout_of(config),
        sensor_names=tuple(sensor.name for sensor in config.layout.hall_sensors),
        needle=Needle(
            diameter_m=diameter_m,
            shear_modulus_pa=torsional_rigidity_nm2(config) * 32.0 / (math.pi * diameter_m**4),
            density_kg_m3=config.needle.density_g_cm3 * 1e3,
        ),
        trials=trials,
        notes=tuple(note for trial in trials for note in trial.notes),
        simulated=runs[0].simulated,
    )


def run_as_trial(run: RunFile, start_s: float = 0.0, start: Start | None = None) -> DatasetTrial:
    """A run as a trial that began `start_s` after the first of its series. Raises BadInput."""
    shown, notes = str(run.path), []
    if not run.complete:
        notes.append(f"{shown}: the run was cut off; what was recorded is used")
    ticks = run.table("ticks")
    active = np.flatnonzero(np.isin(ticks["phase"], _ACTIVE)) if len(ticks) else np.empty(0, dtype=int)
    if len(active) <= 1:
        raise BadInput(f"{shown}: holds no sequence, so there is nothing to compare a model with")
    ticks = ticks[active[0] : active[-1] + 1]
    rows = np.arange(active[0], active[-1] + 1) + 1
    time_s = np.maximum.accumulate(ticks["time_s"] - ticks["time_s"][0])
    values = np.column_stack([time_s, ticks["base_angle_rad"], ticks["torque_nm"], ticks["hall_rad"]])
    if start is None:
        first = time_s < BEGIN_S
        begin_rad = ticks["base_angle_rad"][first]
        known_rad = begin_rad[np.isfinite(begin_rad)]
        start = "wound" if known_rad.size and abs(known_rad.mean()) > rad(AT_REST_DEG) else "relaxed"
    known = run.attributes
    strategy = str(known.get("strategy", "unknown"))
    command = TrialCommand(
        kind="compensate" if strategy == "reed2008" else strategy,
        target_deg=run.number("target_deg"),
        speed_deg_s=run.number("speed_deg_s", run.config.sequence.speed_deg_s),
        settle_s=run.number("settle_s", run.config.sequence.settle_s),
        other=(("options", str(known["options"])),) if known.get("options") else (),
    )
    sensors = tuple(sensor.name for sensor in run.config.layout.hall_sensors)
    phase = np.char.decode(ticks["motion"], "utf-8")
    try:
        return checked_trial(values, phase, rows, sensors, shown, command, start_s, notes, start=start)
    except LeftOut as left_out:
        raise BadInput(f"{left_out.place}: {left_out.reason}") from None


def _started_s(run: RunFile) -> float:
    """When it began, in seconds since 1970; 0 where it does not say."""
    try:
        return datetime.datetime.fromisoformat(str(run.attributes["started_utc"])).timestamp()
    except (KeyError, ValueError, OverflowError):
        return 0.0
