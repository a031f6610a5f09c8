"""A million damaged frames into each decoder: none crashes, none moves the motor, none is mistaken."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from needle_rig.firmware.sources import core_sources, firmware_folder

FRAMES = 1_000_000
TARGETS = ("drive", "serial")
UNDEFINED_IS_A_TRAP = ("-fsanitize=undefined", "-fsanitize-trap=undefined")


def built_target(compiler: list[str], flags: tuple[str, ...], target: str, folder: Path, out: Path) -> Path:
    program = out / target
    sources = [*core_sources(folder), *(folder / "fuzz" / f"{name}.c" for name in (target, "million"))]
    command = [*compiler, "-std=c11", "-O1", "-g", *flags, *map(str, sources), "-o", str(program)]
    subprocess.run(command, check=True, capture_output=True)
    return program


ZIG = [sys.executable, "-m", "ziglang", "cc"]


@pytest.mark.parametrize("target", TARGETS)
def test_a_million_frames(target: str, tmp_path: Path) -> None:
    program = built_target(ZIG, UNDEFINED_IS_A_TRAP, target, firmware_folder(), tmp_path)
    done = subprocess.run([program, str(FRAMES), "7"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[0]) >= FRAMES


@pytest.mark.whole
@pytest.mark.parametrize(
    ("target", "file", "check", "without"),
    [
        ("drive", "nr_frame.c", "length == 8 && data[7] == nr_can_checksum(id, data)", "length == 8"),
        ("drive", "nr_guard.c", "counted >= 1 && counted <= 3 && beaten <= 3", "counted <= 3"),
        ("drive", "nr_guard.c", "heartbeat == guard->command.heartbeat;", "true;"),
        ("drive", "nr_guard.c", "        if (guard->clear_asked) {\n", "        {\n"),
        ("serial", "nr_frame.c", "content > room || crc != nr_crc16(raw, content)", "content > room"),
    ],
)
def test_the_targets_notice_a_decoder_without_a_check(
    target: str, file: str, check: str, without: str, tmp_path: Path
) -> None:
    folder = tmp_path / "firmware"
    shutil.copytree(firmware_folder(), folder)
    source = folder / "core" / file
    text = source.read_text(encoding="utf-8")
    assert text.count(check) == 1
    source.write_text(text.replace(check, without), encoding="utf-8")
    program = built_target(ZIG, (*UNDEFINED_IS_A_TRAP, "-w"), target, folder, tmp_path)
    assert subprocess.run([program, str(FRAMES), "7"], capture_output=True, check=False).returncode != 0


@pytest.mark.skipif(
    find_spec("atheris") is None, reason="no atheris wheel, which brings libFuzzer, for this machine"
)
@pytest.mark.parametrize("target", TARGETS)
def test_libfuzzer_finds_nothing_in_a_bounded_time(target: str, tmp_path: Path) -> None:
    root = firmware_folder().parent
    done = subprocess.run(
        [sys.executable, root / "scripts" / "fuzz.py", target, "-max_total_time=2"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(root)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    assert "Done" in done.stderr
