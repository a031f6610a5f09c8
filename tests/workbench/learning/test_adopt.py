import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from needle_rig.cli import adopt as adopt_cli
from needle_rig.cli.compare import command as compare_command
from needle_rig.cli.history import command as history_command
from needle_rig.dataset import in_series, write_dataset
from needle_rig.errors import BadInput, SolverError
from needle_rig.model import load_model
from needle_rig.workbench.estimation import discretisation_error
from needle_rig.workbench.estimation.discretisation_error import whitened_error
from needle_rig.workbench.learning.adopt import Refused, adopt, undo
from needle_rig.workbench.learning.history import ladder
from needle_rig.workbench.learning.observations import Traces
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS
from tests.values import known
from tests.workbench.hidden import dataset, effect, few

TWO = (
    effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45),
    effect("torque_bias", bias_nmm=0.02),
)


@pytest.mark.whole
def test_the_error_falls_step_by_step_and_steps_can_be_taken_back() -> None:
    data = Traces(dataset(*TWO))
    one = adopt(data, "tissue_elasticity", few(), today="2026-01-01", name="mine")
    two = adopt(data, "torque_bias", few(), one, today="2026-01-02")
    steps = ladder(two)
    assert [s.label for s in steps] == ["null", "+ tissue_elasticity", "+ torque_bias"]
    validation = [known(s.held_out) for s in steps]
    assert validation[0] > validation[1] > validation[2]
    assert validation[2] < 1.1
    last = steps[-1].channels["hall_4_deg"]
    assert known(last.held_out_after) < 1.5 * known(last.floor)
    values = two.model.values()
    for name, truth in (
        ("tissue_elasticity.stiffness_nmm_per_rad_per_100mm", 0.45),
        ("torque_bias.bias_nmm", 0.02),
    ):
        assert values[name] == pytest.approx(truth, abs=4 * two.uncertainties[name])
    back = undo(two)
    assert back.model.values() == pytest.approx(one.model.values(), rel=0.02)
    assert [e.name() for e in undo(back).model.effects] == []
    with pytest.raises(BadInput, match="no step"):
        undo(undo(back))


@pytest.mark.whole
def test_an_effect_that_predicts_nothing_is_refused() -> None:
    data = Traces(dataset(seed=5))
    with pytest.raises(Refused, match="With force it is added"):
        adopt(data, "torque_bias", few())
    forced = adopt(data, "torque_bias", few(), force=True)
    assert "force" in forced.history[-1].note


def test_a_model_that_cannot_be_solved_finely_is_adopted_as_it_was_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    solved: list[Any] = []

    def once(*given: Any) -> Any:
        if solved:
            raise SolverError("no balance")
        solved.append(whitened_error(*given))
        return solved[0]

    monkeypatch.setattr(discretisation_error, "whitened_error", once)
    one = adopt(Traces(dataset(*TWO[:1])), "tissue_elasticity", few("tissue_elasticity"))
    stiffness = one.model.values()["tissue_elasticity.stiffness_nmm_per_rad_per_100mm"]
    assert stiffness == pytest.approx(0.45, abs=0.01)
    assert known(one.history[0].errors[IN_NOISE_UNITS].held_out_after) < 1.1


def test_unknown_and_double_effects_are_refused() -> None:
    data = Traces(dataset(*TWO))
    with pytest.raises(BadInput, match="no such effect"):
        adopt(data, "glue", few())
    one = adopt(data, "tissue_elasticity", few())
    with pytest.raises(BadInput, match="already"):
        adopt(data, "tissue_elasticity", few(), one)


@pytest.mark.whole
def test_one_command_alone_is_judged_by_blocks_of_its_time(tmp_path: Path) -> None:
    data = dataset(*TWO)
    one = dataclasses.replace(data, trials=in_series(tuple(data.trials[i] for i in (0, 1, 4))))
    folder = write_dataset(one, tmp_path / "data")
    model = tmp_path / "mine.yaml"
    made = CliRunner().invoke(adopt_cli.command, [str(folder), "tissue_elasticity", "--out", str(model)])
    assert made.exit_code == 0, made.output
    assert "—" not in made.stdout
    shown = CliRunner().invoke(compare_command, [str(folder)])
    told = " ".join(shown.stdout.split())
    assert "error on commands left out — × the noise" not in told
    assert "its time is cut into 4 blocks, each left out in turn" in told
    entry = load_model(model).history[0].errors[IN_NOISE_UNITS]
    assert known(entry.held_out_after) < 0.5 * known(entry.held_out_before)


def test_the_commands_write_show_and_undo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = write_dataset(dataset(*TWO), tmp_path / "data")
    model = tmp_path / "mine.yaml"
    run = CliRunner().invoke
    made = run(adopt_cli.command, [str(folder), "tissue_elasticity", "--out", str(model), "--json"])
    assert made.exit_code == 0, made.output
    told = json.loads(made.stdout)
    assert told["held_out_error"] < told["held_out_error_before"]
    assert load_model(model).history[0].added == ("tissue_elasticity",)
    shown = run(history_command, [str(model), "--png", str(tmp_path / "ladder.png")])
    assert "+ tissue_elasticity" in shown.stdout
    assert (tmp_path / "ladder.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads(run(history_command, [str(model), "--json"]).stdout)["steps"]
    assert len(rows) == 2
    back = run(adopt_cli.command, ["--undo", "--model", str(model), "--out", str(model)])
    assert back.exit_code == 0, back.output
    assert load_model(model).model.effects == ()
