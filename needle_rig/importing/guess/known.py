"""What a person said of the machine before a guess, and the layout that follows where none was given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from needle_rig.dataset.description import RigPart
from needle_rig.importing.axes import SLIDING
from needle_rig.importing.mapping import BASE, TIP_TORQUE, TORQUE, ChannelPart, LayoutPart
from needle_rig.importing.shaft import line_of
from needle_rig.importing.unit_text import unit_of
from needle_rig.physics.machine import MACHINES, NEEDLE, Machine, MachineName


@dataclass(frozen=True)
class Known:
    """A layout, the kind of machine, the lever of what slides; each None where nobody said it."""

    rig: RigPart | None = None
    name: MachineName | None = None
    lever_mm: float | None = None

    @property
    def machine(self) -> Machine:
        """Whose limits hold: a needle's until something else is said."""
        return MACHINES[self.name or (self.rig.machine if self.rig else NEEDLE)]

    @property
    def slides(self) -> bool:
        """Whether it is a linear axis."""
        return self.machine is MACHINES["linear"]

    @property
    def needs_torque(self) -> bool:
        """Whether nothing but a torque beside the angle gives an answer: it has no angle beyond its base."""
        return self.machine in (MACHINES["joint"], MACHINES["linear"])

    @property
    def torque_zero(self) -> float | Literal["start"]:
        """What the torque counts from: a needle begins relaxed, friction may hold any other line wound."""
        return "start" if self.rig is not None and self.machine is MACHINES[NEEDLE] else 0.0

    def layout(self, channels: Sequence[ChannelPart]) -> tuple[RigPart, LayoutPart]:
        """The layout with its reason: as given, of the machine, or of the one that the channels look like."""
        rig, told = self._layout(channels)
        update = {"machine": self.name, "lever_mm": self.lever_mm}
        return rig.model_copy(update={k: v for k, v in update.items() if v is not None}), told

    def _layout(self, channels: Sequence[ChannelPart]) -> tuple[RigPart, LayoutPart]:
        if self.rig is not None:
            return self.rig, LayoutPart()
        sensors = [c.role for c in channels if c.role not in (BASE, TORQUE, TIP_TORQUE)]
        name = self.name or _looks_like(channels, sensors)
        seen = f"{', '.join(sensors)} at its far end" if sensors else "without an angle beyond the base"
        machine, others = (
            MACHINES[name],
            ", ".join(other for other in MACHINES if other not in (name, NEEDLE)),
        )
        return line_of(name, sensors), LayoutPart(
            why=f"{machine.text}: a line that rubs all along, {seen}",
            doubt=""
            if self.name
            else f"no layout is given; by the channels it is {machine.text} ({name}). If it is none, name the"
            f" machine ({others}), or give the layout of a needle",
        )


def _looks_like(channels: Sequence[ChannelPart], sensors: Sequence[str]) -> MachineName:
    units = [unit_of(c.unit or "") for c in channels if c.role == BASE]
    if any(unit is not None and unit.dimension in SLIDING for unit in units):
        return "linear"
    if not sensors:
        return "joint"
    return "shaft" if any(c.role == TORQUE for c in channels) else "cable"
