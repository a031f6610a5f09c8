import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from needle_rig.cli.experiment import command
from needle_rig.dataset import write_dataset
from needle_rig.dataset.protocol import load_protocol
from needle_rig.workbench.estimation.problem import Fit, Problem
from needle_rig.workbench.selection.design import commands, expected_power, proposals
from tests.values import known
from tests.workbench.hidden import dataset, effect, null_fit, try_effect

NAMES = ("tip_friction", "chuck_backlash")


def fits() -> tuple[Problem, Fit, Fit]:
    baseline = null_fit(effect("tip_friction", torque_nmm=0.02), library=NAMES)
    tip, play = (try_effect(baseline.problem, baseline.current, name).fit for name in NAMES)
    return baseline.problem, tip, play


def test_candidates_are_ranked_by_what_a_minute_of_them_tells() -> None:
    problem, tip, play = fits()
    ranked = proposals(problem, tip, play, ("hall_1", "hall_2", "hall_3", "hall_4"))
    assert len(ranked) > 6
    worth = [p.worth for p in ranked]
    assert worth == sorted(worth, reverse=True)
    assert ranked[0].separation_sigma > 3
    assert "watch" in ranked[0].sentence("tip_friction", "chuck_backlash")
    one = expected_power(problem, tip, play, ranked[0].command, 1)
    assert expected_power(problem, tip, play, ranked[0].command, 3) > one > 0


def test_commands_keep_to_the_rig_s_limits() -> None:
    for planned in commands(20.0, 100.0):
        assert known(planned.speed_deg_s) <= 20.0
        assert max(abs(s) for s in (*planned.steps_deg, planned.target_deg or 0.0)) <= 100.0


@pytest.mark.whole
def test_the_command_writes_a_protocol_that_can_be_run(tmp_path: Path) -> None:
    folder = write_dataset(dataset(effect("tip_friction", torque_nmm=0.02)), tmp_path / "data")
    out = tmp_path / "decide.yaml"
    result = CliRunner().invoke(command, [str(folder), "--between", *NAMES, "--out", str(out), "--json"])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["expected_separation_sigma"] > 0
    protocol = load_protocol(out)
    assert len(protocol.trials) == 3
    assert known(protocol.trials[0].speed_deg_s) <= 60
