"""The torque cell's zero wanders with the clock.

Law: τ_m = τ + b₁ t, with t since the start of the series.

Source: thermal zero drift of strain-gauge cells, as in any cell's data sheet.

Shows best: the reading at rest before each trial of a series. A wait without motion moves it; wear of the
tissue would not.
"""

from dataclasses import dataclass, replace

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import nm

S_PER_MIN = 60.0


@dataclass(frozen=True)
class TorqueDrift(Effect):
    """Offset of the torque reading that grows with time."""

    relatives = ("torque_bias", "friction_wear")

    drift_nmm_per_min: float = parameter(
        off=0.0,
        lower=-0.2,
        upper=0.2,
        typical=0.003,
        smallest=0.0009,
        literature=(-0.02, 0.02),
        unit="N·mm/min",
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the drift since the start of the series to every torque sample."""
        clock_s = reading.trial.start_s + reading.trial.time_s
        drift_nm = nm(self.drift_nmm_per_min) / S_PER_MIN * clock_s
        return replace(reading, torque_nm=reading.torque_nm + drift_nm)
