"""A cable that is wound up and unwound at the spindle bends and rubs strand on strand.

Law: τ_m = τ + H h, dh/dθ = (1 − h sign θ̇)/δ: after a reversal the torque goes over to the other side of the
loop exponentially, within some δ.

Source: Dahl, "A solid friction model", Aerospace Corporation TOR-0158 (1968), with exponent 1; hysteresis of
wire ropes in bending: Costello, "Theory of wire rope" (1997).

Shows best: a reversal: the torque nears its new side over several degrees in which no twist goes with it.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import nm, rad


@dataclass(frozen=True)
class WindingHysteresis(Effect):
    """Hysteresis of what the base winds up, beside the line."""

    relatives = ("bearing_drag", "return_spring", "tissue_elasticity")
    stage = -2

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=2.0,
        typical=0.01,
        smallest=0.002,
        literature=(0.0, 0.1),
        unit="N·mm",
    )
    length_deg: float = parameter(
        off=0.0,
        lower=0.5,
        upper=60.0,
        typical=3.0,
        smallest=0.5,
        literature=(1.0, 30.0),
        unit="°",
        scale="log",
        shapes=True,
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the hysteresis to every torque sample; its state is h."""
        base_rad = reading.trial.base_angle_rad
        if base_rad.size == 0:
            return reading
        share = reading.state or 0.0
        shares = np.empty_like(base_rad)
        shares[0] = share
        for i, step in enumerate((np.diff(base_rad) / rad(self.length_deg)).tolist(), start=1):
            side = 1.0 if step > 0.0 else -1.0
            share = side + (share - side) * np.exp(-abs(step))
            shares[i] = share
        return replace(reading, torque_nm=reading.torque_nm + nm(self.torque_nmm) * shares, state=share)
