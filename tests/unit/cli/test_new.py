"""What `needle-rig new` writes can be used as it is: each kind passes the check that exists for it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from needle_rig.cli.main import group, run
from needle_rig.cli.new import KINDS


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ran(*arguments: str) -> Result:
    done = CliRunner().invoke(group, arguments, standalone_mode=False)
    assert done.exception is None, done.exception
    return done


def test_an_effect_is_listed_compiled_and_simulated() -> None:
    ran("new", "effect", "my_spring")
    assert ran("effects").return_value == 0
    assert "MySpring" in Path("config/effects/my_spring.py").read_text()
    assert json.loads(ran("effects", "my_spring", "--json").stdout)["own"]
    ran("simulate", "--effect", "my_spring", "--rate-hz", "5", "--out", "d")


@pytest.mark.whole
def test_a_strategy_turns_the_simulated_needle(capfd: pytest.CaptureFixture[str]) -> None:
    ran("new", "strategy", "my_lag")
    words = ["--fast", "--target", "45", "--strategy", "my_lag", "--option", "lag_part=0.5", "--out", "runs"]
    assert run(["compensate", *words, "--json"]) == 0
    result = json.loads(capfd.readouterr().out)
    assert [motion["phase"] for motion in result["motions"]] == ["rotate", "overshoot"]
    lag = result["motions"][1]["base_deg"] - result["motions"][0]["base_deg"]
    assert lag == pytest.approx(0.5 * result["lag_deg"], rel=0.05)


def test_a_device_keeps_the_contract() -> None:
    ran("new", "device", "my_amplifier")
    assert ran("check-device", "my_amplifier", "port=/dev/ttyUSB0").return_value == 0


def test_a_dataset_can_be_compared() -> None:
    ran("new", "dataset", "my_data")
    told = json.loads(ran("compare", "my_data", "--json").stdout)
    assert told["dataset"] == "my_data"
    assert 0.5 < told["reduced_chi2"] < 2.0


def test_a_rig_file_is_understood() -> None:
    from needle_rig.config.loader import load_rig_config

    ran("new", "rig", "my_bench")
    assert "shaft: 0 to 397 mm" in ran("layout", "config/my_bench.yaml").stdout
    assert load_rig_config(Path("config/my_bench.yaml")).kind == "hardware"


@pytest.mark.parametrize("kind", list(KINDS))
def test_nothing_is_overwritten_and_no_name_leads_elsewhere(
    kind: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ran("new", kind, "mine")
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    assert run(["new", kind, "mine"]) == 2
    assert "is there already" in capsys.readouterr().err
    assert run(["new", kind, "../mine"]) == 2
    assert "is no name" in capsys.readouterr().err
    assert before == {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("kind", "name"), [("effect", "tip_friction"), ("strategy", "reed2008"), ("device", "cia402")]
)
def test_a_shipped_name_is_refused(kind: str, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["new", kind, name]) == 2
    assert f"taken by a shipped {kind}" in capsys.readouterr().err
