"""The last gate before the drive: pure functions from a measurement and a wish to a command, or a fault.

Limited is not broken: a wish that is too fast is cut and goes on. A fault stops the drive. Temporary faults
end with their cause (a link that comes back); latching ones stay until a person clears them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from needle_rig.control.faults import Fault, FaultName
from needle_rig.records import COMMAND_AGE_S, STOP, TEMPORARY, Command, DriveFault, DriveState, Measurement
from needle_rig.units import deg, nmm, rad

ROUNDING = 1e-9
ANGLE_MARGIN_RAD = rad(1.0)
"""A base that was sent to the limit itself may come to rest beyond it by what its control leaves; half of the
drive node's own margin."""
LINKS = frozenset({"torque", "hall", "drive"})

DRIVE_SENTENCES: dict[DriveFault, str] = {
    DriveFault.COMMAND_AGE: f"no valid command reached it for {COMMAND_AGE_S * 1e3:g} ms; check the bus, this"
    " computer's load, and that no other master speaks to it",
    DriveFault.HEARTBEAT: "this computer's heartbeat stood still; check its load",
    DriveFault.VELOCITY: "it was asked to turn faster than its own limit; lower drive.velocity_limit_deg_s",
    DriveFault.ANGLE: "it left its own angle range; turn the base back by hand",
    DriveFault.TORQUE_TRIP: "the torque at the base passed its own trip level; free the needle",
    DriveFault.ENCODER: "its encoder reports an error; check the cable",
    DriveFault.FRAME: "too many commands or torque frames arrived damaged; check the bus and its termination",
    DriveFault.TORQUE_AGE: "the torque node went quiet; check its power and the bus",
    DriveFault.STALL: "it was asked to turn and did not: the motor is dead, blocked or off its supply, or the"
    " encoder stands still; check them",
    DriveFault.RUNAWAY: "it turned more than it was asked to; check the power stage and the encoder's scale",
    DriveFault.DIRECTION: "it turned against what was asked; check the wiring of motor and encoder",
    DriveFault.IDLE_MOTION: "it moved while nothing was asked of it; check the power stage (if you turned it"
    " by hand, `needle-rig release` it first)",
    DriveFault.MASTER: "another master sends it commands; take that one off the bus",
    DriveFault.EMERGENCY_STOP: "the emergency stop was pressed, or its supply was cut; release it",
}
_NAMES = {
    DriveFault.STALL: FaultName.NOT_TURNING,
    DriveFault.RUNAWAY: FaultName.RUNAWAY,
    DriveFault.DIRECTION: FaultName.WRONG_DIRECTION,
    DriveFault.IDLE_MOTION: FaultName.IDLE_MOTION,
    DriveFault.MASTER: FaultName.SECOND_MASTER,
    DriveFault.EMERGENCY_STOP: FaultName.EMERGENCY_STOP,
    DriveFault.ANGLE: FaultName.ANGLE_LIMIT,
    DriveFault.TORQUE_TRIP: FaultName.TORQUE_LIMIT,
}
"""What the drive node and this host both know keeps one name."""


@dataclass(frozen=True)
class Limits:
    """What the gate holds to: SI; ages are the oldest value that may still be used."""

    angle_rad: float
    velocity_rad_s: float
    acceleration_rad_s2: float
    torque_nm: float
    torque_age_s: float
    hall_age_s: float
    drive_age_s: float


@dataclass(frozen=True)
class Gated:
    """The command that may go out, and whether it is less than what was asked for."""

    command: Command
    limited: bool
    fault: Fault | None = None


def heard_age_s(before_s: float, age_s: float, dt_s: float, listening_s: float) -> float:
    """What of `age_s` is evidence of a dead link: time in which this host listened to it.

    `before_s` is the result of the tick before (infinite at the first), `dt_s` the time since then, of which
    at most `listening_s` counts: a host that stood still longer heard nothing because of itself. That is
    granted once: a link from which nothing came since the host was late before has its whole age. A host that
    keeps time gets the age itself, never more; an infinite age (no value yet) is one at once.
    """
    late_before = age_s - dt_s > before_s + listening_s
    if not age_s < math.inf or (late_before and dt_s > listening_s):
        return age_s
    return min(age_s, before_s + min(dt_s, listening_s))


def slow_host_fault(measurement: Measurement, dt_s: float, limits: Limits) -> Fault | None:
    """For a host whose ticks come late in a row: a link that will be too old at the next tick, which comes in
    `dt_s`, is dead at this one; or None. A slow host shall not make a dead link look alive.
    """
    for link, age_s, limit_s, _ in _ages(measurement, limits):
        if age_s + dt_s > limit_s:
            return Fault(
                FaultName.LATE_TICK,
                link,
                f"this computer is too slow for the {link} link: its newest value is {age_s * 1e3:.0f} ms"
                f" old, the next look at it comes in {dt_s * 1e3:.0f} ms, limit {limit_s * 1e3:g} ms;"
                " end other programs, or lower tick_hz",
                latching=False,
            )
    return None


def find_faults(measurement: Measurement, limits: Limits) -> tuple[frozenset[str], list[Fault]]:
    """The links whose values may be used, and everything in these values that forbids motion.

    A dead link hides what it alone tells, and nothing that others tell. The drive's own faults are not among
    them: see `drive_faults`.
    """
    heard, found = (LINKS, []) if _all_good(measurement, limits) else _judged_links(measurement, limits)
    if "torque" in heard and abs(measurement.torque_nm) > limits.torque_nm:
        found.append(
            Fault(
                FaultName.TORQUE_LIMIT,
                "torque",
                f"the base torque is {nmm(measurement.torque_nm):.3f} N·mm, above the limit of"
                f" {nmm(limits.torque_nm):g} N·mm (drive.torque_limit_nmm); free the needle,"
                " then: needle-rig clear",
                latching=True,
            )
        )
    if "drive" in heard and abs(measurement.base_angle_rad) > limits.angle_rad + ANGLE_MARGIN_RAD:
        found.append(
            Fault(
                FaultName.ANGLE_LIMIT,
                "drive",
                f"the base stands at {deg(measurement.base_angle_rad):.1f}°, outside"
                f" ±{deg(limits.angle_rad):g}° (drive.angle_limit_deg) by more than"
                f" {deg(ANGLE_MARGIN_RAD):g}°; turn it back by hand, then:"
                " needle-rig clear",
                latching=True,
            )
        )
    if measurement.emergency_stop:
        found.append(
            Fault(
                FaultName.EMERGENCY_STOP,
                "drive",
                "the emergency stop is pressed; release it, then: needle-rig clear",
                latching=True,
            )
        )
    return heard, found


def _all_good(measurement: Measurement, limits: Limits) -> bool:
    """Whether every link is heard and gives numbers, as nearly always; `_judged_links` says which not."""
    return (
        measurement.torque_age_s <= limits.torque_age_s
        and measurement.hall_age_s <= limits.hall_age_s
        and measurement.drive_age_s <= limits.drive_age_s
        and math.isfinite(measurement.torque_nm)
        and math.isfinite(measurement.base_angle_rad)
        and all(map(math.isfinite, measurement.hall_rad))
    )


def _judged_links(measurement: Measurement, limits: Limits) -> tuple[frozenset[str], list[Fault]]:
    """The links whose values may be used, and a fault for each of the others; dead ones first."""
    found: list[Fault] = []
    no_numbers: list[Fault] = []
    heard = set()
    finite = {
        "torque": math.isfinite(measurement.torque_nm),
        "hall": all(map(math.isfinite, measurement.hall_rad)),
        "drive": math.isfinite(measurement.base_angle_rad),
    }
    for link, age_s, limit_s, complaint in _ages(measurement, limits):
        if not age_s <= limit_s:
            found.append(
                Fault(FaultName.LINK_DEAD, link, _stale(link, age_s, limit_s, complaint), latching=False)
            )
        elif not finite[link]:
            no_numbers.append(Fault(FaultName.NOT_A_NUMBER, link, _NO_NUMBER[link], latching=False))
        else:
            heard.add(link)
    return frozenset(heard), [*found, *no_numbers]


_NO_NUMBER = {
    "torque": "the torque link gives a value that is no number; check the cell",
    "hall": "the hall link gives an angle that is no number; check the sensors",
    "drive": "the drive link gives an angle that is no number; check the encoder",
}


def drive_faults(state: DriveState, faults: DriveFault, complaint: str = "") -> list[Fault]:
    """The drive's own faults, one for each bit, with what else it says; the temporary ones do not latch."""
    if not faults and state is not DriveState.FAULT:
        return []
    found = [_own(bit, sentence, complaint) for bit, sentence in DRIVE_SENTENCES.items() if bit in faults]
    return found or [_own(DriveFault.NONE, "" if complaint else "it gives no reason", complaint)]


def _own(bit: DriveFault, sentence: str, complaint: str) -> Fault:
    latching = bit not in TEMPORARY or not bit
    text = "the drive stopped by itself: " + "; ".join(filter(None, (sentence, complaint)))
    return Fault(
        _NAMES.get(bit, FaultName.DRIVE),
        "drive",
        text + (", then: needle-rig clear" if latching else ""),
        latching,
        DriveFault.NONE if bit in _NAMES else bit,
    )


def tick_fault(dt_s: float) -> Fault | None:
    """A tick whose length cannot be right, or None."""
    if 0.0 < dt_s < math.inf:
        return None
    return Fault(
        FaultName.LATE_TICK,
        "control",
        f"a tick took {dt_s} s; check the clock of this computer",
        latching=False,
    )


def gate(
    velocity_rad_s: float, measurement: Measurement, last_velocity_rad_s: float, dt_s: float, limits: Limits
) -> Gated:
    """The command that may go out for a wish of `velocity_rad_s`; STOP and the fault when something is wrong.

    Cuts speed to the velocity limit, to what can still brake before the angle limit, and its change to the
    acceleration limit over `dt_s`.
    """
    _, found = find_faults(measurement, limits)
    found += drive_faults(measurement.drive_state, measurement.drive_faults, measurement.drive_complaint)
    fault = next(iter(found), None)
    if fault is None and not math.isfinite(velocity_rad_s):
        fault = Fault(
            FaultName.CONTROL,
            "control",
            "the control loop asks for a speed that is no number; report this",
            latching=True,
        )
    fault = fault or tick_fault(dt_s)
    if fault is not None:
        return Gated(STOP, limited=False, fault=fault)
    low, high = -limits.velocity_rad_s, limits.velocity_rad_s
    high = min(high, _braking_speed(limits.angle_rad - measurement.base_angle_rad, limits))
    low = max(low, -_braking_speed(limits.angle_rad + measurement.base_angle_rad, limits))
    velocity = min(max(velocity_rad_s, low), high)
    change = limits.acceleration_rad_s2 * dt_s
    velocity = min(max(velocity, last_velocity_rad_s - change), last_velocity_rad_s + change)
    limited = abs(velocity - velocity_rad_s) > ROUNDING
    return Gated(Command(velocity_rad_s=velocity, enable=True), limited)


def _braking_speed(room_rad: float, limits: Limits) -> float:
    return math.sqrt(2.0 * limits.acceleration_rad_s2 * max(room_rad, 0.0))


def _ages(measurement: Measurement, limits: Limits) -> tuple[tuple[str, float, float, str], ...]:
    """Every link with its age, its limit and its complaint."""
    return (
        ("torque", measurement.torque_age_s, limits.torque_age_s, measurement.torque_complaint),
        ("hall", measurement.hall_age_s, limits.hall_age_s, measurement.hall_complaint),
        ("drive", measurement.drive_age_s, limits.drive_age_s, measurement.drive_complaint),
    )


def _stale(link: str, age_s: float, limit_s: float, complaint: str) -> str:
    if complaint:
        return f"the {link} link gives no good value: {complaint}"
    what = {"torque": "torque sensor", "hall": "Hall sensors"}.get(link, "drive")
    where = f"the {what}, cable and supply"
    if math.isinf(age_s):
        return f"the {link} link has given no value yet; check {where}"
    return (
        f"the {link} link is dead: its newest value is {age_s * 1e3:.0f} ms old, limit {limit_s * 1e3:g} ms;"
        f" check {where}"
    )
