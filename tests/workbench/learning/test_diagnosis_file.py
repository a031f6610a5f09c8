"""What a diagnosis hands to adopt: its fits, as they were, on the data that they were made on."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from needle_rig.cli.adopt import command as adopt_command
from needle_rig.cli.diagnose import command as diagnose_command
from needle_rig.cli.main import run
from needle_rig.dataset import read_dataset, write_dataset
from needle_rig.errors import BadInput
from needle_rig.model import load_model
from needle_rig.version import VERSION
from needle_rig.workbench.learning.adopt import AGREES, Refused, adopt, adopt_diagnosis, undo
from needle_rig.workbench.learning.diagnosis_file import KeptDiagnosis, keep, load_diagnosis, save_diagnosis
from needle_rig.workbench.learning.observations import SettledValues, Traces, read_observations
from needle_rig.workbench.selection.explanation import IN_NOISE_UNITS
from tests.values import known
from tests.workbench.hidden import dataset, effect, few

PAIR = (
    effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45),
    effect("torque_bias", bias_nmm=0.02),
)
TIED = ["tissue_elasticity", "chuck_compliance", "torque_gain"]


CHOICE = "--effect tissue_elasticity --out MODEL.yaml"


@pytest.fixture(scope="module")
def traces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(dataset(*PAIR), tmp_path_factory.mktemp("pair") / "data")


@pytest.fixture(scope="module")
def kept(traces: Path) -> KeptDiagnosis:
    observed = Traces(read_dataset(traces))
    return keep(observed.diagnose(few(), None), observed)


@pytest.fixture(scope="module")
def file(kept: KeptDiagnosis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("kept") / "diagnosis.yaml"
    save_diagnosis(path, kept)
    return path


@pytest.fixture(scope="module")
def tie(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The diagnosis of the paper's settled values, and what was printed."""
    path = tmp_path_factory.mktemp("tie") / "diagnosis.yaml"
    result = CliRunner().invoke(diagnose_command, ["reed2008", "--out", str(path)])
    assert result.exit_code == 0, result.output
    return path, result.stdout


@pytest.mark.whole
def test_a_file_gives_back_what_was_kept(kept: KeptDiagnosis, file: Path) -> None:
    again = load_diagnosis(file)
    assert (again.sha256, again.verdict, again.effects) == (kept.sha256, kept.verdict, kept.effects)
    assert again.noise == kept.noise
    assert again.policy == kept.policy
    assert len(again.explanations) == len(kept.explanations)
    for one, other in zip(again.explanations, kept.explanations, strict=True):
        assert one.added == other.added
        assert one.model.values() == pytest.approx(dict(other.model.values()), rel=1e-12)
        assert dict(one.uncertainties) == pytest.approx(dict(other.uncertainties), rel=1e-12)
        assert one.trial_friction == other.trial_friction
        assert one.errors == other.errors
        assert one.improves == other.improves


@pytest.mark.whole
def test_both_effects_of_a_pair_are_adopted_in_one_step_and_taken_back_in_one(
    file: Path, traces: Path
) -> None:
    model = adopt_diagnosis(load_diagnosis(file), read_observations([traces]), today="2026-01-01")
    assert [set(entry.added) for entry in model.history] == [{"tissue_elasticity", "torque_bias"}]
    errors = model.history[0].errors[IN_NOISE_UNITS]
    assert known(errors.held_out_after) < 1.1 < 10.0 < known(errors.held_out_before)
    for name, truth in (
        ("tissue_elasticity.stiffness_nmm_per_rad_per_100mm", 0.45),
        ("torque_bias.bias_nmm", 0.02),
    ):
        assert model.model.values()[name] == pytest.approx(truth, abs=4 * model.uncertainties[name])
    back = undo(model)
    assert back.model.effects == ()
    assert back.history == ()


@pytest.mark.whole
def test_what_was_kept_is_what_fitting_again_finds(kept: KeptDiagnosis, traces: Path) -> None:
    """Not to the bit: the noise of the second step is measured against a model that has the first effect."""
    observed = read_observations([traces])
    one = adopt(observed, "tissue_elasticity", few())
    two = adopt(observed, "torque_bias", few(), one)
    taken_over = adopt_diagnosis(kept)
    for name, value in two.model.values().items():
        assert taken_over.model.values()[name] == pytest.approx(value, abs=2 * two.uncertainties[name])


@pytest.mark.whole
def test_a_diagnosis_that_began_at_a_model_goes_on_in_its_history(traces: Path) -> None:
    observed = read_observations([traces])
    one = adopt(observed, "tissue_elasticity", few(), name="mine", today="2026-01-01")
    kept = keep(observed.diagnose(few(), one.model), observed, one)
    assert kept.started_from == "mine"
    two = adopt_diagnosis(kept, observed)
    assert two.model.name == "mine"
    assert [entry.added for entry in two.history] == [("tissue_elasticity",), ("torque_bias",)]
    assert two.history[0] == one.history[0]
    assert [e.name() for e in undo(two).model.effects] == ["tissue_elasticity"]


def test_other_data_are_refused(file: Path) -> None:
    with pytest.raises(BadInput, match="is of other data"):
        adopt_diagnosis(load_diagnosis(file), Traces(dataset(*PAIR, seed=2)))


def test_the_identity_of_data_is_what_was_measured_and_not_their_name(traces: Path) -> None:
    data = read_dataset(traces)
    here = Traces(data).sha256()
    assert Traces(dataclasses.replace(data, name="other")).sha256() == here
    first = data.trials[0]
    moved = first.torque_nm.copy()
    moved[5] += 1e-12
    changed = dataclasses.replace(first, torque_nm=moved)
    assert Traces(dataclasses.replace(data, trials=(changed, *data.trials[1:]))).sha256() != here
    slower = dataclasses.replace(first, command=dataclasses.replace(first.command, speed_deg_s=44.0))
    assert Traces(dataclasses.replace(data, trials=(slower, *data.trials[1:]))).sha256() != here
    paper = read_observations(["reed2008"])
    assert isinstance(paper, SettledValues)
    value = dataclasses.replace(paper.data.values[0], value=25.0)
    other = dataclasses.replace(paper.data, values=(value, *paper.data.values[1:]))
    assert SettledValues(other).sha256() != paper.sha256()


@pytest.mark.parametrize(("factor", "refused"), [(0.5, False), (2.0, True)])
def test_a_model_that_no_longer_meets_its_data_is_refused(
    kept: KeptDiagnosis, traces: Path, factor: float, refused: bool
) -> None:
    """Friction is changed until the error is the limit, then by half or by twice that."""
    observed = read_observations([traces])
    found = kept.explanations[0]

    def changed(share: float) -> KeptDiagnosis:
        model = dataclasses.replace(found.model, friction_n=found.model.friction_n * (1.0 + share))
        return dataclasses.replace(kept, explanations=(dataclasses.replace(found, model=model),))

    def worst(share: float) -> float:
        errors = observed.errors(changed(share).explanations[0])
        return max(errors[n] / known(found.errors[n].training_after) for n in errors)

    share = 1e-3
    while worst(share) < AGREES:
        share *= 1.3
    if refused:
        with pytest.raises(BadInput, match=r"times the error that is stated, limit 1\.05"):
            adopt_diagnosis(changed(factor * share), observed)
    else:
        assert adopt_diagnosis(changed(factor * share), observed).history


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        (
            "needle-rig-diagnosis/1",
            "needle-rig-diagnosis/2",
            f"a diagnosis written by needle-rig {VERSION}, format 2",
        ),
        ("verdict: effect", "verdict: maybe", "'maybe' is not one of"),
        ("verdict: effect", "verdict: none", "the file was changed after it was written"),
        (r"value: 0\.", "value: 0.0", "the file was changed after it was written"),
        (r"(?<!_)value: [\d.]+", "value: .nan", "friction_nmm_per_100mm"),
        (r"training_after: [\d.e-]+", "training_after: .nan", "is not a finite number"),
        (r"trial_friction: \[", "trial_friction: [.nan, ", "is not a finite number"),
        (r"trial_friction: \[", "trial_friction: [-1.0, ", "is not above 0"),
        ("tissue_elasticity:", "glue:", "glue"),
        ("sha256: ", "sha256: x", "sha256"),
        ("noise:", "colour: red\nnoise:", "unknown key"),
    ],
)
def test_what_is_wrong_with_a_file_is_a_sentence_with_its_line(
    file: Path, tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    text = file.read_text(encoding="utf-8")
    damaged, times = re.subn(old, new, text, count=1)
    assert times == 1
    path = tmp_path / "diagnosis.yaml"
    path.write_text(damaged, encoding="utf-8")
    with pytest.raises(BadInput) as refused:
        load_diagnosis(path)
    assert sentence in str(refused.value)
    assert f"{path}:" in str(refused.value)


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3, 0.6, 0.95, 0.999])
def test_a_file_that_is_cut_off_is_one_sentence_and_no_traceback(
    file: Path, tmp_path: Path, share: float, capsys: pytest.CaptureFixture[str]
) -> None:
    text = file.read_bytes()
    path = tmp_path / "diagnosis.yaml"
    path.write_bytes(text[: int(share * len(text))])
    assert run(["adopt", str(path), "--out", str(tmp_path / "model.yaml")]) == 2
    said = capsys.readouterr().err
    assert str(path) in said
    assert "Traceback" not in said
    assert not (tmp_path / "model.yaml").exists()


@pytest.mark.whole
def test_a_tie_lists_its_alternatives_and_waits_for_a_choice(tie: tuple[Path, str], tmp_path: Path) -> None:
    path, _ = tie
    kept = load_diagnosis(path)
    assert [found.added for found in kept.explanations] == [(name,) for name in TIED]
    with pytest.raises(BadInput, match=r"cannot be told apart: .*; name the effects of one$"):
        adopt_diagnosis(kept)
    with pytest.raises(BadInput, match="tip_friction is not in it; it has tissue_elasticity;"):
        adopt_diagnosis(kept, effects=("tip_friction",))
    model = tmp_path / "model.yaml"
    words = [str(path), "reed2008", "--effect", "tissue_elasticity", "--out", str(model), "--json"]
    result = CliRunner().invoke(adopt_command, words)
    assert result.exit_code == 0, result.output
    told = json.loads(result.stdout)
    assert told["added"] == ["tissue_elasticity"]
    assert told["held_out_error"] < told["held_out_error_before"]
    assert load_model(model).history[0].dataset == "reed2008"


@pytest.mark.whole
def test_settled_values_are_adopted_by_name_as_traces_are(tie: tuple[Path, str], tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    result = CliRunner().invoke(adopt_command, ["reed2008", "tissue_elasticity", "--out", str(model)])
    assert result.exit_code == 0, result.output
    taken_over = adopt_diagnosis(load_diagnosis(tie[0]), effects=("tissue_elasticity",))
    assert load_model(model).model.values() == pytest.approx(dict(taken_over.model.values()), rel=1e-9)


@pytest.mark.whole
def test_diagnose_prints_the_command_that_takes_its_answer_over(tie: tuple[Path, str]) -> None:
    path, printed = tie
    assert f"adopt it: needle-rig adopt {path} reed2008 {CHOICE}" in printed


@pytest.mark.slow
def test_without_a_file_it_prints_the_command_that_writes_one() -> None:
    without = CliRunner().invoke(diagnose_command, ["reed2008"]).stdout
    assert (
        "adopt it: needle-rig diagnose reed2008 --out DIAGNOSIS.yaml, then"
        f" needle-rig adopt DIAGNOSIS.yaml reed2008 {CHOICE}"
    ) in without


def test_a_place_that_cannot_be_written_is_said_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["diagnose", "reed2008", "--out", str(tmp_path / "nowhere" / "diagnosis.yaml")]) == 2
    said = capsys.readouterr().err
    assert "there is no folder" in said
    assert "trying every effect" not in said


def test_a_verdict_without_an_effect_leaves_nothing_to_adopt(kept: KeptDiagnosis) -> None:
    nothing = dataclasses.replace(kept, verdict="none", effects=(), explanations=(), models=())
    with pytest.raises(BadInput, match="its verdict is none, it names no effect"):
        adopt_diagnosis(nothing)


def test_what_improves_no_cross_validation_is_refused_without_force(kept: KeptDiagnosis) -> None:
    idle = tuple(dataclasses.replace(found, improves=False) for found in kept.explanations)
    with pytest.raises(Refused, match="With force it is added"):
        adopt_diagnosis(dataclasses.replace(kept, explanations=idle))
    forced = adopt_diagnosis(dataclasses.replace(kept, explanations=idle), force=True)
    assert "force" in forced.history[-1].note


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["diagnosis.yaml", "--model", "m.yaml"], "leave --model out"),
        (["data", "torque_bias", "--effect", "torque_bias"], "name that file first"),
        (["data"], "Name a diagnosis file, or the data and the effect"),
        (["nowhere.yaml"], "nowhere.yaml"),
    ],
)
def test_words_that_do_not_fit_together_are_one_sentence(
    words: list[str], sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["adopt", *words, "--out", str(tmp_path / "model.yaml")]) == 2
    assert sentence in capsys.readouterr().err
