"""Lines of an slcan adapter (LAWICEL): ASCII to plain CAN frames."""

from __future__ import annotations

import re
from binascii import hexlify, unhexlify

OK, ERROR = b"\r", b"\a"
_FRAME = re.compile(rb"(?:\A|\r)t([0-9A-Fa-f]{3})([0-8])((?:[0-9A-Fa-f]{2}){0,8})")
_LONGEST_LINE = 64
"""No line of a classic frame is longer than 32 bytes: more without an end is noise."""


def slcan_line(frame_id: int, data: bytes) -> bytes:
    """The line of a plain frame, with its end."""
    return b"t%03X%d%b\r" % (frame_id, len(data), hexlify(data).upper())


class SlcanStream:
    """Finds plain frames in what an adapter sent, however it is cut and whatever noise is in it.

    Extended and remote frames, answers to commands and lines that are no frame are left out; what stands
    behind the data is a time stamp of the adapter.
    """

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[tuple[int, bytes]]:
        """The (id, data) of frames that end in `data`, oldest first."""
        text, _, rest = (self._rest + data).replace(ERROR, OK).rpartition(OK)
        self._rest = rest[-_LONGEST_LINE:]
        return [
            (int(frame_id, 16), unhexlify(letters[: 2 * int(length)]))
            for frame_id, length, letters in _FRAME.findall(text)
            if len(letters) >= 2 * int(length)
        ]
