"""One CANopen device on the rig's bus: its objects by SDO, its network state, its emergencies."""

from __future__ import annotations

import logging

import canopen
from canopen.emcy import EMCY_STRUCT
from canopen.profiles.p402 import OperationMode as OperationMode
from canopen.profiles.p402 import State402 as State402
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from needle_rig.devices.device import CanPort
from needle_rig.errors import RigFault

_ANSWER_S = 0.2
_TRIES = 2
_LONGEST_VERSION = 40

# what it would say goes into a RigFault
logging.getLogger("canopen").addHandler(logging.NullHandler())
logging.getLogger("canopen").propagate = False


class CanopenNode:
    """Reading and writing block for an answer, 0.4 s at most: from a running loop, use a thread."""

    def __init__(self, node_id: int, bus: CanPort) -> None:
        self._bus = bus
        self._network = _Network(bus)
        nothing = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
        self._node = self._network.add_node(canopen.RemoteNode(node_id, nothing))
        self._node.sdo.RESPONSE_TIMEOUT = _ANSWER_S
        self._node.sdo.MAX_RETRIES = _TRIES
        self._answer_id = 0x580 + node_id
        self._title = f"CANopen node {node_id} ({bus.place})"

    def receive(self, frame_id: int, data: bytes, now_s: float) -> None:
        """A frame of the bus; answers to `read` and `write` are taken."""
        if frame_id == self._answer_id and len(data) == 8:
            self._network.notify(frame_id, bytearray(data), now_s)

    def read(self, index: int, subindex: int = 0) -> int:
        """The object as an unsigned number. Raises RigFault when the node does not give it."""
        try:
            return int.from_bytes(self._node.sdo.upload(index, subindex), "little")
        except SdoAbortedError as refused:
            raise RigFault(
                f"{self._title}: object {index:#06x}:{subindex} cannot be read: {_reason(refused)}"
            ) from None
        except SdoCommunicationError as error:
            raise RigFault(self._silent(error)) from None

    def version(self) -> str | None:
        """Version of the node's software: its text (0x100A), else its revision (0x1018:3).

        None where it tells neither, as both are optional. Raises RigFault when the node is silent.
        """
        text = self._optional(0x100A, 0).decode("ascii", "replace").strip("\0 ")
        if text and text.isprintable():
            return text[:_LONGEST_VERSION]
        revision = self._optional(0x1018, 3)
        if len(revision) != 4:
            return None
        return f"revision {int.from_bytes(revision[2:], 'little')}.{int.from_bytes(revision[:2], 'little')}"

    def _optional(self, index: int, subindex: int) -> bytes:
        """The object as it is; empty where the node has none."""
        try:
            return bytes(self._node.sdo.upload(index, subindex))
        except SdoAbortedError:
            return b""
        except SdoCommunicationError as error:
            raise RigFault(self._silent(error)) from None

    def write(self, index: int, subindex: int, value: int, size_bytes: int) -> None:
        """Set the object. Raises RigFault when the node does not take it."""
        try:
            self._node.sdo.download(index, subindex, (value % 256**size_bytes).to_bytes(size_bytes, "little"))
        except SdoAbortedError as refused:
            raise RigFault(
                f"{self._title}: object {index:#06x}:{subindex} does not take {value:#x}: {_reason(refused)}"
            ) from None
        except SdoCommunicationError as error:
            raise RigFault(self._silent(error)) from None

    def set_network_state(self, state: str) -> None:
        """Send an NMT command: OPERATIONAL, PRE-OPERATIONAL."""
        self._node.nmt.state = state

    def _silent(self, error: SdoCommunicationError) -> str:
        return (
            f"{self._title} does not answer ({str(error).lower()}); look at its supply, node"
            " id and bit rate, and at links.drive in the rig file"
        )


class _Network(canopen.Network):
    """canopen's network on a bus that the rig reads and writes itself."""

    def __init__(self, bus: CanPort) -> None:
        super().__init__()
        self._port = bus

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Hand a frame to the rig's bus; one that is not taken is missed as an answer."""
        if not remote:
            self._port.send(can_id, bytes(data))


def decode_emergency(data: bytes) -> tuple[int, str] | None:
    """(code, what it means with the error register) of an emergency frame's data; None when it is none."""
    if len(data) != EMCY_STRUCT.size:
        return None
    code, register, _ = EMCY_STRUCT.unpack(data)
    return int(code), f"emergency 0x{code:04x} ({meaning_of(code)}), error register 0x{register:02x}"


def meaning_of(code: int) -> str:
    """What CiA 301 and CiA 402 say of an error code."""
    if code >= 0xFF00:
        return "the maker's own"
    return _MEANINGS.get(code) or _CLASSES.get(code >> 12, "of no known class")


_CLASSES = {
    0x1: "generic error",
    0x2: "current",
    0x3: "voltage",
    0x4: "temperature",
    0x5: "hardware",
    0x6: "software",
    0x7: "additional modules",
    0x8: "monitoring",
    0x9: "external error",
    0xF: "additional functions",
}
"""Of CiA 301, by the first digit."""


_MEANINGS = {
    0x2310: "continuous over-current",
    0x3210: "over-voltage of the supply",
    0x3220: "under-voltage of the supply",
    0x4210: "too hot",
    0x7305: "encoder 1",
    0x7306: "encoder 2",
    0x7320: "position sensor",
    0x8110: "CAN overrun",
    0x8120: "CAN error passive",
    0x8130: "the host's heartbeat stayed away",
    0x8140: "back from bus off",
    0x8250: "no command in time",
    0x8611: "following error",
}


def _reason(refused: SdoAbortedError) -> str:
    return str(refused).partition(", ")[2].lower() or f"abort code {refused.code:#010x}"
