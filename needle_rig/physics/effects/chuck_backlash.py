"""The needle has play in the chuck.

Law: the play operator: θ_held stays as near to where it was as |θ_base − θ_held| ≤ b/2 allows; it starts
centred. Friction in the chuck holds the needle while the play is crossed.

Source: Brokate, Sprekels, "Hysteresis and phase transitions" (1996), ch. 2.

Shows best: the first degrees of a reversal: the torque stays flat for the width of the play.
"""

from dataclasses import dataclass

from needle_rig.numerics import Array
from needle_rig.physics.base_motion import after_play
from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class ChuckBacklash(Effect):
    """Play between the base encoder and the needle's held end."""

    part = "chuck"
    relatives = ("chuck_compliance", "hall_offset", "torque_bias")
    resistive = True

    play_deg: float = parameter(
        off=0.0,
        lower=0.0,
        upper=45.0,
        typical=4.0,
        smallest=0.4,
        literature=(0.0, 10.0),
        unit="°",
    )

    def drive(self, trial: Trial) -> Array:
        """The held end's path (samples,) in rad: the base's, followed at half the play."""
        return after_play(trial.base_angle_rad, rad(self.play_deg), trial.held_rad)
