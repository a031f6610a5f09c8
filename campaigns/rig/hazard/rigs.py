"""What a rig must have to be broken, and how one is made."""

from __future__ import annotations

from typing import Protocol

from campaigns.rig.hazard.setups import Setup
from needle_rig.records import Command, Measurement
from needle_rig.simulation.faults import Faults, Links
from needle_rig.simulation.plant import Plant


class Rig(Protocol):
    """A rig in virtual time: the plant's truth beside what the host is told."""

    plant: Plant
    links: Links
    """Between the nodes and the host."""

    @property
    def time_s(self) -> float:
        """Virtual time."""

    @property
    def faults(self) -> Faults:
        """What is broken in the machine."""

    @property
    def true_base_rad(self) -> float:
        """Where the motor's shaft stands."""

    @property
    def awake(self) -> bool:
        """The motor may have its supply."""

    @property
    def running(self) -> bool:
        """The drive turns its motor or holds it."""

    @property
    def latched(self) -> bool:
        """The drive itself stands in a fault that only a person may clear."""

    def step(self) -> None:
        """One millisecond."""

    def read(self) -> Measurement:
        """What the host knows."""

    def write(self, command: Command) -> None:
        """What the host says."""

    def reset_drive(self) -> None:
        """The drive is switched off and on."""

    def fail_drive(self, code: int) -> None:
        """The drive stops by itself with an error code of CiA 402."""

    def foreign(self, wish: Command, *, number: int) -> None:
        """Another master's command, its counter `number` ahead of the host's."""

    def foreign_reference(self, angle_rad: float) -> None:
        """Another master tells the drive where it stands."""


def make_rig(setup: Setup, seed: int) -> Rig:
    """The rig of `setup`, heard on every link."""
    from campaigns.rig.hazard.cia402 import Cia402Rig
    from campaigns.rig.hazard.own_node import OwnNodeRig

    return OwnNodeRig(setup, seed) if setup.drive == "own" else Cia402Rig(setup, seed)
