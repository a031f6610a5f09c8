import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from needle_rig.cli.compare import command
from needle_rig.dataset import read_dataset, write_dataset
from needle_rig.figures.comparison import pictures, write_html
from needle_rig.figures.page import write_pngs
from needle_rig.workbench.learning.compare import compare
from tests.values import known
from tests.workbench.hidden import dataset, effect, few

ELASTIC = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)


@pytest.mark.whole
def test_the_worst_places_are_the_reversals_of_an_elastic_tissue(tmp_path: Path) -> None:
    found = compare(dataset(ELASTIC), few())
    assert found.held is None
    assert found.refit.worst[0].sigmas > 30
    assert any("settled after back" in p.words and "model" in p.words for p in found.refit.worst)
    assert found.refit.reduced_chi2 > 50
    assert "(its two constants are fitted)" in found.headline()[1]
    assert found.held_out_error > 10
    sigmas = [p.sigmas for p in found.refit.worst]
    assert sigmas == sorted(sigmas, reverse=True)
    drawn = pictures(found)
    for path in write_pngs(drawn, tmp_path / "figures"):
        assert path.read_bytes().startswith(b"\x89PNG")
    write_html(found, drawn, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert page.count("data:image/png;base64,") == 3
    assert "http" not in page


def test_a_good_model_has_no_bad_place() -> None:
    found = compare(dataset(seed=3), few())
    assert not [p for p in found.refit.worst if p.sigmas > 5]
    assert 0.7 < found.refit.reduced_chi2 < 1.2
    assert not [note for note in found.notes if "shifts all readings" in note]
    for name, values in found.channels.items():
        assert known(values["noise"]) > 0, name
        assert 0.8 < known(values["whitened"]) < 1.2
        assert 0.7 < known(values["in_noise_units"]) < 1.2
        assert values["rmse"] / known(values["noise"]) == pytest.approx(values["in_noise_units"], rel=1e-9)


SHIFTED = """\
format: needle-rig-dataset/1
name: joint
rig:
  hall_sensors:
  - {name: tip, position_mm: 1000.0}
  needle: {torsional_rigidity_nmm2: unknown}
  needle_length_mm: 1000.0
  tissue_sections_mm:
  - [0.0, 1000.0]
trials:
- {file: trials/01.csv, kind: unknown, speed_deg_s: 1.2, start: zeroed, start_s: 0.0}
"""


def test_a_noise_that_shifts_a_whole_trial_is_told_beside_the_error_that_it_does_not_explain(
    tmp_path: Path,
) -> None:
    """An unknown twist at the start may move the tip by degrees, but not differently from time to time."""
    time_s = np.arange(117.0)
    base_deg = np.interp(time_s, [3.0, 33.0, 87.0, 114.0], [0.0, -36.0, 31.0, 0.0])
    tip_deg = 0.0008 * base_deg**3
    (tmp_path / "trials").mkdir()
    (tmp_path / "dataset.yaml").write_text(SHIFTED)
    rows = [f"{t},{b:.2f},{a:.2f}" for t, b, a in zip(time_s, base_deg, tip_deg, strict=True)]
    (tmp_path / "trials" / "01.csv").write_text("\n".join(["time_s,base_angle_deg,tip_deg", *rows]))
    found = compare(read_dataset(tmp_path), {})
    tip = found.channels["tip"]
    assert known(tip["in_noise_units"]) < 0.01 * found.held_out_error
    (told,) = [note for note in found.notes if note.startswith("tip: ")]
    assert f"noise of {known(tip['noise']):.2g} °" in told
    assert f"{known(tip['whitened']):.2f} × the rest" in told


def test_the_command_prints_the_stated_json(tmp_path: Path) -> None:
    folder = write_dataset(dataset(ELASTIC), tmp_path / "data")
    result = CliRunner().invoke(command, [str(folder), "--json"])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert set(answer) >= {
        "model",
        "free_parameters",
        "held_out_error",
        "noise_floor",
        "reduced_chi2",
        "channels",
        "worst",
    }
    assert set(answer["channels"]["torque"]) >= {"rmse", "noise", "by_phase"}
    plain = CliRunner().invoke(command, [str(folder), "--pictures", str(tmp_path / "p")])
    assert "Worst places" in plain.stdout
    assert (tmp_path / "p" / "residuals.png").exists()
