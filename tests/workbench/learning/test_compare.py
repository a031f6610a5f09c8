import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from needle_rig.cli.compare import command
from needle_rig.dataset import write_dataset
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
    for name, values in found.channels.items():
        assert known(values["noise"]) > 0, name
        assert 0.8 < known(values["whitened"]) < 1.2
        assert 0.7 < known(values["in_noise_units"]) < 1.2
        assert values["rmse"] / known(values["noise"]) == pytest.approx(values["in_noise_units"], rel=1e-9)


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
