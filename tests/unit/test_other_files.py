"""Files beside datasets and runs, damaged or none: calibration pages, effects, protocols."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from needle_rig.cli.main import run as command
from needle_rig.errors import BadInput
from needle_rig.firmware.pages import read_page
from needle_rig.physics.library import find_effects


@pytest.mark.parametrize("content", [b"\xff\xfe:10", b":00000001FE\n", b":10", "µ".encode(), b":0000000g"])
def test_a_page_that_is_no_intel_hex(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "drive.hex").write_bytes(content)
    with pytest.raises(BadInput, match=r"drive\.hex: no calibration page can be read"):
        read_page(tmp_path / "drive.hex")


@pytest.mark.parametrize("kind", ["pipe", "loop", "outside"])
def test_an_effect_or_a_page_that_is_no_file(kind: str, tmp_path: Path) -> None:
    for path in (tmp_path / "law.py", tmp_path / "drive.hex"):
        if kind == "pipe":
            os.mkfifo(path)
        else:
            path.symlink_to(path.name if kind == "loop" else "/etc/passwd")
    [(_, sentence)] = find_effects([tmp_path]).broken
    assert "law.py" in sentence
    with pytest.raises(BadInput, match=r"drive\.hex"):
        read_page(tmp_path / "drive.hex")


@pytest.mark.parametrize("speed", ["1e-320", "1e-6"])
def test_a_trial_that_never_ends_is_not_simulated(
    speed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "p.yaml").write_text(
        "format: needle-rig-protocol/1\nname: slow\ntrials:\n"
        f"  - {{kind: staircase, steps_deg: [90], speed_deg_s: {speed}, settle_s: 1}}\n",
        encoding="utf-8",
    )
    line = ["simulate", "--protocol", str(tmp_path / "p.yaml"), "--out", str(tmp_path / "out")]
    assert command(line) == 2
    assert "trial 1 lasts" in capsys.readouterr().err
