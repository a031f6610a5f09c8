"""A seal or bearing between torque cell and needle drags.

Law: τ_m = τ + f + b ω. The dry part f follows the base, df/dθ = T/δ while |f| < T, and |f| = T beyond (the
stop operator): it builds up over the presliding angle δ and stays when the base stops. b ω is the grease's
part.

Source: Brokate, Sprekels, "Hysteresis and phase transitions" (1996), ch. 2; presliding friction as in
Dahl's model, e.g. Ruderman, arXiv 2212.05799. That bearings on a torque shaft are measured with the load:
Schicker, Wegener, "Measuring torque correctly" (HBM), 3.1.3. The size is an estimate for miniature bearings
and lip seals.

Shows best: a turn back and forth with the needle taken out: the torque that is left. With the needle in:
torque that no twist of the free length goes with, as friction in the guide or the tissue would have.
"""

from dataclasses import dataclass, replace

import numpy as np

from needle_rig.physics.effect import Effect, Reading, parameter
from needle_rig.units import nm, rad


@dataclass(frozen=True)
class BearingDrag(Effect):
    """Dry and viscous friction beside the needle that the torque cell carries."""

    relatives = ("guide_friction", "viscous_slip", "torque_gain", "direction_asymmetry", "chuck_inertia")
    stage = -2

    torque_nmm: float = parameter(
        off=0.0,
        lower=0.0,
        upper=2.0,
        typical=0.01,
        smallest=0.002,
        literature=(0.0, 0.2),
        unit="N·mm",
    )
    viscous_nmms_per_rad: float = parameter(
        off=0.0,
        lower=0.0,
        upper=2.0,
        typical=0.01,
        smallest=0.0025,
        literature=(0.0, 0.2),
        unit="N·mm·s/rad",
    )
    presliding_deg: float = parameter(
        off=0.0,
        lower=0.01,
        upper=20.0,
        typical=0.5,
        smallest=0.1,
        literature=(0.02, 5.0),
        unit="°",
        scale="log",
        shapes=True,
    )

    def observe(self, reading: Reading) -> Reading:
        """Add the drag to every torque sample; its state is f/T."""
        trial = reading.trial
        if trial.time_s.size == 0:
            return reading
        share = reading.state or 0.0
        shares = np.empty_like(trial.base_angle_rad)
        shares[0] = share
        steps = np.diff(trial.base_angle_rad) / rad(self.presliding_deg)
        for i, step in enumerate(steps.tolist(), start=1):
            share = min(max(share + step, -1.0), 1.0)
            shares[i] = share
        rate_rad_s = np.zeros_like(trial.base_angle_rad)
        rate_rad_s[1:] = np.diff(trial.base_angle_rad) / np.diff(trial.time_s)
        drag_nm = nm(self.torque_nmm) * shares + nm(self.viscous_nmms_per_rad) * rate_rad_s
        return replace(reading, torque_nm=reading.torque_nm + drag_nm, state=share)
