"""The torque cell's amplifier smooths what it passes on.

Law: T dτ_m/dt = τ − τ_m, a low-pass of first order with the cut-off frequency 1/(2π T); between two samples
τ changes evenly, for which this is solved exactly. At a relaxed start τ_m = τ.

Source: the first-order low-pass of any text on circuits. Amplifiers' filters of higher order are a delay
beside it: a four-pole one of 10 Hz takes 30 ms to half of a step (BIOPAC, "Amplifier module filter response
times").

Shows best: a fast reversal: the torque's corner is rounded over T. To torque that changes evenly it is a
delay by T: slow motions cannot tell it from a clock offset.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter

S_PER_MS = 1e-3


@dataclass(frozen=True)
class TorqueLowPass(Effect):
    """Time constant of the torque reading."""

    relatives = ("clock_offset", "chuck_inertia", "viscous_slip")

    time_constant_ms: float = parameter(
        off=0.0,
        lower=0.0,
        upper=5000.0,
        typical=40.0,
        smallest=7.5,
        literature=(0.1, 200.0),
        unit="ms",
    )

    def observe(self, reading: Reading) -> Reading:
        """Smooth the torque; its state is τ_m."""
        if not self.time_constant_ms or reading.torque_nm.size == 0:
            return reading
        times = np.diff(reading.trial.time_s) / (self.time_constant_ms * S_PER_MS)
        torques = reading.torque_nm.tolist()
        now = torques[0] if reading.state is None else reading.state
        smoothed = np.empty_like(reading.torque_nm)
        smoothed[0] = now
        for i, (time, before, after) in enumerate(zip(times.tolist(), torques, torques[1:], strict=False), 1):
            slope = (after - before) / time
            # the answer to a ramp lags it by one time constant once what was left of the start has decayed
            now = after - slope + (now - before + slope) * math.exp(-time)
            smoothed[i] = now
        return replace(reading, torque_nm=smoothed, state=now)
