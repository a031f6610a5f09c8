"""needle-rig: takes the torsion windup out of steerable needles, and holds its model against measurements."""

__version__ = "0.1.0"
