#!/usr/bin/env python3
"""Explores a decoder of the nodes with libFuzzer: `scripts/fuzz.py drive|serial [libFuzzer options]`.

The target is built with the coverage that libFuzzer wants by the compiler that ziglang brings; libFuzzer
itself comes in the atheris wheel. Both are in the dev extra.
"""

from __future__ import annotations

import ctypes
import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

from needle_rig.extras import install_command
from needle_rig.firmware.sources import core_sources, firmware_folder

TARGETS = ("drive", "serial")
COVERAGE = "-fsanitize-coverage=inline-8bit-counters,pc-table,trace-cmp"
TRAPS = ("-fsanitize=undefined", "-fsanitize-trap=undefined")


def build(target: str, library: Path) -> None:
    sources = [*core_sources(firmware_folder()), firmware_folder() / "fuzz" / f"{target}.c"]
    compiler = [sys.executable, "-m", "ziglang", "cc", "-std=c11", "-O1", "-g", "-fPIC", "-shared"]
    subprocess.run([*compiler, COVERAGE, *TRAPS, *map(str, sources), "-o", str(library)], check=True)


def main() -> None:
    target, *options = sys.argv[1:] or [""]
    found = importlib.util.find_spec("atheris")
    if target not in TARGETS or found is None or found.origin is None:
        sys.exit(f"give one of {', '.join(TARGETS)}; libFuzzer comes with: {install_command('dev')}")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "target.so"
        build(target, library)
        fuzzer = next(Path(found.origin).parent.glob("core_with_libfuzzer*.so"))
        driver = ctypes.CDLL(str(fuzzer), mode=ctypes.RTLD_GLOBAL).LLVMFuzzerRunDriver
        one_input = ctypes.CDLL(str(library)).LLVMFuzzerTestOneInput
        arguments = [b"fuzz", *(option.encode() for option in options)]
        argv = ctypes.pointer((ctypes.c_char_p * (len(arguments) + 1))(*arguments, None))
        argc = ctypes.c_int(len(arguments))
        sys.exit(driver(ctypes.byref(argc), ctypes.byref(argv), one_input))


if __name__ == "__main__":
    main()
