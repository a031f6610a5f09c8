"""Recordings of machines that are no needle, in the shapes in which their owners publish them.

Each is simulated by its own plain law (no code of this project) and written by a writer of its field.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from needle_rig.numerics import Array

RATE_HZ = 200.0
PRESLIDING_RAD = 1e-3


@dataclass(frozen=True)
class Joint:
    """Friction of a stiff joint, N·m and rad/s."""

    coulomb_nm: float = 0.168
    viscous_nms_per_rad: float = 0.05
    offset_nm: float = -0.05
    stribeck_nm: float = 0.0
    stribeck_rad_s: float = 0.1
    noise_nm: float = 0.004

    def torque_nm(self, angle_rad: Array, rate_rad_s: Array, rng: np.random.Generator) -> Array:
        """Measured torque (samples,); Coulomb friction builds up over a presliding of 1 mrad."""
        bump = self.stribeck_nm * np.exp(-((rate_rad_s / self.stribeck_rad_s) ** 2))
        dry = (
            (self.coulomb_nm + bump)
            * (angle_rad - after_play(angle_rad, 2.0 * PRESLIDING_RAD))
            / PRESLIDING_RAD
        )
        exact = self.offset_nm + dry + self.viscous_nms_per_rad * rate_rad_s
        return np.asarray(exact + self.noise_nm * rng.standard_normal(len(rate_rad_s)))


def swings(
    length_s: float = 30.0, rate_hz: float = RATE_HZ, phase: float = 0.0
) -> tuple[Array, Array, Array]:
    """Time, angle in rad, rate in rad/s of strokes that become slower and larger (samples,)."""
    time_s = np.arange(0.0, length_s, 1.0 / rate_hz)
    angle = 0.6 * np.sin(1.3 * time_s + phase) + 0.25 * np.sin(3.7 * time_s) - 0.6 * np.sin(phase)
    rate = 0.6 * 1.3 * np.cos(1.3 * time_s + phase) + 0.25 * 3.7 * np.cos(3.7 * time_s)
    return time_s, angle, rate


def rested(time_s: Array, angle: Array, rest_s: float = 1.0) -> tuple[Array, Array]:
    """The same after a rest (samples,)."""
    step_s = float(time_s[1] - time_s[0])
    count = round(rest_s / step_s)
    still: Array = np.zeros(count)
    return np.arange(len(time_s) + count) * np.float64(step_s), np.concatenate((still, angle))


def after_play(angle: Array, play: float) -> Array:
    """The far side of a play (samples,)."""
    far, at = np.empty_like(angle), 0.0
    for k, x in enumerate(angle):
        at = min(max(at, x - play / 2), x + play / 2)
        far[k] = at
    return far


def csv(path: Path, columns: dict[str, Array]) -> Path:
    """Written by numpy, with names in the first line."""
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.7g", ",", header=",".join(columns), comments=""
    )
    return path


def robot_joint(folder: Path, joint: Joint = Joint(), moving: int = 6, joints: int = 7) -> Path:
    """An arm's capture in NumPy's format: one joint moves, the others stand within their encoders' noise."""
    rng = np.random.default_rng(3)
    time_s, angle, rate = swings()
    q = 2e-5 * rng.standard_normal((len(time_s), joints)) + np.linspace(-1.0, 1.0, joints)
    tau = 0.01 * rng.standard_normal((len(time_s), joints)) + np.linspace(2.0, 0.5, joints)
    q[:, moving - 1] += angle
    tau[:, moving - 1] = joint.torque_nm(angle, rate, rng)
    np.savez(folder / "joint.npz", t=time_s, q=q, tau_measured=tau)
    return folder / "joint.npz"


def plain_joint(folder: Path, joint: Joint = Joint()) -> Path:
    """Angle and torque of one joint, which moves when the log begins."""
    rng = np.random.default_rng(4)
    time_s, angle, rate = swings()
    torque = joint.torque_nm(angle, rate, rng)
    return csv(folder / "plain.csv", {"t [s]": time_s, "q [rad]": angle, "tau [Nm]": torque})


def speed_and_torque(folder: Path, joint: Joint = Joint(), unit: str = "rad/s") -> Path:
    """A drive's log without an angle."""
    rng = np.random.default_rng(5)
    time_s, angle, rate = swings()
    torque = joint.torque_nm(angle, rate, rng)
    seen = (rate + 0.002 * rng.standard_normal(len(rate))) * {"rad/s": 1.0, "rpm": 30.0 / np.pi}[unit]
    return csv(folder / "speed.csv", {"time [s]": time_s, f"velocity [{unit}]": seen, "torque [Nm]": torque})


def slide(folder: Path, coulomb_n: float = 16.8, viscous_ns_per_mm: float = 0.05) -> Path:
    """Position in mm and force in N of a linear axis."""
    rng = np.random.default_rng(6)
    time_s, angle, rate = swings()
    joint = Joint(coulomb_n, 10.0 * viscous_ns_per_mm, 0.0, noise_nm=0.3)
    return csv(
        folder / "slide.csv",
        {"Time [s]": time_s, "Position [mm]": 10.0 * angle, "Force [N]": joint.torque_nm(angle, rate, rng)},
    )


def back_to_back(folder: Path) -> Path:
    """Two actuators with a torque cell between: the brake follows over a play, and the cell sees its drag."""
    rng = np.random.default_rng(7)
    time_s, angle, rate = swings()
    far = after_play(angle, 0.03)
    torque = Joint(0.8, 0.1, 0.02, noise_nm=0.02).torque_nm(far, np.gradient(far, time_s), rng)
    return csv(
        folder / "dyno.csv",
        {
            "time [s]": time_s,
            "motor position [rad]": angle + 1e-4 * rng.standard_normal(len(time_s)),
            "motor velocity [rad/s]": rate,
            "brake position [rad]": far + 1e-4 * rng.standard_normal(len(time_s)),
            "trd605 torque [Nm]": torque,
        },
    )


def cable_probe(folder: Path) -> Path:
    """Motor steps against the bending of the tip: a dead zone, a loop, no torque; a struct of MATLAB."""
    from scipy.io import savemat

    rng = np.random.default_rng(8)
    time_s, angle = rested(*swings(20.0, 30.0)[:2])
    tip = 0.7 * after_play(angle, 0.25) + 0.004 * rng.standard_normal(len(time_s))
    savemat(
        folder / "probe.mat", {"time_s": time_s, "motor_deg": np.degrees(angle), "tip_deg": np.degrees(tip)}
    )
    return folder / "probe.mat"


def servo_ticks(folder: Path) -> Path:
    """Two hobby servos on one horn: the driving one in degrees, the one under test over its gears' play."""
    time_s, angle = rested(*swings(25.0, 10.0)[:2])
    driven = after_play(angle, 0.02)
    tick = np.radians(0.088)
    return csv(
        folder / "servos.csv",
        {
            "time_ms": 1e3 * time_s,
            "motor_pos_deg": np.degrees(np.round(angle / tick) * tick),
            "output_pos_deg": np.degrees(np.round(driven / tick) * tick),
        },
    )
