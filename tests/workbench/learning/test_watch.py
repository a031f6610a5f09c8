"""The watch over simulated runs: what is named in time, nothing in vain, and what is kept beside the runs."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from needle_rig.cli.main import run as needle_rig
from needle_rig.config.schema import WatchSection
from needle_rig.dataset.protocol import Protocol, compensation
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.recording.watch_summary import SUMMARY, WATCH_FOLDER, read_contradiction, read_summary
from needle_rig.workbench.learning import watch
from needle_rig.workbench.learning.watch import Watch, as_it_began, judge, look_at
from needle_rig.workbench.learning.watched_runs import WatchedRun, kept_runs
from needle_rig.workbench.virtual.dataset import simulate_dataset
from tests.recorded_run import write_run
from tests.workbench.hidden import effect

FRICTION, PLAY = "friction_nmm_per_100mm", "chuck_backlash.play_deg"
REFERENCE = 20
TARGETS_DEG = (45.0, -45.0, 60.0)


def one(series: int, number: int, factor: float = 1.0, *effects: Effect) -> WatchedRun:
    """Run `number` of a series, with friction `factor` times that of the first runs."""
    model = load_parameters("rig_rigid").with_effects(*effects)
    model = dataclasses.replace(model, friction_n=factor * model.friction_n)
    protocol = Protocol("one", (compensation(TARGETS_DEG[number % len(TARGETS_DEG)]),))
    data = simulate_dataset(model, protocol, 10_000 * series + number)
    return look_at(data, find_effects(), None, f"run{number:03d}", f"2026-11-{1 + number // 4:02d}T12:00:00")


def reference(series: int) -> list[WatchedRun]:
    return [one(series, number) for number in range(REFERENCE)]


@pytest.fixture(scope="module")
def in_control() -> list[WatchedRun]:
    return reference(1)


def after(first: list[WatchedRun], *later: WatchedRun) -> Watch:
    return judge([*first, *later], REFERENCE)


@pytest.mark.whole
def test_nothing_changed_is_said(in_control: list[WatchedRun]) -> None:
    found = after(in_control, *(one(1, number) for number in range(20, 28)))
    assert found.verdict == "unchanged"
    assert found.sentences[0].startswith("nothing has changed: 8 runs since 2026-11-06 against the 20")


def test_the_reference_period_says_nothing_yet(in_control: list[WatchedRun]) -> None:
    found = judge(in_control[:7], REFERENCE)
    assert found.verdict == "reference"
    assert "7 of 20 runs" in found.sentences[0]


def test_a_friction_that_grew_by_12_percent_is_named_within_five_runs(in_control: list[WatchedRun]) -> None:
    found = after(in_control, *(one(1, number, 1.12) for number in range(20, 25)))
    assert found.verdict == "changed"
    assert [change.parameter for change in found.changes] == [FRICTION]
    assert found.changes[0].since_run == "run020"
    assert found.changes[0].after / found.changes[0].before == pytest.approx(1.12, abs=0.03)
    assert "% up since 2026-11-06 (run020, 5 runs)" in found.sentences[0]


def test_play_that_appears_is_named_within_eight_runs(in_control: list[WatchedRun]) -> None:
    play = effect("chuck_backlash", play_deg=0.8)
    found = after(in_control, *(one(1, number, 1.0, play) for number in range(20, 28)))
    assert found.verdict == "changed"
    assert [change.parameter for change in found.changes] == [PLAY]
    assert "play_deg of 0.8" in found.sentences[0]
    assert "has appeared" in found.sentences[0]


def test_what_the_model_cannot_name_is_said_to_be_unknown(in_control: list[WatchedRun]) -> None:
    elastic = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.35)
    found = after(in_control, *(one(1, number, 1.0, elastic) for number in range(20, 28)))
    assert found.verdict == "unknown"
    assert "these runs do not say what" in found.sentences[0]
    assert "needle-rig diagnose run020.h5" in found.sentences[0]


def test_a_torque_gain_that_changed_is_told_beside_friction_and_rigidity(
    in_control: list[WatchedRun],
) -> None:
    gain = effect("torque_gain", gain=1.1)
    found = after(in_control, *(one(1, number, 1.0, gain) for number in range(20, 27)))
    assert {change.parameter for change in found.changes} == {FRICTION, "torsional_rigidity_nmm2"}
    assert found.sentences[-1].startswith("a torque sensor whose gain has changed")


def test_a_parameter_beyond_its_bound_stands_for_something_else(in_control: list[WatchedRun]) -> None:
    beyond = []
    for run in in_control[:8]:
        play = run.parameters[PLAY].model_copy(update={"at": -0.4 + 0.1 * run.misfit, "value": 0.0})
        parameters = {**run.parameters, PLAY: play}
        beyond.append(run.model_copy(update={"run": f"later_{run.run}", "parameters": parameters}))
    found = after(in_control, *beyond)
    assert found.verdict == "unknown"
    assert "play_deg would lie beyond its bound of 0 °" in found.sentences[0]


def test_runs_of_another_rig_are_not_compared(in_control: list[WatchedRun]) -> None:
    other = [
        run.model_copy(update={"rig": "another", "run": f"other{k}"}) for k, run in enumerate(in_control)
    ]
    found = judge([*in_control, *other[:3]], REFERENCE)
    assert found.verdict == "reference"
    assert (found.judged, found.not_judged) == (3, 20)


@pytest.mark.long
def test_series_of_fresh_seeds_are_told_right() -> None:
    """12 series: in control 60 runs; a step, a drift of 0.5 % a run, and play after their 20 of reference."""
    false_alarms, step, drift, play = 0, [], [], []
    for series in range(50, 62):
        first = reference(series)
        later = [one(series, number) for number in range(20, 60)]
        false_alarms += any(after(first, *later[:end]).verdict != "unchanged" for end in range(1, 41, 3))
        grown = [one(series, number, 1.12) for number in range(60, 68)]
        step.append(runs_until(first, grown, FRICTION))
        slow = [one(series, 70 + n, 1.0 + 0.005 * (n + 1)) for n in range(25)]
        drift.append(runs_until(first, slow, FRICTION))
        with_play = [one(series, 100 + n, 1.0, effect("chuck_backlash", play_deg=0.8)) for n in range(10)]
        play.append(runs_until(first, with_play, PLAY))
    assert false_alarms <= 2
    assert max(step) <= 6
    assert max(drift) <= 20
    assert max(play) <= 8


def runs_until(first: list[WatchedRun], later: list[WatchedRun], parameter: str) -> float:
    """Runs until `parameter`, and it alone, is named."""
    for end in range(1, len(later) + 1):
        found = after(first, *later[:end])
        if found.changes or found.verdict == "unknown":
            assert [change.parameter for change in found.changes] == [parameter], found.sentences
            return end
    return np.inf


def test_a_run_that_begins_with_a_wound_shaft_is_judged_after_a_run_in() -> None:
    protocol = Protocol("one", (compensation(45.0),))
    data = simulate_dataset(load_parameters("rig_rigid"), protocol, 7)
    (trial,) = data.trials
    whole = dataclasses.replace(data, trials=(dataclasses.replace(trial, start="wound"),))
    assert as_it_began(whole).trials[0].start == "relaxed"
    late = trial.trial.time_s >= 4.0  # at 45°, with the torque that friction holds
    drive = dataclasses.replace(
        trial.trial, time_s=trial.trial.time_s[late], base_angle_rad=trial.trial.base_angle_rad[late]
    )
    cut = dataclasses.replace(
        trial,
        trial=drive,
        base_measured_rad=trial.base_measured_rad[late],
        torque_nm=trial.torque_nm[late],
        hall_rad=trial.hall_rad[late],
        phase=trial.phase[late],
        start="wound",
    )
    begun = as_it_began(dataclasses.replace(data, trials=(cut,)))
    assert begun.trials[0].start == "wound"
    friction = look_at(begun, find_effects(), None, "run", "").parameters[FRICTION]
    assert abs(friction.value - 0.1) < 3.0 * friction.uncertainty


def test_every_run_is_looked_at_once_and_kept_beside_it(tmp_path: Path) -> None:
    write_run(tmp_path / "one.h5", pictures=False)
    (tmp_path / "broken.h5").write_bytes(b"no run")
    assert watch.look(tmp_path, find_effects())
    runs = {run.run: run for run in kept_runs(tmp_path)}
    assert set(runs) == {"one", "broken"}
    assert FRICTION in runs["one"].parameters
    assert "no HDF5" in runs["broken"].not_judged or "broken.h5" in runs["broken"].not_judged
    kept = tmp_path / WATCH_FOLDER / "one.json"
    written = kept.stat().st_mtime_ns
    assert watch.look(tmp_path, find_effects())
    assert kept.stat().st_mtime_ns == written
    assert "1 of 20 runs" in read_summary(tmp_path)[0]


def test_a_run_on_which_the_process_dies_is_not_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_run(tmp_path / "one.h5", pictures=False)

    def killed(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(watch, "identify", killed)
    with pytest.raises(KeyboardInterrupt):
        watch.look(tmp_path, find_effects())
    monkeypatch.undo()
    assert watch.look(tmp_path, find_effects())
    assert kept_runs(tmp_path)[0].not_judged == watch.UNFINISHED


def test_two_processes_do_not_look_at_once(tmp_path: Path) -> None:
    with watch._alone(tmp_path) as ours:
        assert ours
        assert not watch.look(tmp_path, find_effects())
    assert watch.look(tmp_path, find_effects())


def test_a_damaged_summary_and_a_damaged_file_say_nothing(tmp_path: Path) -> None:
    assert read_summary(tmp_path) == []
    (tmp_path / WATCH_FOLDER).mkdir()
    for damaged in ("{", "[]", '{"sentences": 3}'):
        (tmp_path / WATCH_FOLDER / SUMMARY).write_text(damaged)
        assert read_summary(tmp_path) == []
        assert read_contradiction(tmp_path) == ""
    (tmp_path / WATCH_FOLDER / "one.json").write_text("[1, 2]")
    assert read_summary(tmp_path) == []
    assert kept_runs(tmp_path) == []


def test_the_command_shows_what_every_run_said_and_begins_anew(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "one.h5", pictures=False)
    assert needle_rig(["watch", "--dir", str(tmp_path), "--list"]) == 0
    shown = capsys.readouterr().out
    assert "one" in shown
    assert "reference period: 1 of 20 runs" in shown
    assert needle_rig(["watch", "--dir", str(tmp_path), "--restart", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["judged"] == 0
    assert needle_rig(["watch", "--dir", str(tmp_path / "nowhere")]) == 2
    assert "--dir" in capsys.readouterr().err


def test_the_reference_period_is_as_long_as_the_rig_file_says(tmp_path: Path) -> None:
    said = watch.said_of(tmp_path, WatchSection(reference_runs=12)).sentences
    assert "0 of 12 runs" in said[0]
    assert watch.section_of(tmp_path, []).reference_runs == 20
