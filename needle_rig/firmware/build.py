"""Builds the nodes with the compiler that ziglang brings from PyPI: Cortex-M images and the host library."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from needle_rig.errors import NeedleRigError
from needle_rig.extras import missing
from needle_rig.firmware.sources import (
    BOARD,
    NODES,
    core_sources,
    firmware_folder,
    image_sources,
    source_build,
)
from needle_rig.version import VERSION

WARNINGS = ("-Wall", "-Wextra", "-Wshadow", "-Wconversion", "-Werror")
# The generated codec narrows on purpose.
RELAXED = ("-Wno-conversion", "-Wno-implicit-int-conversion", "-Wno-sign-conversion")
TARGET = (
    "-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4+vfp4d16sp", "-Os", "-ffp-contract=off",
    "-ffunction-sections", "-fdata-sections",
)  # fmt: skip
HOST_LIBRARY = "libneedle_rig_nodes.so"


@dataclass(frozen=True)
class Image:
    """One thing that was built. Sizes in bytes; all zero for the host library."""

    name: str
    path: Path
    text: int = 0
    data: int = 0
    bss: int = 0

    @property
    def flash(self) -> int:
        """Bytes of flash: code, constants and the initial values of variables."""
        return self.text + self.data

    @property
    def ram(self) -> int:
        """Bytes of RAM without the stack."""
        return self.data + self.bss


def build(out: Path, *, only_host: bool = False, host_flags: Sequence[str] = ()) -> list[Image]:
    """Builds `torque`, `hall`, `drive` (`.elf`, `.hex`) and the host library into `out`; gives what it built.

    `host_flags` are further flags for the host library (sanitizers, coverage). Raises BadInput when ziglang
    is not installed, NeedleRigError with the compiler's words when a source does not compile.
    """
    folder = firmware_folder()
    out.mkdir(parents=True, exist_ok=True)
    built = [] if only_host else [_image(folder, node, out) for node in NODES]
    built.append(_host_library(folder, out, host_flags))
    return built


def _image(folder: Path, node: str, out: Path) -> Image:
    board = folder / "boards" / BOARD
    elf = out / f"{node}.elf"
    _compile(
        folder,
        [*TARGET, *WARNINGS, *RELAXED, "-isystem", board / "include", f"-Wl,-T,{board / 'link.ld'}",
         "-Wl,--gc-sections", "-Wl,-e,Reset_Handler", "-Wl,--build-id=none",
         *image_sources(folder, node), "-o", elf],
    )  # fmt: skip
    text, data, bss = sizes(elf)
    _write_hex(elf, out / f"{node}.hex")
    return Image(node, elf, text, data, bss)


def _host_library(folder: Path, out: Path, flags: Sequence[str]) -> Image:
    library = out / HOST_LIBRARY
    _compile(
        folder,
        ["-O2", "-fPIC", "-shared", "-ffp-contract=off", *WARNINGS, *RELAXED, *flags,
         *core_sources(folder), "-o", library],
    )  # fmt: skip
    return Image("host library", library)


def _compile(folder: Path, arguments: Sequence[str | Path]) -> None:
    if importlib.util.find_spec("ziglang") is None:
        raise missing("building the firmware (the compiler)", "ziglang", "bench")
    fixed = ["-std=c11", "-g0", f"-ffile-prefix-map={folder}=firmware", *identity_flags(folder)]
    command = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        *fixed,
        *(os.fspath(argument) for argument in arguments),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise NeedleRigError(f"firmware build: the compiler stopped:\n{done.stderr.strip()}")


def identity_flags(folder: Path) -> list[str]:
    """What the nodes say of themselves: this version, and `source_build` of `folder`."""
    numbers = zip(("MAJOR", "MINOR", "PATCH"), VERSION.split("."), strict=True)
    return [
        *(f"-DNR_VERSION_{name}={number}" for name, number in numbers),
        f"-DNR_BUILD={source_build(folder)}",
    ]


def sizes(elf: Path) -> tuple[int, int, int]:
    """Bytes of text, data and bss of an image."""
    from elftools.elf.elffile import ELFFile

    sizes = {"text": 0, "data": 0, "bss": 0}
    with elf.open("rb") as stream:
        for section in ELFFile(stream).iter_sections():
            name = section.name.lstrip(".")
            if name in sizes:
                sizes[name] += section.data_size
    return sizes["text"], sizes["data"], sizes["bss"]


def _write_hex(elf: Path, path: Path) -> None:
    from elftools.elf.elffile import ELFFile
    from intelhex import IntelHex

    image = IntelHex()
    with elf.open("rb") as stream:
        for segment in ELFFile(stream).iter_segments("PT_LOAD"):
            if segment["p_filesz"]:
                image.puts(segment["p_paddr"], segment.data())
    image.write_hex_file(str(path))
