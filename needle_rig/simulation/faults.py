"""What is broken in a simulated rig. Set a field at any instant; every default is a healthy rig."""

from __future__ import annotations

import math
import random
from collections import deque
from dataclasses import dataclass, field

INDEX_WIDTH_RAD = math.radians(1.0)
"""The index mark lies from 0 to here on the base."""


@dataclass
class Reading:
    """One sensor's value on its way to its node. It is followed by what it changes, as an encoder counts."""

    gain: float = 1.0
    """Of what changes from now on: 0.9 slips a tenth, -1 counts backwards."""
    stuck: bool = False
    offset: float = 0.0
    """A jump."""
    dead_at: float | None = None
    """Reads this and nothing else."""
    _true: float = 0.0
    _read: float = 0.0

    def of(self, true: float) -> float:
        """What is read where the truth is `true`; call it once a sample."""
        if self.healthy:
            self._true = self._read = true
            return true
        if not self.stuck:
            self._read += self.gain * (true - self._true)
        self._true = true
        return self._read + self.offset if self.dead_at is None else self.dead_at

    @property
    def healthy(self) -> bool:
        """Nothing was ever wrong with it."""
        never = self._true == self._read
        return never and self.gain == 1.0 and not self.stuck and not self.offset and self.dead_at is None


@dataclass
class Link:
    """Frames of one node on their way to the host and, for torque, to the drive node."""

    fault: str = ""
    """`unplug`, `silence`, `garble` or `freeze`, as the bench's; `fade` lets frames pass."""
    delay_s: float = 0.0
    seed: int = 0
    _last: dict[int, bytes] = field(default_factory=dict)
    _waiting: dict[int, deque[tuple[float, bytes]]] = field(default_factory=dict)
    _random: random.Random | None = None

    def through(self, data: bytes, now_s: float, frame_id: int = 0) -> bytes | None:
        """What arrives at `now_s` under `frame_id`, when `data` is sent; None when nothing does."""
        if self.fault in ("unplug", "silence"):
            return None
        if self.fault == "garble":
            self._random = self._random or random.Random(self.seed)
            return self._random.randbytes(len(data))
        if self.fault == "freeze":
            return self._last.get(frame_id)
        if not self.delay_s and not self._waiting.get(frame_id):
            self._last[frame_id] = data
            return data
        waiting = self._waiting.setdefault(frame_id, deque())
        waiting.append((now_s + self.delay_s, data))
        arrived = None
        while waiting and waiting[0][0] <= now_s:
            arrived = self._last[frame_id] = waiting.popleft()[1]
        return arrived


@dataclass
class Faults:
    """Where the machine and its sensors can break, before any node."""

    encoder: Reading = field(default_factory=Reading)
    """Base angle in rad."""
    torque: Reading = field(default_factory=Reading)
    """Base torque in N·m."""
    hall: dict[int, Reading] = field(default_factory=dict)
    """Needle angle in rad by sensor."""
    motor_gain: float = 1.0
    """Of the power stage: -1 is wired backwards, 0 is dead."""
    shorted_rad_s: float | None = None
    """The power stage is shorted: the motor turns at this while it has its supply, whatever it is ordered."""
    supply_welded: bool = False
    """The contacts of the supply's relay stick: the motor keeps its supply when a node opens them."""
    coupling_slip: float = 0.0
    """Share of the base's motion that does not reach the needle."""
    emergency_stop: bool = False

    def hall_reading(self, sensor: int) -> Reading:
        """The reading of one sensor, to be broken."""
        return self.hall.setdefault(sensor, Reading())


@dataclass
class Links:
    """What happens to frames between the nodes and the host of one rig."""

    torque: Link = field(default_factory=lambda: Link(seed=1))
    drive: Link = field(default_factory=lambda: Link(seed=2))
    hall: Link = field(default_factory=lambda: Link(seed=3))
    command: Link = field(default_factory=lambda: Link(seed=4))
    """From the host to the drive node."""
    hall_faded: set[int] = field(default_factory=set)
    """Sensors whose magnet is out of reach."""


def over_index(base_rad: float) -> bool:
    """Whether the base stands over its index mark."""
    return base_rad % math.tau < INDEX_WIDTH_RAD
