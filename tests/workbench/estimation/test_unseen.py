"""Recordings in which nothing tells of a parameter: an answer that says so, no traceback."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from needle_rig.dataset import read_dataset
from needle_rig.physics.library import built_in_effects
from needle_rig.workbench.learning.compare import compare

DESCRIPTION = """\
format: needle-rig-dataset/1
name: stuck
rig:
  needle: {diameter_mm: 0.39, shear_modulus_gpa: 27.2}
  needle_length_mm: 397.0
  tissue_sections_mm: [[175, 200], [370, 395]]
  hall_sensors: [{name: tip, position_mm: 396}]
trials:
  - {file: trials/01.csv, start_s: 0.0, kind: unknown}
"""


def test_a_tip_that_never_moves_and_no_torque(tmp_path: Path) -> None:
    time_s = np.arange(0.0, 24.0, 0.2)
    base_deg = np.interp(time_s, [0, 4, 8, 12, 18, 24], [0, 0, 30, 30, -20, -20])
    tip_deg = 0.2 * np.random.default_rng(1).standard_normal(time_s.size)
    (tmp_path / "trials").mkdir()
    rows = (f"{t:.1f},{b:.3f},{h:.3f}" for t, b, h in zip(time_s, base_deg, tip_deg, strict=True))
    (tmp_path / "trials" / "01.csv").write_text("time_s,base_angle_deg,tip_deg\n" + "\n".join(rows) + "\n")
    (tmp_path / "dataset.yaml").write_text(DESCRIPTION)
    found = compare(read_dataset(tmp_path), built_in_effects())
    assert np.isfinite(found.held_out_error)
    (said,) = (note for note in found.notes if note.startswith("No reading depends on"))
    assert "friction_nmm_per_100mm" in said
    assert "record the base torque" in said
