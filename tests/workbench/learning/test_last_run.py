"""A model that the last run contradicts is told before a needle is turned with it."""

from pathlib import Path

import pytest

from needle_rig.cli.compensate import _warn
from needle_rig.config.schema import WatchSection
from needle_rig.model import SavedModel, load_parameters, save_model
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import FRICTION, TORSIONAL_RIGIDITY
from needle_rig.recording.watch_summary import read_contradiction, read_summary
from needle_rig.workbench.learning.last_run import against, contradiction
from needle_rig.workbench.learning.watch import look, said_of
from needle_rig.workbench.learning.watched_runs import Watched, WatchedRun, kept_runs

SAVED = SavedModel(load_parameters("rig_rigid").replaced({FRICTION: 0.1}), "null", {FRICTION: 0.003})


def run(friction: float, name: str = "run", minute: int = 0, not_judged: str = "") -> WatchedRun:
    values = {
        FRICTION: (friction, 0.004),
        TORSIONAL_RIGIDITY: (62.5, 0.1),
        "torque_bias.torque_nmm": (0.0, 1e-3),
    }
    return WatchedRun(
        run=name,
        started_utc=f"2026-11-27T10:{minute:02d}:00",
        parameters={
            n: Watched(at=0.0, value=v, uncertainty=u, unit="N·mm per 100 mm", least=0.02)
            for n, (v, u) in values.items()
        },
        not_judged=not_judged,
    )


def keep(folder: Path, *runs: WatchedRun) -> None:
    (folder / ".watch").mkdir()
    for each in runs:
        (folder / ".watch" / f"{each.run}.json").write_text(each.model_dump_json())


def test_a_run_that_agrees_says_nothing() -> None:
    assert against(run(0.108), SAVED) == ""


def test_a_run_that_differs_is_named_with_value_and_distance() -> None:
    assert against(run(0.13), SAVED) == (
        "the last run run contradicts the model rig_rigid: friction_nmm_per_100mm was 0.1300 ± 0.0040"
        " N·mm per 100 mm there, the model says 0.1000 ± 0.0030, 6.0σ apart"
    )


def test_the_newest_judged_run_counts(tmp_path: Path) -> None:
    keep(tmp_path, run(0.13, "a", 0), run(0.101, "b", 1), run(0.2, "c", 2, "ended as aborted"))
    assert contradiction(kept_runs(tmp_path), SAVED, "m.yaml") == ""
    (tmp_path / ".watch" / "b.json").unlink()
    assert contradiction(kept_runs(tmp_path), SAVED, "m.yaml").startswith("the last run a contradicts")


def test_the_command_warns_before_it_turns_the_needle(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.yaml"
    save_model(path, SAVED)
    _warn(str(path), str(tmp_path), None)
    assert capsys.readouterr().err == ""
    keep(tmp_path, run(0.13))
    _warn(str(path), str(tmp_path), None)
    said = capsys.readouterr().err
    assert said.startswith("warning: the last run run contradicts the model rig_rigid")
    assert said.endswith(f"needle-rig compare last --model {path}\n")


def test_the_watch_says_that_the_newest_run_contradicts_the_model_of_the_rig_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "m.yaml"
    save_model(path, SAVED)
    section = WatchSection(model=str(path))
    keep(tmp_path, run(0.101, "a", 0))
    assert look(tmp_path, find_effects(), section)
    assert read_contradiction(tmp_path) == said_of(tmp_path, section).contradiction == ""
    _warn(None, str(tmp_path), None)
    assert capsys.readouterr().err == ""
    (tmp_path / ".watch" / "b.json").write_text(run(0.13, "b", 1).model_dump_json())
    assert look(tmp_path, find_effects(), section)
    said = read_contradiction(tmp_path)
    assert said.startswith("the last run b contradicts the model rig_rigid: friction")
    assert said.endswith(f"find out which is true: needle-rig compare last --model {path}")
    assert read_summary(tmp_path)[-1] == said
    _warn(None, str(tmp_path), None)
    assert capsys.readouterr().err == f"warning: {said}\n"


def test_a_model_of_the_rig_file_that_is_gone_contradicts_nothing(tmp_path: Path) -> None:
    keep(tmp_path, run(0.13))
    assert said_of(tmp_path, WatchSection(model=str(tmp_path / "gone.yaml"))).contradiction == ""
