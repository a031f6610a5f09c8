"""After *unknown*: commands that go on, filled in, and what they promise holds."""

import json
from pathlib import Path

import pytest

from needle_rig.cli.main import run
from needle_rig.dataset import write_dataset
from needle_rig.workbench.learning.observations import Traces
from needle_rig.workbench.selection.way_on import way_on
from tests.workbench.hidden import dataset, diagnosed, effect, few

ELASTIC = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)
LIBRARY = ("torque_bias", "bending_torque", "hall_offset")


@pytest.mark.whole
def test_the_part_that_is_named_lowers_the_error_when_it_is_adopted() -> None:
    found = diagnosed(ELASTIC, library=LIBRARY)
    assert found.verdict == "unknown"
    way = way_on(found)
    assert way.part is not None
    taken = Traces(dataset(ELASTIC)).explain(few(*LIBRARY), None, way.part.effect)
    assert taken is not None
    assert taken.improves
    assert way.part.held_out_error is not None
    assert way.part.held_out_error < found.held_out_error_before
    assert f"{way.part.held_out_error:.2f}" in way.part_sentence()


@pytest.mark.whole
def test_unknown_is_no_dead_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The line that is printed is run as it stands, but for the file's name."""
    data = str(write_dataset(dataset(ELASTIC, effect("torque_bias", bias_nmm=0.2)), tmp_path / "data"))
    assert run(["diagnose", data, "--quick", "--jobs", "1"]) == 0
    said = capsys.readouterr().out
    assert "no effect of the library explains" in " ".join(said.split())
    line = next(line for line in said.splitlines() if "needle-rig adopt" in line)
    assert run(["diagnose", data, "--quick", "--jobs", "1", "--json"]) == 0
    way = json.loads(capsys.readouterr().out)["way_on"]
    assert line.startswith(way["sentences"][0])
    assert way["sentences"][0].startswith(way["part"])
    words = line.partition("needle-rig ")[2].partition(", then")[0].split()
    model = str(tmp_path / "MODEL.yaml")
    assert run([model if word == "MODEL.yaml" else word for word in words]) == 0
    capsys.readouterr()
    assert run(["compare", data, "--model", model, "--json"]) == 0
    after = json.loads(capsys.readouterr().out)["held_out_error"]
    assert run(["compare", data, "--json"]) == 0
    assert after < json.loads(capsys.readouterr().out)["held_out_error"]
