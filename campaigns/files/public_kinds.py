"""Twelve public recordings of drives, joints, cables and slides, made small again.

Shape, columns, units and rates were read from the repositories that each case names; the numbers are those of
a plain law. Each case says what its owner knows: which column is what, and what he would recognise.
"""

from __future__ import annotations

import datetime
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.numerics import Array
from tests.importing.machines import Joint, after_play, swings

TURN = 2.0 * np.pi
TICK = TURN / 4096


@dataclass(frozen=True)
class Is:
    """What one column is: its unit, scale and sign; any of several columns that hold the same."""

    sources: tuple[str, ...]
    unit: str
    scale: float = 1.0
    sign: int = 1


@dataclass(frozen=True)
class Public:
    """Files of a case, its true channels by role, and what is expected of the answers."""

    file: Path
    machine: str
    channels: dict[str, Is]
    rate_rad_s: Array | None = None
    """Of the base, with `torque_nm`: what a plain least-squares fit is made of, both (samples,)."""
    torque_nm: Array | None = None
    lever_mm: float | None = None
    rate_hz: float | None = None
    """Known to the owner alone, where the file has no time."""
    lag_deg: float | None = None
    """By which the far end comes behind where all slips: half a play."""
    effects: tuple[str, ...] = ()
    """Any of them answers a diagnosis as its owner would; none where friction is the answer."""
    cleaned: Callable[[Path], None] | None = None
    """What its owner does to the file once the import says what is wrong with it."""


Make = Callable[[Path], Public]
CASES: dict[str, Make] = {}


def case(function: Make) -> Make:
    CASES[function.__name__] = function
    return function


def rows(path: Path, head: Sequence[str], table: Array, delimiter: str = ",", digits: str = "%.17g") -> Path:
    """Text as csv.writer and print write it."""
    lines = [*head, *(delimiter.join(digits % v for v in row) for row in table)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@case
def actuator_dynamometer(folder: Path) -> Public:
    """karthikurs/actuator-dynamometer: a motor, a torque cell and a geared actuator that is dragged."""
    rng = np.random.default_rng(1)
    time_s, a1, rate = swings(60.0, 33.0)
    far = after_play(a1, 0.02)
    torque = Joint(0.8, 0.1, 0.02, noise_nm=0.004).torque_nm(far, np.gradient(far, time_s), rng)
    time_s = time_s + 0.002 * rng.random(len(time_s))
    n = len(time_s)
    zero = np.zeros(n)
    first, second = a1 - 2.743, far - 0.134
    c1, c2 = np.round(first / TURN * 16384) / 16384, np.round(second * 6 / TURN * 16384) / 16384
    c1_torque, c2_torque = 0.2 * rng.standard_normal(n), 0.02 * rng.standard_normal(n)
    names = (
        "time [s],a1 q-axis cmd [A],a1 torque cmd [Nm],a1 position [rad],a1 velocity [rad/s],a1 torque [Nm],"
        "a2 position [rad],a2 velocity [rad/s],a2 torque [Nm],c1 mode,c1 position [rev],c1 vel [Hz],"
        "c1 torque [Nm],c1 voltage [V],c1 temp [C],c1 fault,c2 mode,c2 position [rev],c2 vel [Hz],"
        "c2 torque [Nm],c2 voltage [V],c2 temp [C],c2 fault,trd605 torque [Nm],temp 1 [C],temp 2 [C]"
    )
    far_rate = np.gradient(far, time_s) + 0.01 * rng.standard_normal(n)
    seen = rate + 0.06 * rng.standard_normal(n)
    cell = np.round(torque / 0.00135) * 0.00135
    table = [time_s, 10 * torque, torque, c1 * TURN, seen, c1_torque, c2 * TURN / 6, far_rate, 6 * c2_torque]
    table += [zero + 9, c1, seen / TURN, c1_torque, zero + 36, zero + 27, zero]
    table += [zero + 10, c2, far_rate * 6 / TURN, c2_torque, zero + 36.5, zero + 26, zero]
    table += [cell, 24.0 + 0.1 * rng.random(n), 24.4 + 0.1 * rng.random(n)]
    head = [
        "# Test started at Tue Apr 13 18:23:45 2021",
        "# Labels:",
        "# \t a1 = actuator 1. Values at *actuator* level after gearbox",
        "# \t c1 = moteus controller 1. Values at *motor* level (no gearbox)",
        "# Note: Data assumes gearbox is 100pc efficient",
        "# ",
        "# kt_1 = 0.12093192290400524; kt_2 = 0.12642882849055095",
        names,
    ]
    return Public(
        rows(folder / "futek_test.csv", head, np.column_stack(table)),
        "shaft",
        {
            "base_angle": Is(("a1 position [rad]", "c1 position [rev]"), "rad"),
            "angle_1": Is(("a2 position [rad]",), "rad"),
            "base_torque": Is(("trd605 torque [Nm]",), "N·m"),
        },
        rate,
        cell,
    )


@case
def ultrasound_probe(folder: Path) -> Public:
    """bfortuno/TEE-Probe_hysteresis_id: motor steps against the tip's orientation, three sheets, no time."""
    import pandas

    def sheet(seed: int) -> pandas.DataFrame:
        rng = np.random.default_rng(seed)
        steps = np.round(2000 * np.sin(np.arange(300) * TURN / 100))
        motor = steps * TICK
        tip = 0.25 * after_play(motor, 0.8)
        n = len(steps)

        def tracker(about: Array) -> dict[str, Array]:
            half = about / 2 + 0.0005 * rng.standard_normal(n)
            small = 0.001 * rng.standard_normal((2, n))
            return {"X": small[0], "Y": small[1], "Z": np.sin(half), "W": np.cos(half)}

        told = {"Current": 60.0 + 5 * rng.standard_normal(n), "MotorPosition": steps}
        for name, about in (("Tip", tip), ("Base", np.zeros(n))):
            told |= {f"{name}Position{k}": 100.0 + 0.05 * rng.standard_normal(n) for k in "XYZ"}
            told |= {f"{name}Orientation{k}": v for k, v in tracker(about).items()}
        return pandas.DataFrame(told)

    with pandas.ExcelWriter(folder / "motor1_current60.xlsx") as book:
        for k in range(3):
            sheet(k).to_excel(book, sheet_name=f"Sheet{k + 1}", index=False)
    return Public(
        folder / "motor1_current60.xlsx",
        "cable",
        {
            "base_angle": Is(("MotorPosition",), "turn", 1 / 4096),
            "angle_1": Is(("TipOrientationZ",), "rad", 2.0),
        },
        rate_hz=30.0,
        effects=("hall_gain",),
    )


@case
def arm_of_seven_joints(folder: Path) -> Public:
    """YIZHIXIAOCANGSHU/Friction-Identification-for-Manipulators: joint 6 moves; its Coulomb is 0.168 N·m."""
    rng = np.random.default_rng(3)
    time_s, angle, rate = swings(30.0, 100.0)
    q = 2e-5 * rng.standard_normal((len(time_s), 7)) + np.linspace(-1.0, 1.0, 7)
    tau = 0.01 * rng.standard_normal((len(time_s), 7)) + np.linspace(2.0, 0.5, 7)
    q[:, 5] += angle
    tau[:, 5] = Joint(0.168, 0.0, -0.05).torque_nm(angle, rate, rng)
    qd = np.gradient(q, time_s, axis=0)
    np.savez(folder / "real_uart_capture_collect_joint_6.npz", time=time_s, q=q, qd=qd, tau_measured=tau)
    return Public(
        folder / "real_uart_capture_collect_joint_6.npz",
        "joint",
        {"base_angle": Is(("q.6",), "rad"), "base_torque": Is(("tau_measured.6",), "N·m")},
        rate,
        tau[:, 5],
    )


@case
def two_motor_servo(folder: Path) -> Public:
    """malik-robert/HSM150-data: steps of torque one way, seven columns without names beside two currents."""
    from scipy.io import savemat

    rng = np.random.default_rng(4)
    time_s = np.arange(0.0, 20.0, 0.005)
    torque = np.where(time_s < 10.0, -0.03, -0.045)
    rate, at = np.empty_like(time_s), -8.0
    for k, m in enumerate(torque):
        at += 0.005 * (m + 0.01 - 0.0025 * at) / 0.004
        rate[k] = at
    angle = np.cumsum(rate) * 0.005
    measured = torque + 0.0002 * rng.standard_normal(len(torque))
    noisy = rate + 0.02 * rng.standard_normal(len(rate))
    other = 0.001 * rng.standard_normal((2, len(rate)))
    table = np.column_stack((time_s, torque, angle, noisy, measured, other[0], other[1]))
    savemat(folder / "idf_neg_0.045_1.mat", {"data": table, "Iz1": measured * 9.0, "Im1": measured * 9.1})
    return Public(
        folder / "idf_neg_0.045_1.mat",
        "joint",
        {"base_angle": Is(("data.3",), "rad"), "base_torque": Is(("data.5", "data.2"), "N·m")},
        rate,
        measured,
    )


THRUST = (
    "Time (s),ESC signal (µs),Servo 1 (µs),Servo 2 (µs),Servo 3 (µs),AccX (g),AccY (g),AccZ (g),Torque (N·m),"
    "Thrust (kgf),Voltage (V),Current (A),Motor Electrical Speed (RPM),Motor Optical Speed (RPM),"
    "Electrical Power (W),Mechanical Power (W),Motor Efficiency (%),Propeller Mech. Efficiency (kgf/W),"
    "Overall Efficiency (kgf/W),Left Load Cell (mV),Right Load Cell (mV),Thrust Load Cell (mV),"
    "Vibration (g),Burst Current Cutoff (A),"
    "Pin State 1,Pin State 2,Pin State 3,Pin State 4,Debug 0,Debug 1,Debug 2,Debug 3,"
    "App message,"
)


@case
def thrust_stand(folder: Path) -> Public:
    """amantiwary10/Servo-Motor-System-Identification: a thrust stand whose first row is a late one."""
    rng = np.random.default_rng(5)
    n = 300
    time_s = 0.24 + 5.5 * np.arange(n) + 0.02 * rng.random(n)
    esc = 1000 + 1000 / n * np.arange(n)
    rpm = np.round(50 + 120 * (1 - np.cos(np.arange(n) / 15)) + rng.standard_normal(n))
    rate = rpm * TURN / 60
    torque = 0.049 + 0.004 * rate + 4e-4 * rng.standard_normal(n)
    lines = [THRUST]
    for k in range(n):
        time = "0.28001775000034834" if k == 0 else f"{time_s[k]:.17g}"
        small = 0.01 * rng.standard_normal(3)
        pins = rng.choice((0.3, 0.35, 0.4, 0.45)), rng.choice((0, 0.05, 0.1, 0.15))
        # as in the file, the second and third servo have no column in a row
        cells = [time, "", "", "", f"{esc[k]:.17g}", *(f"{v:.9g}" for v in small), f"{torque[k]:.17g}"]
        cells += [f"{-0.039 + 1e-3 * small[0]:.9g}", "0", "-0.0255", "0", f"{rpm[k]:g}", "0"]
        cells += [f"{torque[k] * rate[k]:.9g}", "0", "0.1555", "0", f"{torque[k] / 1.2:.9g}", "-0.2937"]
        cells += ["-0.0394", "0.0867", "-0.02647", "0", f"{pins[0]:g}", "1"]
        cells += [f"{pins[1]:g}", "0", "0", "0", "0", "", ""]
        lines.append(",".join(cells))
    (folder / "StepsTest.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")

    def cleaned(file: Path) -> None:
        text = file.read_text(encoding="utf-8").splitlines()
        file.write_text("\n".join([text[0], *text[2:]]) + "\n", encoding="utf-8")

    return Public(
        folder / "StepsTest.csv",
        "joint",
        {
            "base_angle": Is(("Motor Optical Speed (RPM)",), "rpm"),
            "base_torque": Is(("Torque (N·m)",), "N·m"),
        },
        rate[1:],
        torque[1:],
        cleaned=cleaned,
    )


@case
def rack_and_pinion(folder: Path) -> Public:
    """KonradMnich/friction-identification: force and position as volts, each with a time of its own."""
    rng = np.random.default_rng(6)
    time_s, angle, rate = swings(15.0, 400.0)
    place_mm, rate_mm_s = 10.0 * angle, 10.0 * rate
    force_n = Joint(16.8, 0.5, 2.0, noise_nm=0.3).torque_nm(angle, rate, rng)
    volts = np.column_stack((time_s, force_n / 30.0 - 0.129, time_s, place_mm / 4.0 - 3.216))
    head = [
        "Timestamp,2020-03-16 17:04:51,Timestamp,2020-03-16 17:04:51",
        "Interval,0.0025,Interval,0.0025",
        'Channel name,"Force",Channel name,"Input 1"',
        'Unit,"V",Unit,"V"',
    ]
    return Public(
        rows(folder / "a3NI.csv", head, volts),
        "linear",
        {"base_angle": Is(("Input 1",), "mm", 4.0), "base_torque": Is(("Force",), "N", 30.0)},
        rate_mm_s / 10.0,
        (force_n - 0.129 * 30.0) * 0.01,
        lever_mm=10.0,
    )


@case
def motor_by_its_speed(folder: Path) -> Public:
    """neurobionics/TMotorCANControl: torque by a cell and speed by the drive, without units."""
    rng = np.random.default_rng(7)
    time_s, angle, rate = swings(40.0, 100.0)
    torque = Joint(0.6, 0.12, 0.2, noise_nm=0.03).torque_nm(angle, rate, rng)
    seen = np.round((4 * rate + 0.06 * rng.standard_normal(len(rate))) / 0.0244) * 0.0244 + 0.0122
    own = torque / 0.8 + 0.2 * rng.standard_normal(len(rate))
    names = (
        "loop_time,motor_torque_command,adc_measured_torque,motor_measured_torque,motor_measured_current,"
        "motor_measured_speed"
    )
    table = np.column_stack((time_s, np.round(own), torque, own, own / 1.314, seen))
    return Public(
        rows(folder / "log_adc_and_motor.csv", [names], table),
        "joint",
        {
            "base_angle": Is(("motor_measured_speed",), "rad/s"),
            "base_torque": Is(("adc_measured_torque",), "N·m"),
        },
        4 * rate,
        torque,
    )


@case
def brake_torque(folder: Path) -> Public:
    """karthikurs/actuator-dynamometer, brake test: speed in Hz and torque, without an angle."""
    rng = np.random.default_rng(8)
    time_s, angle, rate = swings(40.0, 33.0)
    torque = Joint(0.3, 0.02, 0.0, noise_nm=0.005).torque_nm(angle, rate, rng)
    names = "time [s],c1 vel [Hz],trd605 torque [Nm],brake current [A],temp 1 [C]"
    seen = (rate + 0.01 * rng.standard_normal(len(rate))) / TURN
    still = np.ones(len(rate))
    table = np.column_stack((time_s, seen, torque, 0.4 * still, 24.0 + 0.1 * rng.random(len(rate))))
    return Public(
        rows(folder / "brake_torque_test.csv", ["# Test started at Mon Feb  8 18:05:58 2021", names], table),
        "joint",
        {
            "base_angle": Is(("c1 vel [Hz]",), "turn/s"),
            "base_torque": Is(("trd605 torque [Nm]",), "N·m"),
        },
        rate,
        torque,
    )


@case
def cogging(folder: Path) -> Public:
    """heitor-andrade/laas_anti_cogging: a motor that rolls one way, its current stands for the torque."""
    rng = np.random.default_rng(9)
    time_s = np.round(np.arange(0.0, 3.0, 0.001), 4)
    angle = 621.24683 + 50.6 * time_s
    current = 0.09 + 0.04 * np.sin(7 * angle) + 0.008 * rng.standard_normal(len(time_s))
    rate = 50.6 + 0.3 * np.sin(7 * angle + 1.0) + 0.05 * rng.standard_normal(len(time_s))
    table = np.column_stack((time_s, angle, rate, current, 1.0 + 0 * time_s, 0.4926 + 6e-5 * (rate > 50.6)))
    return Public(
        rows(
            folder / "rolling_data.txt",
            ["Time, Position, Velocity, Iq, Uq, Vsupply"],
            table,
            ", ",
            "%.8g",
        ),
        "joint",
        {"base_angle": Is(("Position",), "rad"), "base_torque": Is(("Iq",), "N·m", 0.028)},
        effects=("torque_ripple", "transmission_error"),
    )


@case
def surgical_manipulator(folder: Path) -> Public:
    """nhoyh/hysteresis_compensation_ROS: nine columns without names, some repeat the bending angle."""
    rng = np.random.default_rng(10)
    time_s = np.cumsum(rng.choice((0.004, 0.005, 0.005, 0.011), 3000))
    asked_deg = 40.0 * np.sin(time_s * 0.7) * np.minimum(1.0, time_s / 3.0)
    tip = after_play(asked_deg, 8.0)
    raw = 2.0 + tip + 0.05 * rng.standard_normal(len(time_s))
    smooth = np.convolve(np.pad(raw, 3, "edge"), np.ones(7) / 7, "valid")
    camera = tip[np.maximum(0, np.arange(len(tip)) // 6 * 6 - 3)] + 0.0945
    table = np.column_stack(
        (time_s, time_s**2, 30 * np.gradient(asked_deg, time_s) / 30, raw, smooth, camera, asked_deg,
         -0.0208 * asked_deg, 0.0213 * asked_deg)
    )  # fmt: skip
    return Public(
        rows(folder / "ff.txt", [], table, ", ", "%.6f"),
        "cable",
        {
            "base_angle": Is(("column_7",), "deg"),
            "angle_1": Is(("column_4", "column_5", "column_6"), "deg"),
        },
        lag_deg=4.0,
    )


@case
def servo_backlash(folder: Path) -> Public:
    """roboninecom/Measuring-Backlash-in-Popular-UART-Servos: two servos pull a third to and fro, in ticks."""
    began = datetime.datetime(2025, 11, 9, 9, 27, 3, 748000)
    rng = np.random.default_rng(11)
    n = 900
    pull = {3: np.full(n, 1748.0), 4: np.full(n, 2347.0)}
    for k in range(0, n, 60):
        for servo, other, at in ((3, 2142.0, 10), (4, 1949.0, 40)):
            rest = pull[servo][0]
            shape = np.interp(np.arange(14), [0, 3, 6, 9, 13], [rest, other, other, rest, rest])
            pull[servo][k + at : k + at + 14] = shape[: max(0, n - k - at)][:14]
    driven = 0.04 * (pull[3] - 1748.0) - 0.04 * (pull[4] - 2347.0)
    under = np.round(2047.0 - after_play(driven, 12.0) + 0.2 * rng.standard_normal(n))
    names, columns = ["timestamp"], []
    for servo, place in ((5, under), (3, pull[3]), (4, pull[4])):
        words = ("target pos", "pos", "speed", "load", "current", "temp", "status", "moving")
        names += [f"{word} ({servo})" for word in words]
        speed = np.round(np.abs(np.gradient(place)) * 10)
        moves = (speed > 0).astype(float)
        columns += [np.round(place, -2), np.round(place), speed, 8 + 4 * speed, np.round(speed / 60)]
        columns += [35 + (rng.random(n) > 0.8), 0 * speed, moves]
    lines = [",".join(names)]
    for k in range(n):
        stamp = began + datetime.timedelta(milliseconds=101 * k)
        values = ",".join(f"{column[k]:.0f}" for column in columns)
        lines.append(stamp.isoformat(timespec="milliseconds") + "Z," + values)
    (folder / "motor_telemetry_single.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return Public(
        folder / "motor_telemetry_single.csv",
        "cable",
        {
            "base_angle": Is(("pos (3)",), "turn", 1 / 4096),
            "angle_1": Is(("pos (5)",), "turn", 1 / 4096, -1),
        },
        effects=("gear_backlash", "coupling_slip", "hall_gain"),
    )


@case
def friction_damper(folder: Path) -> Public:
    """ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash: a matrix in JSON, inches and kips."""
    rng = np.random.default_rng(12)
    time_s = np.arange(0.0, 12.0, 1 / 256)
    wave = 0.5 * np.sin(TURN * 0.5 * time_s) * np.minimum(1.0, time_s / 2.0) * (1.0 + 0.2 * np.sin(time_s))
    rate = np.gradient(wave, time_s)
    far = after_play(wave, 0.05)
    dry = (far - after_play(far, 0.02)) / 0.01
    force = 0.9 * dry + 0.02 * rate - 0.012 + 0.0012 * rng.standard_normal(len(time_s))
    noise = 0.4 * rng.standard_normal((len(wave), 2))
    actuators = np.column_stack((500 * force + 24.5, 500 * force + 5.3)) + noise
    table = np.column_stack((time_s, wave + 0.0015, force, rate, actuators))
    (folder / "1Hz30lbtension0.5amplitude.json").write_text(json.dumps({"data": table.tolist()}))
    return Public(
        folder / "1Hz30lbtension0.5amplitude.json",
        "linear",
        {"base_angle": Is(("data.2",), "in"), "base_torque": Is(("data.3",), "kip")},
        rate * 25.4 / 10.0,
        force * 4448.2216 * 0.01,
        lever_mm=10.0,
    )


__all__ = ["CASES", "Is", "Public"]
