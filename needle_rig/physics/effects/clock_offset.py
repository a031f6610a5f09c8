"""One sensor stream comes late against the base encoder.

Law: τ_m(t) = τ(t − d_τ), θ_m(t) = θ(t − d_θ): a delay for the torque stream and one for all Hall angles;
negative delays come early. A late encoder is both streams early by the same time.

Source: buffers and filters of the links; time stamps of separate clocks.

Shows best: fast motions: the residual is proportional to the rate, with the sign of the
direction.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.numerics import Array
from needle_rig.physics.effect import Effect, Reading, parameter

S_PER_MS = 1e-3


@dataclass(frozen=True)
class ClockOffset(Effect):
    """Delay of the torque stream and of the Hall stream."""

    relatives = ("viscous_slip",)

    torque_delay_ms: float = parameter(
        off=0.0,
        lower=-500.0,
        upper=500.0,
        typical=40.0,
        smallest=7.0,
        literature=(-100.0, 100.0),
        unit="ms",
    )
    hall_delay_ms: float = parameter(
        off=0.0,
        lower=-500.0,
        upper=500.0,
        typical=40.0,
        smallest=11.0,
        literature=(-100.0, 100.0),
        unit="ms",
    )

    def observe(self, reading: Reading) -> Reading:
        """Shift the streams in time; before the first and after the last sample the value stands."""
        time_s = reading.trial.time_s
        torque_nm, hall_rad = reading.torque_nm, reading.hall_rad
        if self.torque_delay_ms:
            torque_nm = _delayed(torque_nm, time_s, self.torque_delay_ms * S_PER_MS)
        if self.hall_delay_ms:
            columns = [_delayed(column, time_s, self.hall_delay_ms * S_PER_MS) for column in hall_rad.T]
            hall_rad = np.column_stack(columns) if columns else hall_rad
        return replace(reading, torque_nm=torque_nm, hall_rad=hall_rad)


def _delayed(values: Array, time_s: Array, delay_s: float) -> Array:
    """`values` as they were `delay_s` earlier, shape (samples,)."""
    return np.interp(time_s - delay_s, time_s, values) if time_s.size else values
