"""A host without ports, in a time of its own: its links lead to whoever holds it."""

from __future__ import annotations

from collections import deque

from needle_rig.devices.device import BytesHandler, FrameHandler

SOME_TIME_S = 1000.0
"""Where its clock begins: no device's clock does."""


class MemoryHost:
    """A `Host` for one device. `bring` hands it bytes; what it sends waits in `sent` as (frame id, data)."""

    def __init__(self, sensors: tuple[str, ...] = (), tick_s: float = 0.005) -> None:
        self.sensors, self.tick_s = sensors, tick_s
        self.now_s = SOME_TIME_S
        self.base_is_rad = 0.0
        self.sent: deque[tuple[int, bytes]] = deque()
        self.rows: list[tuple[str, tuple[float, ...]]] = []
        self.pages: dict[str, bytes] = {}
        self._frames: list[FrameHandler] = []
        self._bytes: list[BytesHandler] = []

    def now(self) -> float:
        """See `Host.now`."""
        return self.now_s

    def base_rad(self) -> float:
        """See `Host.base_rad`."""
        return self.base_is_rad

    def record(self, source: str, row: tuple[float, ...]) -> None:
        """See `Host.record`."""
        self.rows.append((source, row))

    def can(self, received: FrameHandler) -> MemoryCan:
        """See `Host.can`."""
        self._frames.append(received)
        return MemoryCan(self)

    def serial(self, port: str, baud: int, received: BytesHandler) -> MemoryBytes:  # noqa: ARG002
        """See `Host.serial`."""
        self._bytes.append(received)
        return MemoryBytes(self, port)

    def udp(self, address: str, port: int, received: BytesHandler) -> MemoryBytes:  # noqa: ARG002
        """See `Host.udp`."""
        self._bytes.append(received)
        return MemoryBytes(self, address)

    async def page(self, address: str, port: int, path: str) -> bytes:  # noqa: ARG002
        """See `Host.page`."""
        return self.pages[path]

    def bring(self, frame_id: int, data: bytes) -> None:
        """What came over the device's links."""
        for take_frame in self._frames:
            take_frame(frame_id, data, self.now_s)
        for take_bytes in self._bytes:
            take_bytes(data, self.now_s)


class _MemoryLink:
    """A link that is always there."""

    lost = False
    trouble = ""

    def __init__(self, host: MemoryHost, place: str = "memory") -> None:
        self._host, self.place = host, place

    def open(self) -> None:
        """Nothing to claim."""

    def poll(self) -> None:
        """Nothing waits."""

    async def close(self) -> None:
        """Nothing to release."""


class MemoryCan(_MemoryLink):
    """A CAN bus in memory."""

    def send(self, frame_id: int, data: bytes) -> bool:
        """Keep a frame for whoever holds the host."""
        self._host.sent.append((frame_id, data))
        return True


class MemoryBytes(_MemoryLink):
    """A serial line or UDP port in memory."""

    def send(self, data: bytes) -> bool:
        """Keep bytes for whoever holds the host."""
        self._host.sent.append((0, data))
        return True
