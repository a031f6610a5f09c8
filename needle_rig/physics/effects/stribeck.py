"""Starting to slip takes more torque than slipping on.

Law: υ(ω) = υ_k + (υ_s − υ_k) e^{−(|ω|/ω_s)^δ}, with e = υ_s/υ_k − 1 and δ = 2 (Gaussian) to 1 (exponential),
reached over a slip s_w: the bond m follows dm/dt = (e^{−(|ω|/ω_s)^δ} − m)(|ω| + ω_s)/s_w and the limit is
υ_k(1 + e m). The term that grows with the rate, which textbooks add, is `viscous_slip`.

Without a slip length the law has no answer of its own where the needle snaps: a slip front meets the static
limit of one cell of the mesh, however small. s_w = 0.05° stands for none (0.2 µm on the paper's wire).

The limit must not fall faster with slip than the needle unloads, or the needle snaps (stick-slip): about
e · friction torque / s_w < 0.3 N·mm/rad, so s_w > 5.7° for e = 0.3 and 0.1 N·mm. Viscous slip that raises the
torque faster with the rate than the excess falls, b′ > e υ_k/ω_s, keeps any s_w from it, and less of it still
gives a snap its time scale. Without, the model has none: the instant of a snap is known to about a sample and
the angles there to some tenths of a degree.

Source: exponential: Bo, Pavelescu, Wear 82 (1982); Gaussian: Armstrong-Hélouvry, Dupont, Canudas de Wit,
Automatica 30 (1994); weakening over a slip length: Rice, Ruina, J. Applied Mechanics 50 (1983).

Shows best: restart in the same direction after a rest: a short torque peak. Holds show it only where damping
brings the needle to rest out of a slow slip.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Trial, parameter
from needle_rig.physics.rod import Rod
from needle_rig.units import rad


@dataclass(frozen=True)
class Stribeck(Effect):
    """Static friction above kinetic friction, in the tissue."""

    relatives = ("stiction_ageing", "viscous_slip")
    resistive = True

    static_excess: float = parameter(
        off=0.0,
        lower=0.0,
        upper=5.0,
        typical=0.3,
        smallest=0.03,
        literature=(0.0, 1.0),
        unit="1",
    )
    rate_deg_s: float = parameter(
        off=0.0,
        lower=0.01,
        upper=500.0,
        typical=6.0,
        smallest=0.5,
        literature=(0.5, 60.0),
        unit="°/s",
        scale="log",
        shapes=True,
    )
    weakening_deg: float = parameter(
        off=0.0,
        lower=0.05,
        upper=30.0,
        typical=8.0,
        smallest=1.0,
        literature=(1.0, 10.0),
        unit="°",
        scale="log",
        shapes=True,
    )
    exponent: float = parameter(
        off=2.0,
        lower=1.0,
        upper=2.0,
        typical=2.0,
        smallest=0.2,
        literature=(1.0, 2.0),
        unit="1",
        scale="log",
        shapes=True,
    )

    def shape(self, rod: Rod, trial: Trial) -> Rod:
        """Set the bond's law and add the excess at every tissue node."""
        added = np.where(rod.tissue_length_m > 0, self.static_excess, 0.0)
        return replace(
            rod,
            static_excess=rod.static_excess + added,
            stribeck_rate_rad_s=rad(self.rate_deg_s),
            stribeck_exponent=self.exponent,
            weakening_rad=rad(self.weakening_deg),
        )
