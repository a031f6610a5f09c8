"""What a device of a rig is: bytes of its link in, values with their ages out. One file each.

A device opens no port. It asks its `Host` for links when it is made and is handed what they bring; so it runs
behind real ports, behind a simulated device, and in the contract test alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any, ClassVar, Protocol

from needle_rig.config.schema import Section
from needle_rig.records import Command, DriveFault, DriveState, Firmware

FrameHandler = Callable[[int, bytes, float], None]
"""Receives (frame id, data, host time in s of its arrival)."""
Frames = Sequence[tuple[int, bytes]]
"""The (frame id, data) of frames that were read at once, oldest first."""
BytesHandler = Callable[[bytes, float], None]
"""Receives (bytes of a serial line or of one datagram, host time in s of their arrival)."""

SILENT_S = 0.5
"""A device that was not heard for so long is set up anew."""


class Link(Protocol):
    """Where bytes come from and go to."""

    place: str
    """As a person looks for it: a port, an address."""
    lost: bool
    """It went away, and is opened again."""
    trouble: str
    """Why it is lost, for a person; empty where nothing is known."""

    def open(self) -> None:
        """Claim the port and listen in the running loop. Raises RigFault in one sentence."""

    def poll(self) -> None:
        """Take what has arrived and the loop has not brought yet."""

    async def close(self) -> None:
        """Release the port; safe to call twice."""


class CanPort(Link, Protocol):
    """A CAN bus."""

    def send(self, frame_id: int, data: bytes) -> bool:
        """Hand one frame to the bus, at once or not at all; False when it was not taken."""


class BytePort(Link, Protocol):
    """A serial line or a UDP port."""

    def send(self, data: bytes) -> bool:
        """Send `data` at once or not at all; False when it was not taken."""


class Host(Protocol):
    """What this computer gives to a device."""

    sensors: tuple[str, ...]
    """Names of the Hall sensors, from the base on."""
    tick_s: float
    """From one command to the next."""

    def now(self) -> float:
        """Its clock, s."""

    def base_rad(self) -> float:
        """The base's angle; NaN while it is not known."""

    def record(self, source: str, row: tuple[float, ...]) -> None:
        """Keep one raw reading; see `rig.RawReadings`."""

    def can(self, received: FrameHandler) -> CanPort:
        """The rig's CAN bus; every plain frame of it is handed to `received`."""

    def serial(self, port: str, baud: int, received: BytesHandler) -> BytePort:
        """A serial port, for this device alone."""

    def udp(self, address: str, port: int, received: BytesHandler) -> BytePort:
        """Datagrams to and from one address."""

    async def page(self, address: str, port: int, path: str) -> bytes:
        """A page that the device serves over HTTP. Raises RigFault in one sentence."""


class Twin(Protocol):
    """A simulated device: what it is sent, and what it sends. A frame id is 0 where there is no CAN.

    A drive's twin also has `angle_rad`, set from outside, and `velocity_rad_s`, what it asks of its motor.
    Where it has `fail()`, the drive stops by itself with a fault that latches. A torque sensor's has
    `torque_nm`, Hall sensors' `hall_rad` (a tuple), to be measured.
    """

    def reset(self, now_s: float) -> None:
        """It is switched off and on."""

    def receive(self, now_s: float, frame_id: int, data: bytes) -> None:
        """Bytes from the host."""

    def step(self, now_s: float) -> Iterable[tuple[int, bytes]]:
        """Let time pass until `now_s`, a millisecond after the last call; what it sends."""

    def page(self, path: str) -> bytes:
        """A page that it serves."""


class Device:
    """Every device. A subclass takes (options, host) and sets `link`."""

    Options: ClassVar[type[Section]]
    """The keys that stand beside its name in the rig file."""
    link: Link

    def __init__(self, options: Any, host: Host) -> None:
        raise NotImplementedError

    def age_s(self, now_s: float) -> float:
        """Time since the newest value was sampled; infinite before the first."""
        raise NotImplementedError

    def complaint(self, now_s: float) -> str:  # noqa: ARG002 few complaints pass with time
        """What is wrong with a device that does speak, for a person; empty when nothing is."""
        return ""

    def firmware(self, now_s: float) -> Firmware | None:  # noqa: ARG002 few devices can tell
        """What it says of its firmware; None for a device that cannot tell."""
        return None

    def needs_set_up(self, now_s: float) -> bool:  # noqa: ARG002 most devices speak by themselves
        """Whether `set_up` must be called (again)."""
        return False

    async def set_up(self) -> None:
        """Make the device speak, once its link is open. Raises RigFault in one sentence."""

    @classmethod
    def simulated(cls, options: Any) -> Twin | None:  # noqa: ARG003 where nobody wrote one
        """The device as its maker describes it, for `needle-rig check-device`; None where there is none."""
        return None

    def shut_down(self) -> None:
        """Last words before the link is closed."""


class Drive(Device):
    """A base drive that takes velocities.

    It stops by itself when it hears nothing for `COMMAND_AGE_S`, and wakes by a clear alone. A fault that
    latches ends by a clear with `acknowledge`, which a person gave.
    """

    angle_rad: float = math.nan
    """Positive counter-clockwise seen from the base."""
    state: DriveState = DriveState.SILENT
    faults: DriveFault = DriveFault.NONE
    referenced: bool = False
    """It knows its zero; False after it started."""
    supply_on: bool = False
    """The motor may have its supply."""
    emergency_stop: bool = False
    index_rad: float = math.nan
    """Angle at which the index mark passed last; NaN until it did."""
    foreign_commands: int = 0
    """Commands of another master."""

    def command(self, command: Command) -> None:
        """Send `command` at once or not at all: the next one comes within a tick."""
        raise NotImplementedError


class TorqueSensor(Device):
    """Torque at the base."""

    torque_nm: float = math.nan
    """Positive when the base leads the needle."""


class HallSensors(Device):
    """Angles along the needle, unwrapped."""

    angle_rad: tuple[float, ...] = ()
    """In the order of the host's `sensors`; NaN before the first."""

    def refer(self, base_rad: float) -> None:
        """The base stands at `base_rad`: sensors whose turns were lost take those nearest to it."""
