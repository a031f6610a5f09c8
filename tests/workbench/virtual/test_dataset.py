import math
from pathlib import Path

import numpy as np
import pytest

from needle_rig.control.lag import effective_length_m
from needle_rig.dataset import read_dataset
from needle_rig.dataset.protocol import Protocol, compensation, load_protocol, save_protocol, staircase
from needle_rig.errors import BadInput
from needle_rig.model import EXPERIMENT_LAYOUT, MODEL_LAYOUT, load_parameters
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import FRICTION
from needle_rig.questions.simulate import layout_named
from needle_rig.simulation.drive.base_drive import Motion, base_path
from needle_rig.workbench.virtual.dataset import simulate_dataset
from needle_rig.workbench.virtual.noise import NO_NOISE, Noise
from tests.workbench.hidden import effect

PRACTICE = Path(__file__).parents[2] / "data" / "practice"
SHORT = Protocol("short", (compensation(45), compensation(45), staircase([30, 0])))


def test_the_standard_protocol_is_that_of_the_practice_datasets() -> None:
    practice = read_dataset(PRACTICE / "none")
    planned = load_protocol("standard")
    assert [t.command for t in practice.trials] == list(planned.trials)
    model = load_parameters("rig_rigid").replaced({FRICTION: 0.11, "torsional_rigidity_nmm2": 61.78})
    ours = simulate_dataset(model, planned, seed=5)
    for a, b in zip(practice.trials, ours.trials, strict=True):
        assert a.trial.start_s == pytest.approx(b.trial.start_s, abs=3.0)
        assert list(dict.fromkeys(a.phase.tolist())) == list(dict.fromkeys(b.phase.tolist()))
        assert len(a.phase) == pytest.approx(len(b.phase), rel=0.02)


def test_the_base_moves_as_in_the_practice_datasets() -> None:
    for trial in read_dataset(PRACTICE / "none").trials:
        first = trial.command.target_deg or trial.command.steps_deg[0]
        speed = math.radians(trial.command.speed_deg_s or 0)
        # Their drive steps by a few milliseconds; ours is continuous.
        motion = Motion("rotate", 0.4967, 0.0, math.radians(first), speed, 3.0)
        until = trial.trial.time_s < 0.5 + abs(math.radians(first)) / speed + 1.9
        ours = base_path((motion,), trial.trial.time_s[until])
        off = np.degrees(ours - trial.base_measured_rad[until])
        assert off.std() < 0.024
        assert np.abs(off).max() < 0.12


def test_the_sequence_follows_the_measured_torque() -> None:
    model = load_parameters("rig_rigid")
    trial = simulate_dataset(model, SHORT, 1, NO_NOISE).trials[0]
    end = {p: int(np.flatnonzero(trial.phase == p)[-1]) for p in dict.fromkeys(trial.phase.tolist())}
    base = np.degrees(trial.trial.base_angle_rad)
    torque = trial.torque_nm[end["rotate"]]
    lag = math.degrees(torque / model.torsional_rigidity_nm2 * effective_length_m(EXPERIMENT_LAYOUT))
    assert lag == pytest.approx(26, abs=0.1)
    for phase, share in (("overshoot", 1.0), ("back", -0.75), ("forward", 0.25), ("final", 0.0)):
        assert base[end[phase]] == pytest.approx(45 + share * lag, abs=0.01)
    assert np.degrees(trial.hall_rad[-1]) == pytest.approx([44.4, 44.3, 44.9, 45], abs=0.05)


@pytest.mark.parametrize("effect", ["chuck_backlash", "stribeck", "tissue_viscoelasticity", "clock_offset"])
def test_waypoints_follow_what_the_dataset_s_own_samples_show(effect: str) -> None:
    """The needle that the sequence was decided on, motion by motion, is the one that the dataset shows."""
    model = load_parameters("rig_rigid").with_effects(find_effects()[effect].at_strength(1.0))
    trial = simulate_dataset(model, Protocol("one", (compensation(60),)), 1, NO_NOISE).trials[0]
    rotate, overshoot = (np.flatnonzero(trial.phase == name) for name in ("rotate", "overshoot"))
    time_s = trial.trial.time_s
    torque_nm = trial.torque_nm[rotate][time_s[rotate] > time_s[rotate[-1]] - 0.48].mean()
    lag_rad = torque_nm / model.torsional_rigidity_nm2 * effective_length_m(EXPERIMENT_LAYOUT)
    arrived_rad = trial.trial.base_angle_rad[overshoot[-1]]
    assert arrived_rad == pytest.approx(math.radians(60.0) + lag_rad, abs=math.radians(0.02))


def test_noise_is_as_told() -> None:
    plan = Protocol("rest", (staircase([10], settle_s=100),))
    model = load_parameters("rig_rigid").replaced({FRICTION: 1.0})
    trial = simulate_dataset(model, plan, 3, Noise(0.3, 0.001, 0.02, 0, 0)).trials[0]
    tail = slice(-4000, None)
    assert np.degrees(trial.hall_rad[tail]).std(axis=0) == pytest.approx(0.3, rel=0.06)
    assert trial.torque_nm[tail].std() == pytest.approx(1e-6, rel=0.06)
    assert np.degrees(trial.base_measured_rad[tail]).std() == pytest.approx(0.02, rel=0.06)
    assert np.ptp(trial.trial.base_angle_rad[tail]) == 0.0


def test_friction_scatters_from_trial_to_trial() -> None:
    plan = Protocol("many", (staircase([60]),) * 60)
    trials = simulate_dataset(load_parameters("rig_rigid"), plan, 2, Noise(0, 0, 0, 0.05)).trials
    torque = np.array([t.torque_nm[-1] for t in trials])
    assert torque.std() / torque.mean() == pytest.approx(0.05, rel=0.35)


def test_the_seed_decides_and_later_trials_do_not_matter() -> None:
    model = load_parameters("rig_rigid")
    a, b = (simulate_dataset(model, SHORT, 7) for _ in range(2))
    c = simulate_dataset(model, SHORT, 8)
    d = simulate_dataset(model, Protocol("first", SHORT.trials[:1]), 7)
    assert np.array_equal(a.trials[2].hall_rad, b.trials[2].hall_rad)
    assert not np.array_equal(a.trials[0].torque_nm, c.trials[0].torque_nm)
    assert np.array_equal(a.trials[0].torque_nm, d.trials[0].torque_nm)


def test_denoising_the_base_biases_nothing() -> None:
    """The model driven by the denoised encoder against the model driven by the true base."""
    library = find_effects()
    rigid = load_parameters("rig_rigid")
    elastic = rigid.with_effects(library["tissue_elasticity"].at_strength(1.0))
    play = rigid.with_effects(library["chuck_backlash"].at_strength(1.0))
    plan = load_protocol("standard")
    for model in (rigid, elastic, play):
        for seed in (1, 2):
            noisy = simulate_dataset(model, plan, seed, Noise(0, 0, 0.02, 0))
            for trial in noisy.trials:
                shown = model.predict(trial.trial)
                torque_nmm = 1e3 * (shown.torque_nm - trial.torque_nm)
                angle_deg = np.degrees(shown.hall_rad - trial.hall_rad)
                settled = np.abs(np.gradient(trial.trial.base_angle_rad)) < 1e-9
                assert np.abs(torque_nmm[settled]).max() < 2e-4
                assert np.abs(angle_deg[settled]).max() < 0.05
                assert abs(torque_nmm.mean()) < 2e-5
                assert np.abs(angle_deg).max() < 0.15


def test_protocol_files_round_trip(tmp_path: Path) -> None:
    save_protocol(tmp_path / "p.yaml", SHORT, note="three trials")
    assert load_protocol(tmp_path / "p.yaml") == SHORT


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{kind: compensate, speed_deg_s: 45, settle_s: 3}", "needs its target_deg"),
        ("{kind: staircase, speed_deg_s: 45, settle_s: 3}", "needs its steps_deg"),
        ("{kind: compensate, target_deg: 45, speed_deg_s: -1, settle_s: 3}", "speed_deg_s: -1"),
        ("{kind: twirl, target_deg: 45, speed_deg_s: 1, settle_s: 3}", "twirl"),
    ],
)
def test_protocols_that_cannot_be(tmp_path: Path, text: str, words: str) -> None:
    file = tmp_path / "p.yaml"
    file.write_text(f"format: needle-rig-protocol/1\nname: p\ntrials:\n  - {text}\n")
    with pytest.raises(BadInput) as caught:
        load_protocol(file)
    assert "p.yaml:4:" in str(caught.value)
    assert words in str(caught.value)


def test_unknown_protocols_and_layouts() -> None:
    with pytest.raises(BadInput, match=r"there is no protocol fast; there are .*standard"):
        load_protocol("fast")
    assert layout_named("model") == MODEL_LAYOUT
    assert layout_named(str(PRACTICE / "none")).tissue_sections_m == EXPERIMENT_LAYOUT.tissue_sections_m
    with pytest.raises(BadInput, match="neither experiment nor model"):
        layout_named("elsewhere")
    with pytest.raises(BadInput, match="hall_deg is -1"):
        Noise(hall_deg=-1)


def test_the_command_writes_a_dataset(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from needle_rig.cli.main import run

    out = tmp_path / "mine"
    told = ["simulate", "--effect", "tissue_elasticity=0.35", "--seed", "4", "--out", str(out)]
    assert run(told) == 0
    assert capsys.readouterr().out.endswith("samples; rig_rigid with tissue_elasticity=0.35, seed 4\n")
    written = read_dataset(out)
    model = load_parameters("rig_rigid").with_effects(
        effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.35)
    )
    direct = simulate_dataset(model, load_protocol("standard"), 4)
    assert written.notes == ()
    for a, b in zip(written.trials, direct.trials, strict=True):
        np.testing.assert_allclose(a.hall_rad, b.hall_rad, atol=1e-6)
        np.testing.assert_allclose(a.torque_nm, b.torque_nm, atol=1e-9)
        np.testing.assert_allclose(a.trial.base_angle_rad, b.trial.base_angle_rad, atol=3e-5)
    assert run(told) == 2
    assert "holds a dataset already" in capsys.readouterr().err
    assert run(["simulate", "--effect", "tissue_elasticty=1", "--out", str(tmp_path / "x")]) == 2
    assert "did you mean tissue_elasticity?" in capsys.readouterr().err
