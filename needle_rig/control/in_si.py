"""A rig file in SI, as control takes it."""

from __future__ import annotations

import math

from needle_rig.config.schema import RigConfig
from needle_rig.control.following import FollowingLimits
from needle_rig.control.limits import Limits
from needle_rig.control.shaft import shaft_limits
from needle_rig.control.supervision import Supervision
from needle_rig.physics.rod import Layout
from needle_rig.units import m, nm, rad


def layout_of(config: RigConfig) -> Layout:
    """The layout of a rig file in metres."""
    return Layout(
        needle_length_m=m(config.needle.length_mm),
        tissue_sections_m=tuple((m(a), m(b)) for a, b in config.layout.tissue_sections_mm),
        sensor_positions_m=tuple(m(sensor.position_mm) for sensor in config.layout.hall_sensors),
    )


def torsional_rigidity_nm2(config: RigConfig) -> float:
    """JG of the needle in N·m²: as stated, or shear modulus times π d⁴/32."""
    if config.needle.torsional_rigidity_nmm2 is not None:
        return config.needle.torsional_rigidity_nmm2 * 1e-6
    diameter = m(config.needle.diameter_mm)
    return config.needle.shear_modulus_gpa * 1e9 * math.pi * diameter**4 / 32.0


def limits_of(config: RigConfig) -> Limits:
    """The gate's limits of a rig file in SI."""
    return Limits(
        angle_rad=rad(config.drive.angle_limit_deg),
        velocity_rad_s=rad(config.drive.velocity_limit_deg_s),
        acceleration_rad_s2=rad(config.drive.acceleration_limit_deg_s2),
        torque_nm=nm(config.drive.torque_limit_nmm),
        torque_age_s=config.links.torque_age_limit_ms * 1e-3,
        hall_age_s=config.links.hall_age_limit_ms * 1e-3,
        drive_age_s=config.links.drive_age_limit_ms * 1e-3,
    )


def supervision_of(config: RigConfig) -> Supervision:
    """What watches the rig of a rig file."""
    drive = config.drive
    return Supervision(
        FollowingLimits(rad(drive.following_deg), drive.response_ms * 1e-3),
        shaft_limits(drive.disagreement_deg, drive.windup_limit_deg, drive.travel_limit_deg),
        rad(drive.reference_tolerance_deg),
        layout_of(config),
        torsional_rigidity_nm2(config),
    )
