"""What the images need: instructions of the longest tick, and the deepest stack, under the emulator."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any

from needle_rig.firmware.build import Image
from needle_rig.firmware.emulator import RAM, RAM_SIZE, ImageNode
from needle_rig.firmware.pins import Pins
from needle_rig.wire.can_frames import DRIVE_COMMAND_ID, TORQUE_STATUS_ID, CanCodec

CORE_HZ = 168_000_000
_PAINT = b"\xa5"
_ROOM = 8192
_TICKS = 100


@dataclass(frozen=True)
class Load:
    """Of one image: instructions from a poll to its watchdog feed at worst, bytes of stack at worst."""

    instructions: int
    stack: int


def measure(image: Image, codec: CanCodec, ticks: int = _TICKS) -> Load:
    """Run `image` with changing inputs: good, damaged and crowded frames, noise on every converter."""
    import unicorn

    machine: Any = unicorn
    rng = random.Random(1)
    pins = Pins(load_cell=1)
    node = ImageNode(image.path, pins)
    bottom = RAM + RAM_SIZE - _ROOM
    node.emulator.mem_write(bottom, _PAINT * _ROOM)
    worst = count = 0

    def step(*_: Any) -> None:
        nonlocal count
        count += not node.ticked

    node.emulator.hook_add(machine.UC_HOOK_CODE, step)
    for ms in range(1, ticks + 1):
        pins.time_us = ms * 1000
        pins.load_cell = None if ms % 50 == 0 else rng.randint(-(2**23), 2**23 - 1)
        pins.adc = [rng.randrange(4096) for _ in range(8)]
        if image.name == "drive":
            pins.encoder_counts += rng.randint(-100, 100)
            pins.can_in += _frames(codec, ms, rng)
        count = 0
        node.poll()
        worst = max(worst, count)
    stack = bytes(node.emulator.mem_read(bottom, _ROOM))
    return Load(worst, _ROOM - (len(stack) - len(stack.lstrip(_PAINT))))


def _frames(codec: CanCodec, ms: int, rng: random.Random) -> list[tuple[int, bytes]]:
    from needle_rig.records import Command

    command = Command(clear=True) if 20 < ms < 40 else Command(0.5 * (ms % 7 - 3) / 3, enable=ms > 40)
    frames = [(TORQUE_STATUS_ID, codec.encode_torque(rng.uniform(-1e-3, 1e-3), 0, ms, ms * 1e-3))]
    if ms % 5 == 0:
        frames.append((DRIVE_COMMAND_ID, codec.encode_command(command, ms // 5, ms // 5)))
    if ms % 11 == 0:
        frames.append((DRIVE_COMMAND_ID, rng.randbytes(8)))
    return frames
