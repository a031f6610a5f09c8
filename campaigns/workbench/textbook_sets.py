"""Datasets of the needle that is not ours (`tests/physics/textbook_needle.py`).

Drive, sensors, noise and scatter are ours, and a law of drive or sensors that is added by hand.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from needle_rig.control.strategy import Task, Waypoint, make_strategy
from needle_rig.dataset import Dataset, DatasetTrial, Needle, denoised_base
from needle_rig.dataset.protocol import Protocol
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect, Reading, Trial
from needle_rig.simulation.drive.base_drive import phases
from needle_rig.units import nm, rad
from needle_rig.workbench.virtual.dataset import DENSITY_KG_M3, DIAMETER_M, LaggedDrive, driven
from needle_rig.workbench.virtual.noise import Noise
from needle_rig.workbench.virtual.settled_run import carried_out
from tests.physics.textbook_needle import TextbookNeedle, needle

RATE_HZ = 50.0
STRIBECK_RATE_RAD_S = 0.2
NULL = load_parameters("rig_rigid")


def rig(ratio: float, damping: float, exponent: float) -> TextbookNeedle:
    """The needle of the parameter set rig_rigid with this friction."""
    return needle(
        NULL.layout,
        NULL.torsional_rigidity_nm2,
        kinetic_n=NULL.friction_n,
        kinetic_over_static=ratio,
        stribeck_rate_rad_s=STRIBECK_RATE_RAD_S,
        exponent=exponent,
        damping_ns=damping * 1e-2,
    )


def scattered(plain: TextbookNeedle, random: np.random.Generator, noise: Noise) -> TextbookNeedle:
    """The needle with the friction of one trial, static and kinetic alike."""
    factor = max(0.05, 1.0 + noise.friction_scatter * float(random.standard_normal()))
    law = dataclasses.replace(plain.friction, kinetic_n=factor * plain.friction.kinetic_n)
    return dataclasses.replace(plain, friction=law)


def dataset(
    plain: TextbookNeedle,
    protocol: Protocol,
    seed: int,
    noise: Noise,
    name: str,
    effect: Effect | None = None,
) -> Dataset:
    """A series of trials of the needle, as `simulate_dataset` makes one of ours.

    An `effect` of drive or sensors acts before and after it.
    """
    trials: list[DatasetTrial] = []
    start_s, travel_rad = 0.0, 0.0
    for index, command in enumerate(protocol.trials):
        random = np.random.default_rng([seed, index + 1])
        one = scattered(plain, random, noise)
        place = Trial(np.empty(0), np.empty(0), start_s, index, travel_rad)
        drive = LaggedDrive(place, RATE_HZ)
        speed, settle = rad(command.speed_deg_s or 45.0), command.settle_s or 3.0
        for k, step_deg in enumerate(command.steps_deg, start=1):
            drive.add(Waypoint(rad(step_deg), f"step_{k}"), speed, settle)
        if not command.steps_deg:
            task = Task(
                rad(command.target_deg or 0.0), NULL.layout, NULL.torsional_rigidity_nm2, speed, settle
            )
            carried_out(make_strategy("reed2008", {}), task, drive, one, random, noise)  # type: ignore[arg-type]
        trial = driven(drive.motions, drive.motions[-1].end_s, place, RATE_HZ)
        held = effect.drive(trial) if effect and effect.has("drive") else trial.base_angle_rad
        seen = one.moved(dataclasses.replace(trial, base_angle_rad=held))
        reading = Reading(trial, seen.torques_nm, seen.halls_rad)
        if effect and effect.has("observe"):
            reading = effect.observe(reading)
        base = trial.base_angle_rad + rad(noise.encoder_deg) * random.standard_normal(len(trial.time_s))
        path = denoised_base(trial.time_s, base)
        torque = reading.torque_nm + nm(noise.torque_nmm) * random.standard_normal(reading.torque_nm.shape)
        halls = reading.hall_rad + rad(noise.hall_deg) * random.standard_normal(reading.hall_rad.shape)
        trials.append(
            DatasetTrial(
                trial=dataclasses.replace(trial, base_angle_rad=path.angle_rad),
                base_measured_rad=base,
                base_residual_rad=path.residual_rad,
                torque_nm=torque,
                hall_rad=halls,
                phase=phases(drive.motions, trial.time_s),
                command=command,
                file=f"trials/{index + 1:02d}.csv",
            )
        )
        travel_rad += float(np.abs(np.diff(trial.base_angle_rad)).sum())
        start_s = round(start_s + drive.motions[-1].end_s + protocol.pause_s, 1)
    polar_m4 = np.pi * DIAMETER_M**4 / 32.0
    wire = Needle(DIAMETER_M, NULL.torsional_rigidity_nm2 / polar_m4, DENSITY_KG_M3)
    names = tuple(f"hall_{k}" for k in range(1, len(NULL.layout.sensor_positions_m) + 1))
    return Dataset(name, NULL.layout, names, wire, tuple(trials))
