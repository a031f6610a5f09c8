"""needle-rig strategies: the table's form and numbers, the model that planned learns, what is predicted."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from needle_rig.cli.strategies import command
from needle_rig.control.strategy import find_strategies, make_strategy
from needle_rig.errors import BadInput
from needle_rig.model import SavedModel, load_parameters
from needle_rig.simulation.build import build_plant
from needle_rig.units import deg, rad
from needle_rig.workbench.contest.strategies_table import (
    Bout,
    all_strategies,
    compare_strategies,
    one_result,
    predicted,
)
from needle_rig.workbench.parallel import workers
from needle_rig.workbench.virtual.noise import NO_NOISE
from needle_rig.workbench.virtual.settled_run import run_settled

ROW = {"tip_lag_deg", "worst_deg", "torque_nmm", "rotations", "total_rotation_deg", "time_s"}


def _bout(name: str = "rig_elastic", model: str | None = None) -> Bout:
    plant = load_parameters(name)
    saved = None if model is None else SavedModel(load_parameters(model), model)
    return Bout(plant, plant.torsional_rigidity_nm2, saved=saved)


@pytest.mark.whole
def test_the_command_identifies_a_model_and_prints_the_stated_rows(tmp_path: Path) -> None:
    asked = ["--targets", "45", "--seeds", "1", "--jobs", "1", "--json", "--pictures", str(tmp_path)]
    for name in ("planned", "reed2008", "none"):
        asked += ["--strategy", name]
    answer = CliRunner().invoke(command, asked)
    assert answer.exit_code == 0, answer.output
    told = json.loads(answer.stdout)
    rows = {row["strategy"]: row for row in told["rows"]}
    assert set(rows) == {"planned", "reed2008", "none"}
    for row in rows.values():
        assert set(row) >= ROW | {"strategy", "target_deg"}
        assert set(row["worst_deg"]) == {"median", "q95"}
    assert rows["planned"]["worst_deg"]["median"] < 1.0
    assert rows["reed2008"]["worst_deg"]["median"] > 9.0
    assert rows["none"]["rotations"] == 1
    stiffness = told["model"]["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"]
    assert stiffness["value"] == pytest.approx(0.278, rel=0.05)
    assert told["model_error_over_floor"] < 2.0
    assert told["predicted"].startswith("planned should leave 0.")
    assert (tmp_path / "strategies.png").read_bytes()[:4] == b"\x89PNG"


def test_settled_runs_end_where_whole_runs_end() -> None:
    from needle_rig.config.loader import load_rig_config
    from needle_rig.control.brain import Brain
    from needle_rig.control.reports import Request
    from needle_rig.simulation.run import run_virtual

    config = load_rig_config(None, {"simulation.parameters": "rig_elastic"})
    whole = run_virtual(Brain(config), build_plant(config), Request(rad(45.0), "reed2008"), shafts=True)
    bout = _bout()
    settled = run_settled(
        bout.plant, make_strategy("reed2008", {}), bout.task(45.0), np.random.default_rng(0), NO_NOISE
    )
    assert deg(settled.tip_rad) == pytest.approx(deg(float(whole.shafts_rad[-1][-1])), abs=0.3)
    assert settled.rotations == len(whole.settled)
    # the drive accelerates and comes to rest, which the settled rig leaves out
    assert settled.time_s == pytest.approx(whole.time_s, rel=0.2)


@pytest.mark.whole
def test_every_strategy_runs_and_meets_the_same_needles() -> None:
    bout = _bout(model="rig_elastic")
    table = compare_strategies(bout, all_strategies(), [30.0], 1, starts=("relaxed",))
    assert {r.strategy for r in table.results} == set(all_strategies())
    assert all(r.values and not r.refused for r in table.results)
    again = compare_strategies(bout, ["planned"], [30.0], 1, starts=("relaxed",))
    assert again.results[0].values == table.chosen("planned")[0].values


def test_rigid_uniform_tissue_is_aligned_by_the_papers_sequence() -> None:
    found = one_result(_bout("rig_rigid"), find_strategies()["reed2008"], 45.0, "relaxed", 3)
    assert found.values["tip_lag_deg"] < 0.5


@pytest.mark.whole
def test_runs_in_which_planned_gave_way_are_counted() -> None:
    wrong = compare_strategies(_bout(model="rig_rigid"), ["planned"], [45.0], 2, starts=("relaxed",))
    assert wrong.overall()[0]["gave_way_to_reed2008"] == 2
    true = compare_strategies(_bout(model="rig_elastic"), ["planned"], [45.0], 1, starts=("relaxed",))
    assert "gave_way_to_reed2008" not in true.overall()[0]


def test_planned_without_a_model_is_a_refusal_in_the_table() -> None:
    table = compare_strategies(_bout(), ["planned"], [45.0], 1)
    assert "planned needs a model of this rig" in table.overall()[0]["refused"]
    assert "worst_deg" not in table.rows()[0]


@pytest.mark.slow
def test_it_says_beforehand_when_little_is_to_be_gained() -> None:
    told = predicted(_bout("rig_rigid", "rig_rigid"), (45.0,), ("relaxed",))
    assert told.planned_deg <= told.q95_deg < told.reed2008_deg < 3.0
    assert "less than 3 times better, because reed2008 leaves little to gain" in told.sentence


@pytest.mark.whole
def test_what_is_predicted_is_of_the_targets_and_starts_that_are_run() -> None:
    bout = _bout(model="rig_elastic")
    small, large = (predicted(bout, (target,), ("relaxed",)) for target in (2.0, 90.0))
    # a turn that hardly slips leaves no more than itself
    assert small.reed2008_deg < 2.0 < 6.0 < large.reed2008_deg


@pytest.mark.long
def test_each_effect_has_a_rig_and_a_line_of_its_own() -> None:
    asked = [
        "--parameters",
        "rig_rigid",
        "--each",
        "--effect",
        "tip_friction",
        "--effect",
        "chuck_compliance",
    ]
    asked += ["--targets", "45", "--seeds", "1", "--jobs", "1"]
    answer = CliRunner().invoke(command, asked)
    assert answer.exit_code == 0, answer.output
    lines = {line.split()[0]: line.split() for line in answer.stdout.splitlines()[2:4]}
    assert set(lines) == {"tip_friction", "chuck_compliance"}
    for effect, cells in lines.items():
        assert cells[1] == effect
        assert float(cells[2]) < float(cells[4]) / 3.0
        assert float(cells[6]) == pytest.approx(float(cells[4]) / float(cells[2]), rel=0.3)


@pytest.mark.parametrize("wrong", [[], ["--effect", "tip_friction", "--strategy", "none"]])
def test_a_rig_for_each_effect_wants_effects_and_both_strategies(wrong: list[str]) -> None:
    assert isinstance(CliRunner().invoke(command, ["--each", *wrong]).exception, BadInput)


def test_bad_use_is_a_sentence() -> None:
    with pytest.raises(BadInput, match="'nothing' is unknown"):
        compare_strategies(_bout(), ["nothing"], [45.0], 1)
    with pytest.raises(BadInput, match="up to ±360°"):
        compare_strategies(_bout(), ["none"], [0.0], 1)
    answer = CliRunner().invoke(command, ["--targets", "45;90", "--strategy", "none"])
    assert isinstance(answer.exception, BadInput)
    assert "--targets 45;90: write degrees" in str(answer.exception)


@pytest.mark.whole
def test_in_processes_the_table_is_the_same() -> None:
    asked = (_bout(), ["reed2008", "reed2008_elastic"], [30.0], 1)
    here = compare_strategies(*asked, starts=("relaxed",))
    assert compare_strategies(*asked, starts=("relaxed",), work=workers(2, None)) == here
    assert {r.strategy for r in here.results} == {"reed2008", "reed2008_elastic"}
