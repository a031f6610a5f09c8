"""A gear, a coupling or a slack cable has play between the motor's encoder and what it turns.

Law: the play operator: θ_line stays as near to where it was as |θ_base − θ_line| ≤ b/2 allows; it starts
centred, and friction holds the line while the play is crossed.

Source: Nordin, Gutman, "Controlling mechanical systems with backlash: a survey", Automatica 38 (2002), for
loads with friction. The size is an estimate: minutes for planetary gears, degrees for hobby servos, tens of
degrees for cables.

Shows best: the first degrees of a reversal: the far angle and the torque stay for the width of the play.
"""

from dataclasses import dataclass

from needle_rig.numerics import Array
from needle_rig.physics.base_motion import after_play
from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.units import rad


@dataclass(frozen=True)
class GearBacklash(Effect):
    """Play of a drive; that of a needle's is in its chuck."""

    part = "drive"
    relatives = ("hall_offset", "torque_bias", "bearing_drag")
    resistive = True

    play_deg: float = parameter(
        off=0.0,
        lower=0.0,
        upper=90.0,
        typical=4.0,
        smallest=0.4,
        literature=(0.0, 45.0),
        unit="°",
    )

    def drive(self, trial: Trial) -> Array:
        """The line's path (samples,) in rad: the base's, followed at half the play."""
        return after_play(trial.base_angle_rad, rad(self.play_deg), trial.held_rad)
