import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from campaigns.workbench.noise_kinds import noisy
from needle_rig.dataset import in_series, read_dataset, write_dataset
from needle_rig.physics.effect import Effect
from needle_rig.units import nm
from needle_rig.workbench.parallel import workers
from needle_rig.workbench.policy import POLICY
from needle_rig.workbench.selection import notes, search
from needle_rig.workbench.selection.candidates import refit
from needle_rig.workbench.selection.diagnose import diagnose
from needle_rig.workbench.selection.values import spelt_sigmas
from needle_rig.workbench.virtual.noise import Noise
from tests.values import known
from tests.workbench.hidden import dataset, diagnosed, effect, few, null_fit, try_effect

ELASTIC = effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45)
BIAS_AND_FRICTION = effect("torque_bias", bias_nmm=0.02), effect("tip_friction", torque_nmm=0.03)


def test_nothing_hidden_is_none() -> None:
    found = diagnosed(seed=5)
    assert found.verdict == "none"
    assert found.effects == ()
    assert {d.decision for d in found.decisions.values()} <= {"absent", "cannot_tell", "negligible"}
    assert found.next_experiment is None


def test_one_hidden_effect_is_named_with_its_size() -> None:
    found = diagnosed(ELASTIC)
    assert (found.verdict, found.effects) == ("effect", ("tissue_elasticity",))
    value = found.ranking[0].values[0]
    assert value.low <= 0.45 <= value.high
    assert value.plausible
    assert found.held_out_error_before > 10
    assert found.held_out_error_after < 1.1 * found.noise_floor
    assert found.explained_fraction > 0.99
    assert found.decisions["tissue_elasticity"].decision == "present"
    times = found.held_out_error_before / found.held_out_error_after
    told = f"; without it the error on them is {times:.0f} times as large (more than 8σ)"
    assert told in found.ranking[0].in_favour


def test_a_distance_is_a_figure_as_far_as_a_chance_is_known() -> None:
    assert [spelt_sigmas(sigmas) for sigmas in (0.04, -2.54, 7.96, 8.01, -2540.0)] == [
        "0.0σ",
        "2.5σ",
        "8.0σ",
        "more than 8σ",
        "more than 8σ",
    ]


@pytest.mark.whole
def test_two_hidden_effects_are_both_named() -> None:
    found = diagnosed(*BIAS_AND_FRICTION)
    assert set(found.effects) == {"torque_bias", "tip_friction"}


@pytest.mark.whole
def test_an_effect_in_no_library_is_unknown_and_described() -> None:
    found = diagnosed(ELASTIC, library=("torque_bias", "hall_offset", "clock_offset"))
    assert found.verdict == "unknown"
    assert found.effects == ()
    assert found.residual_patterns.patterns
    assert "%" in found.residual_patterns.patterns[0].sentence()
    assert found.as_json()["left_over"]["explained"] is False


@pytest.mark.whole
def test_a_needle_that_snaps_and_that_no_effect_predicts_is_called_stick_slip() -> None:
    snapping = dataset(effect("stribeck", static_excess=1.0, rate_deg_s=11.5, weakening_deg=0.8))
    found = diagnose(snapping, few("torque_bias", "hall_offset"))
    assert found.verdict == "unknown"
    assert {"pattern_matters", "stick_slip"} <= {r.rule for r in found.reasons}
    assert found.sentence() == "the needle sticks and slips, and no effect of the library predicts it."
    assert {d.decision for d in found.decisions.values()} == {"cannot_tell"}
    assert not any("too small to matter" in note for note in found.notes)


@pytest.mark.whole
def test_a_relative_that_does_not_reach_the_noise_is_not_the_answer() -> None:
    creeping = effect(
        "tissue_viscoelasticity",
        relaxed_stiffness_nmm_per_rad_per_100mm=0.35,
        relaxing_stiffness_nmm_per_rad_per_100mm=0.05,
        relaxation_time_s=2.0,
    )
    found = diagnosed(creeping, library=("tissue_elasticity", "torque_bias", "hall_offset"))
    assert found.explained_fraction > 0.99
    assert found.verdict == "unknown"
    assert "tissue_elasticity removes 99.8 % of the error and leaves 2.4" in found.notes[-1]
    assert "time since a stop" in found.residual_patterns.patterns[0].sentence()


@pytest.mark.long
def test_friction_of_which_screening_promises_nothing_is_found_from_a_finite_strength() -> None:
    """Beside viscous slip a little static excess makes nothing better: the damping must rise with it."""
    hidden = (
        effect("stribeck", static_excess=0.08, rate_deg_s=7.5, weakening_deg=0.05, exponent=1.5),
        effect("viscous_slip", viscosity_nmms_per_rad_per_100mm=0.04),
    )
    found = diagnose(dataset(*hidden, seed=4), few("stribeck", "viscous_slip"))
    assert set(found.effects) == {"stribeck", "viscous_slip"}
    assert found.held_out_error_after < POLICY.verdict.reached


def test_a_present_model_that_cannot_be_fitted_again_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(search, "refit", lambda *_: (None, None))
    found = diagnose(dataset(effect("torque_bias", bias_nmm=0.001)), few("torque_bias", "chuck_backlash"))
    assert found.verdict == "none"
    assert found.decisions["torque_bias"].decision == "negligible"


def test_an_effect_too_small_to_matter_is_negligible() -> None:
    found = diagnosed(effect("torque_bias", bias_nmm=0.001), library=("torque_bias", "chuck_backlash"))
    assert found.verdict == "none"
    assert found.decisions["torque_bias"].decision == "negligible"
    assert [(s.kind, s.best) for s in found.search.steps] == [("set aside", frozenset())]
    directions = [p.nuisance[0].shape[1] for p in (found.baseline.problem, found.search.problem)]
    assert directions == [1, 2]


@pytest.mark.whole
def test_a_torque_gain_is_known_by_the_needle_s_stated_constants() -> None:
    found = diagnosed(effect("torque_gain", gain=0.7), library=("torque_gain", "torque_bias", "tip_friction"))
    assert found.effects == ("torque_gain",)
    assert found.ranking[0].values[0].value == pytest.approx(0.7, abs=0.06)


@pytest.mark.whole
def test_friction_that_wears_is_not_taken_for_scatter() -> None:
    found = diagnosed(
        effect("friction_wear", loss_per_turn=0.5), library=("friction_wear", "torque_bias", "tip_friction")
    )
    assert found.effects == ("friction_wear",)
    assert found.ranking[0].values[0].value == pytest.approx(0.5, abs=0.1)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("hidden", "law"),
    [
        (effect("torque_gain", gain=0.7), "the needle is softer in torsion than stated"),
        (effect("friction_wear", loss_per_turn=0.5), "the trials' friction changes with"),
    ],
)
def test_what_rigidity_or_random_effects_absorbed_is_a_residual_pattern(hidden: Effect, law: str) -> None:
    found = diagnosed(hidden, library=("torque_bias", "tip_friction"))
    assert (found.verdict, found.effects) == ("unknown", ())
    assert law in found.residual_patterns.patterns[0].sentence()
    assert not found.residual_patterns.patterns[1:]


@pytest.mark.whole
def test_several_effects_at_odd_values_describe_and_are_not_named(monkeypatch: pytest.MonkeyPatch) -> None:
    none_at_any_value = dataclasses.replace(POLICY.verdict, at_any_value=0)
    monkeypatch.setattr(notes, "POLICY", dataclasses.replace(POLICY, verdict=none_at_any_value))
    found = diagnose(dataset(effect("chuck_backlash", play_deg=14.0)), few("chuck_backlash", "torque_bias"))
    assert (found.verdict, found.effects) == ("unknown", ())
    assert "chuck_backlash play_deg = 14 °" in found.notes[-1]
    assert found.residual_patterns.patterns


@pytest.mark.whole
def test_the_answer_does_not_depend_on_names_and_order(tmp_path: Path) -> None:
    data = dataset(ELASTIC)
    shuffled = tuple(data.trials[i] for i in (3, 0, 4, 2, 1))
    renamed = tuple(dataclasses.replace(t, file=f"other/{i}.csv") for i, t in enumerate(shuffled))
    other = dataclasses.replace(data, name="another", trials=in_series(renamed))
    one, two = diagnosed(ELASTIC).as_json(), diagnose(other, few()).as_json()
    assert one["dataset"] != two["dataset"]
    assert {**one, "dataset": ""} == {**two, "dataset": ""}


TWO = ("chuck_backlash", "torque_bias")


@pytest.fixture(scope="module")
def answer_here() -> Any:
    return diagnosed(effect("chuck_backlash", play_deg=5.0), library=TWO).as_json()


@pytest.mark.whole
def test_processes_give_the_same_answer(answer_here: Any) -> None:
    data = dataset(effect("chuck_backlash", play_deg=5.0))
    assert diagnose(data, few(*TWO), work=workers(2, None)).as_json() == answer_here


@pytest.mark.whole
def test_a_dask_cluster_gives_the_same_answer(answer_here: Any) -> None:
    distributed = pytest.importorskip("distributed")
    data = dataset(effect("chuck_backlash", play_deg=5.0))
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None) as cluster:
        there = diagnose(data, few(*TWO), work=workers(None, cluster.scheduler_address)).as_json()
    assert there == answer_here


def test_without_replicates_the_answer_says_so() -> None:
    data = dataset(ELASTIC)
    one = dataclasses.replace(data, trials=in_series(tuple(data.trials[i] for i in (0, 2, 3))))
    found = diagnose(one, few("tissue_elasticity", "torque_bias"))
    assert found.effects == ("tissue_elasticity",)
    assert any("repeat one command" in n for n in found.notes)


@pytest.mark.whole
def test_outliers_are_not_physics() -> None:
    data = dataset(seed=7)
    random = np.random.default_rng(2)
    trials = []
    for given in data.trials:
        torque = given.torque_nm.copy()
        hit = random.random(torque.size) < 0.02
        torque[hit] += nm(0.05) * random.standard_normal(hit.sum())
        trials.append(dataclasses.replace(given, torque_nm=torque))
    found = diagnose(dataclasses.replace(data, trials=tuple(trials)), few())
    assert found.verdict == "none"
    assert any("outliers" in n for n in found.notes)


def test_the_command_prints_the_stated_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from click.testing import CliRunner

    from needle_rig.cli.diagnose import command

    folder = write_dataset(dataset(effect("torque_bias", bias_nmm=0.02)), tmp_path / "data")
    library = few("torque_bias", "chuck_backlash")
    monkeypatch.setattr("needle_rig.questions.question.Question.library", lambda *_: library)
    result = CliRunner().invoke(command, [str(folder), "--json", "--jobs", "1"])
    assert result.exit_code == 0, result.output
    answer = json.loads(result.stdout)
    assert answer["verdict"] == "effect"
    assert answer["effects"] == ["torque_bias"]
    assert set(answer["ranking"][0]["parameters"]["bias_nmm"]) == {"value", "unit", "low", "high"}
    assert set(answer) >= {
        "noise_floor",
        "held_out_error_before",
        "held_out_error_after",
        "explained_fraction",
        "decisions",
        "left_over",
        "next_experiment",
    }
    plain = CliRunner().invoke(command, [str(folder), "--jobs", "1"])
    assert "torque_bias missing" in plain.stdout


@pytest.mark.whole
def test_a_single_command_is_ranked_by_blocks_of_its_time_and_said_to_be_weak() -> None:
    data = dataset(effect("torque_bias", bias_nmm=0.02))
    one = dataclasses.replace(data, trials=in_series(tuple(data.trials[i] for i in (0, 1, 4))))
    found = diagnose(one, few("torque_bias", "tip_friction"))
    assert found.effects == ("torque_bias",)
    assert found.held_out_error_after < 1.1
    assert any("One command alone" in n for n in found.notes)


@pytest.mark.whole
def test_a_dead_sensor_does_not_stop_the_diagnosis() -> None:
    data = dataset(effect("torque_bias", bias_nmm=0.02))
    trials = []
    for given in data.trials:
        hall = given.hall_rad.copy()
        hall[:, 2] = np.nan
        trials.append(dataclasses.replace(given, hall_rad=hall))
    found = diagnose(dataclasses.replace(data, trials=tuple(trials)), few("torque_bias", "tip_friction"))
    assert found.effects == ("torque_bias",)


@pytest.mark.whole
def test_two_names_for_one_law_are_a_tie(tmp_path: Path) -> None:
    import needle_rig.physics.effects.torque_bias as built_in
    from needle_rig.physics.library import find_effects

    source = Path(built_in.__file__).read_text()
    (tmp_path / "cell_zero.py").write_text(source.replace("class TorqueBias", "class CellZero"))
    every = find_effects([tmp_path])
    library = {n: every[n] for n in ("torque_bias", "cell_zero", "chuck_backlash")}
    found = diagnose(dataset(effect("torque_bias", bias_nmm=0.02)), library)
    assert found.verdict == "effect"
    assert {found.effects[0], *found.ranking[0].indistinguishable_from} == {"torque_bias", "cell_zero"}
    assert known(found.ranking[0].separation_sigma) < 1
    assert "fits as well" in found.ranking[0].against


@pytest.mark.whole
def test_a_tie_comes_with_the_trial_that_breaks_it() -> None:
    data = dataset(effect("guide_friction", torque_nmm=0.004))
    found = diagnose(data, few("guide_friction", "chuck_backlash", "tip_friction"))
    assert "guide_friction" in {*found.effects, *found.ranking[0].indistinguishable_from}
    if found.ranking[0].indistinguishable_from:
        assert known(found.next_experiment)["separation_sigma"] > 1


@pytest.mark.whole
def test_what_was_not_refitted_is_said() -> None:
    found = diagnosed(*BIAS_AND_FRICTION)
    search = found.search
    on_top = search.children[search.best]
    assert on_top
    assert all(c.fit is not None for c in on_top)
    for name in found.effects:
        rest = frozenset(search.best - {name})
        left_out = [
            c for c in search.children[rest] if c.fit is None and rest | {c.effect} not in search.fits
        ]
        left_out = [c for c in left_out if c.effect not in search.best]
        said = [n for n in found.notes if n.startswith(f"In the place of {name}, {len(left_out)} effects")]
        assert len(said) == bool(left_out)


@pytest.mark.whole
def test_the_folder_changes_no_verdict(tmp_path: Path) -> None:
    data = dataset(effect("torque_bias", bias_nmm=0.02))
    names = few("torque_bias", "tip_friction")
    answers = []
    for folder in ("one", "zwei"):
        read = read_dataset(write_dataset(data, tmp_path / folder))
        answers.append(diagnose(dataclasses.replace(read, name="x"), names).as_json())
    assert answers[0] == answers[1]


def test_an_effect_of_no_size_lends_its_better_fit_to_the_others() -> None:
    baseline = null_fit(ELASTIC, library=("tissue_elasticity", "torque_bias"))
    problem, names = baseline.problem, ("tissue_elasticity", "torque_bias")
    good = try_effect(problem, baseline.current, "tissue_elasticity")
    worse = dataclasses.replace(good.fit, objective=good.fit.objective + 30.0)
    idle = dataclasses.replace(good.fit.vector, scaled_values=np.r_[good.fit.vector.scaled_values, 0.0])
    began = search.SearchTrace.begin(problem, names, baseline.current, baseline.validation)
    before = began.keep(worse, good.validation).keep(*refit(problem, names, idle))
    after = search.take_out(before, frozenset(names), "torque_bias")
    assert frozenset(names) in before.fits
    assert frozenset(names) not in after.fits
    assert after.fits[frozenset(names[:1])][0].objective == pytest.approx(good.fit.objective, abs=0.1)
    assert [s.kind for s in after.steps] == ["taken out"]


@pytest.mark.whole
def test_what_is_left_and_matters_is_not_forgiven_to_what_explains_nearly_all() -> None:
    """Friction of the guide, not in the library: two others take 99 % of it and leave the torque."""
    found = diagnosed(
        effect("guide_friction", torque_nmm=0.02), library=("layered_friction", "insertion_depth")
    )
    assert found.explained_fraction > 0.97
    assert known(found.search.fits[found.search.best][1]).error < 1.1
    assert found.verdict == "unknown"
    assert not found.effects


def test_a_quick_diagnosis_names_one_effect_and_says_what_it_left_out() -> None:
    data = dataset(
        effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45),
        effect("torque_bias", bias_nmm=0.05),
    )
    found = diagnose(data, few("tissue_elasticity", "torque_bias", "hall_offset"), quick=True)
    assert found.search.named(found.search.best) == ["tissue_elasticity"]
    assert len(found.search.children) == 1
    assert found.verdict == "unknown"
    assert "whether a second is missing" in found.notes[0]
    assert found.decisions["hall_offset"].decision == "cannot_tell"


@pytest.mark.whole
def test_noise_that_shows_beside_what_is_named_is_not_named_too() -> None:
    late = effect("clock_offset", torque_delay_ms=55.0, hall_delay_ms=55.0)
    silent = dataset(late, seed=4, noise=Noise(hall_deg=0.0, torque_nmm=0.0))
    said: list[str] = []
    found = diagnose(
        noisy(silent, "wanders over 2 s", Noise(), 4),
        few("clock_offset", "platform_friction"),
        say=said.append,
    )
    assert (found.verdict, found.effects) == ("effect", ("clock_offset",))
    assert any("under the noise that shows beside what was found" in each for each in said)
    assert found.baseline.problem.noise.shown[0].sd.min() > 0.0
