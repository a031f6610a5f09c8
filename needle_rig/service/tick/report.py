"""What the daemon tells: its state and a run's result as JSON documents in degrees, N·mm and mm."""

from __future__ import annotations

from collections.abc import Mapping

from needle_rig.config.schema import RigConfig
from needle_rig.control.in_si import torsional_rigidity_nm2
from needle_rig.control.reports import BrainState, Condition, Outcome
from needle_rig.control.strategy import SettledMotion
from needle_rig.numerics import rounded
from needle_rig.records import DriveFault, Firmware, Measurement
from needle_rig.service.api import documents
from needle_rig.units import deg, nmm


def _deg(angle_rad: float | None) -> float | None:
    return None if angle_rad is None else rounded(deg(angle_rad), 4)


def _nmm(torque_nm: float) -> float | None:
    return rounded(nmm(torque_nm), 5)


def _degrees(angles_rad: tuple[float, ...]) -> list[float | None]:
    return [_deg(angle) for angle in angles_rad]


def rig_document(config: RigConfig, *, simulated: bool) -> documents.Rig:
    """What does not change: the rig's name, its parameters when simulated, and its layout."""
    return {
        "name": config.name,
        "simulated": simulated,
        "parameters": config.simulation.parameters if config.simulation else None,
        "tick_hz": config.tick_hz,
        "needle_length_mm": config.needle.length_mm,
        "torsional_rigidity_nmm2": round(torsional_rigidity_nm2(config) * 1e6, 4),
        "tissue_sections_mm": [list(section) for section in config.layout.tissue_sections_mm],
        "hall_positions_mm": [sensor.position_mm for sensor in config.layout.hall_sensors],
        "angle_limit_deg": config.drive.angle_limit_deg,
    }


def state_document(state: BrainState) -> documents.Standing:
    """Where the brain stands and what the sensors say."""
    return {
        "time_s": rounded(state.time_s, 4),
        "phase": state.phase.value,
        "motion": state.motion,
        "motion_index": state.motion_index,
        "motions_expected": state.motions_expected,
        "waiting_for": state.waiting_for,
        "remaining_s": rounded(state.remaining_s, 2),
        "progress": round(state.progress, 4),
        "target_deg": _deg(state.target_rad),
        "strategy": state.strategy,
        "model": state.model,
        "waypoint_deg": _deg(state.waypoint_rad),
        "velocity_deg_s": _deg(state.velocity_rad_s),
        "limited": state.limited,
        "sensors": None if state.measurement is None else _sensors(state.measurement),
        "settled": [settled_document(motion) for motion in state.settled],
        "fault": state.fault,
        "fault_name": state.fault_name,
        "latched": state.latched,
        "released": state.released,
    }


def _sensors(measurement: Measurement) -> documents.Sensors:
    return {
        "base_deg": _deg(measurement.base_angle_rad),
        "torque_nmm": _nmm(measurement.torque_nm),
        "hall_deg": _degrees(measurement.hall_rad),
        "drive_state": measurement.drive_state.name.lower(),
        "referenced": measurement.referenced,
        "supply_on": measurement.supply_on,
        "emergency_stop": measurement.emergency_stop,
        "drive_faults": [
            (fault.name or "").lower() for fault in DriveFault if fault and fault in measurement.drive_faults
        ],
        "age_ms": {
            "torque": rounded(measurement.torque_age_s * 1e3, 1),
            "hall": rounded(measurement.hall_age_s * 1e3, 1),
            "drive": rounded(measurement.drive_age_s * 1e3, 1),
        },
    }


def firmware_document(told: Mapping[str, Firmware]) -> dict[str, documents.Node]:
    """What each node says of itself, by link."""
    return {
        link: {
            "text": _firmware_text(firmware),
            "protocol": firmware.protocol,
            "version": firmware.version,
            "build": f"{firmware.build:06x}" if firmware.build else None,
            "calibrated": firmware.calibrated,
            "calibration_serial": firmware.calibration_serial,
            "refusal": firmware.refusal or None,
        }
        for link, firmware in told.items()
    }


def _firmware_text(firmware: Firmware) -> str:
    if firmware.protocol is None:
        return "version unknown"
    said = [firmware.version or "version not told yet"]
    if firmware.build:
        said.append(f"build {firmware.build:06x}")
    said.append(f"protocol {firmware.protocol}{' (not known here)' if firmware.refusal else ''}")
    if firmware.calibrated is not None:
        said.append(f"calibration {firmware.calibration_serial}" if firmware.calibrated else "not calibrated")
    return ", ".join(said)


def settled_document(motion: SettledMotion) -> documents.Settled:
    """One settled motion with what the model behind the torque predicts."""
    return {
        "phase": motion.name,
        "waypoint_deg": _deg(motion.waypoint_rad),
        "base_deg": _deg(motion.base_angle_rad),
        "torque_nmm": _nmm(motion.torque_nm),
        "predicted_lag_deg": _deg(motion.predicted_lag_rad),
        "hall_deg": _degrees(motion.hall_rad),
        "tip_lag_deg": _deg(motion.tip_lag_rad),
        "moved_s": rounded(motion.moved_s, 4),
        "settled_s": rounded(motion.time_s, 4),
    }


def result_document(
    outcome: Outcome, settled: tuple[SettledMotion, ...], rig: documents.Rig, run: str
) -> documents.Result:
    """The result of a run: the object that `needle-rig compensate --json` prints."""
    return {
        "status": outcome.status,
        "target_deg": _deg(outcome.target_rad),
        "strategy": outcome.strategy,
        "simulated": rig["simulated"],
        "parameters": rig["parameters"],
        "lag_deg": _deg(outcome.lag_rad),
        "motions": [
            {
                "phase": motion.name,
                "base_deg": _deg(motion.base_angle_rad),
                "torque_nmm": _nmm(motion.torque_nm),
                "hall_deg": _degrees(motion.hall_rad),
            }
            for motion in settled
        ],
        "final": {
            "base_deg": _deg(outcome.base_angle_rad),
            "torque_nmm": _nmm(outcome.torque_nm),
            "hall_deg": _degrees(outcome.hall_rad),
            "tip_lag_deg": _deg(outcome.tip_lag_rad),
            "mean_deg": _deg(outcome.mean_rad),
            "range_deg": _deg(outcome.range_rad),
        },
        "run": run,
        "fault_name": outcome.fault_name,
    }


def condition_document(condition: Condition) -> documents.Condition:
    """One of the paper's conditions, in degrees or N·mm."""
    angle = condition.unit == "rad"
    convert = deg if angle else nmm
    return {
        "name": condition.name,
        "text": condition.text,
        "value": rounded(convert(condition.value), 5),
        "limit": rounded(convert(condition.limit), 5),
        "unit": "°" if angle else "N·mm",
        "met": condition.met,
    }
