"""What the tip drives rubs in its own bearing and has play.

Law: within a play b of the last element, |θ_last − θ_load| ≤ b/2, it carries no torque; |τ_load| ≤ T against
the motion of the load. A torque on the tip above T pushes the load to one side of the play, and closes it.

Source: the play operator: Brokate, Sprekels, "Hysteresis and phase transitions" (1996), ch. 2; backlash that
a load closes: Nordin, Gutman, "Controlling mechanical systems with backlash: a survey", Automatica 38 (2002).

Shows best: a reversal with little and with much load: the loop of the tip is narrower with the load.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter, with_lumped_friction
from needle_rig.physics.rod import Rod
from needle_rig.units import nm, rad


@dataclass(frozen=True)
class LooseLoad(Effect):
    """Lumped friction at the tip's node, behind a play."""

    relatives = ("tip_friction", "chuck_backlash", "capstan_friction")
    limits: ClassVar[dict[str, dict[str, float]]] = {"tip_friction": {"play_deg": 0.0}}
    resistive = True

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=1.0,
        typical=0.03,
        smallest=0.0014,
        literature=(0.0, 0.1),
        unit="N·mm",
    )
    play_deg: float = parameter(
        off=0.0,
        lower=0.0,
        upper=20.0,
        typical=1.0,
        smallest=0.1,
        literature=(0.0, 10.0),
        unit="°",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Add T to both slip limits of the tip, and the play to the element before it."""
        play_rad = np.zeros_like(rod.position_m)
        play_rad[rod.tip - 1] = rad(self.play_deg)
        rubbing = with_lumped_friction(rod, rod.tip, nm(self.torque_nmm))
        return replace(rubbing, play_rad=rod.play_rad + play_rad)
