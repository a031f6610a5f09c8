"""The nodes' own C code as a library in this process."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from needle_rig.firmware.build import HOST_LIBRARY
from needle_rig.firmware.pins import Pins
from needle_rig.firmware.sources import firmware_folder

INCLUDE = re.compile(r'#include "(?:\.\./\.\./core/)?(nr_\w+\.h)"')


def declarations(folder: Path) -> str:
    """What the host library offers, as C declarations without preprocessor lines."""
    core = folder / "core"
    names = INCLUDE.findall((folder / "boards" / "host" / "host.h").read_text(encoding="utf-8"))
    lines = []
    for name in names:
        lines += (core / name).read_text(encoding="utf-8").splitlines()
    text = "\n".join(line for line in lines if not line.startswith("#"))
    return text.replace("extern const", "extern")  # cffi reads variables of a library, not its constants


class HostNodes:
    """The host library: `ffi` to make its structures, `lib` to call it."""

    def __init__(self, build_folder: Path) -> None:
        from cffi import FFI

        self.ffi: Any = FFI()
        self.ffi.cdef(declarations(firmware_folder()))
        self.lib: Any = self.ffi.dlopen(str(build_folder / HOST_LIBRARY))


class HostNode:
    """One node of the host library behind `pins`."""

    def __init__(self, nodes: HostNodes, kind: str, pins: Pins) -> None:
        """`kind` is one of torque, hall, drive."""
        ffi, lib = nodes.ffi, nodes.lib
        self.pins = pins
        self.app: Any = ffi.new(f"struct nr_{kind}_app *")
        self._nodes = nodes
        self._page = ffi.new("uint8_t[]", pins.page)
        self._board, self._callbacks = _board(nodes, pins, self._page)
        self._poll = getattr(lib, f"nr_{kind}_poll")
        start = getattr(lib, f"nr_{kind}_start")
        more = [ffi.addressof(lib.nr_drive_defaults)] if kind == "drive" else []
        start(self.app, self._board, *more)

    def poll(self) -> bool:
        """One turn of the main loop; True when the node ticked."""
        return bool(self._poll(self.app, self._board))


def _board(nodes: HostNodes, pins: Pins, page: Any) -> tuple[Any, list[Any]]:
    ffi = nodes.ffi

    def load_cell(_context: Any, counts: Any) -> bool:
        if pins.load_cell is None:
            return False
        counts[0] = pins.load_cell
        return True

    def encoder(_context: Any, counts: Any) -> bool:
        counts[0] = (pins.encoder_counts + 2**31) % 2**32 - 2**31
        return pins.encoder_good

    def supply(_context: Any, on: bool) -> None:
        pins.supply = bool(on)

    def duty(_context: Any, value: int) -> None:
        pins.duty = value

    def can_send(_context: Any, frame_id: int, data: Any) -> None:
        pins.can_out.append((frame_id, bytes(ffi.buffer(data, 8))))

    def can_receive(_context: Any, frame_id: Any, data: Any, length: Any) -> bool:
        if not pins.can_in:
            return False
        frame_id[0], received = pins.can_in.popleft()
        length[0] = len(received)
        ffi.memmove(data, received, len(received))
        return True

    def uart_send(_context: Any, data: Any, length: int) -> None:
        pins.uart_out += ffi.buffer(data, length)[:]

    served = {
        "time_us": lambda _context: pins.time_us % 2**32,
        "adc": lambda _context, channel: pins.adc[channel],
        "load_cell": load_cell,
        "encoder": encoder,
        "index": lambda _context: pins.index,
        "emergency_stop": lambda _context: pins.emergency_stop,
        "duty": duty,
        "supply": supply,
        "can_send": can_send,
        "can_receive": can_receive,
        "uart_send": uart_send,
        "calibration": lambda _context: page,
    }
    board = ffi.new("struct nr_board *")
    callbacks = []
    for name, function in served.items():
        callback = ffi.callback(ffi.typeof(getattr(board, name)), function)
        setattr(board, name, callback)
        callbacks.append(callback)
    return board, callbacks
