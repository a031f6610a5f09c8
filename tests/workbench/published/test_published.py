"""Published settled values as data: the loop inside the model, the ties, and what would decide."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from needle_rig.cli.compare import command as compare
from needle_rig.cli.diagnose import command as diagnose
from needle_rig.cli.experiment import command as experiment
from needle_rig.dataset.settled import Seen, SettledData, SettledValue, read_settled, shipped_datasets
from needle_rig.errors import BadInput
from needle_rig.model import load_parameters
from needle_rig.physics.effect import Effect
from needle_rig.physics.library import find_effects
from needle_rig.physics.needle_model import NeedleModel
from needle_rig.units import deg
from needle_rig.workbench.published.diagnose_settled import diagnose_settled
from needle_rig.workbench.published.fit import SettledProblem
from tests.values import known
from tests.workbench.hidden import effect, few

TIED = ["tissue_elasticity", "chuck_compliance", "torque_gain"]


def paper() -> SettledData:
    return read_settled(shipped_datasets()["reed2008"])


def rig(friction_nmm_per_100mm: float, *effects: Effect) -> NeedleModel:
    model = load_parameters("rig_rigid").with_effects(*effects)
    return model.replaced({"friction_nmm_per_100mm": friction_nmm_per_100mm})


def readings(
    model: NeedleModel, data: SettledData, ofs: list[Seen], errors: dict[str, float], seed: int | None = None
) -> SettledData:
    """`data` with readings of `model` in the place of its values, and with noise when a seed is given."""
    problem = SettledProblem(data, model, {}, ())
    runs = problem.run(model)
    random = np.random.default_rng(seed)
    values = []
    for of in ofs:
        error = errors[of.quantity]
        noise = error * random.standard_normal() if seed is not None else 0.0
        values.append(SettledValue(of, problem.reading(runs, of) + noise, error))
    return dataclasses.replace(data, values=tuple(values))


@pytest.fixture(scope="module")
def answer(tmp_path_factory: pytest.TempPathFactory) -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("elsewhere"))
        result = CliRunner().invoke(diagnose, ["reed2008", "--json"])
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.whole
def test_the_paper_s_numbers_leave_a_tie_of_three_in_the_order_of_plausibility(answer: Any) -> None:
    assert answer["verdict"] == "effect"
    assert answer["effects"] == ["tissue_elasticity"]
    assert [r["effect"] for r in answer["ranking"][:3]] == TIED
    for row in answer["ranking"]:
        tied = [n for n in TIED if n != row["effect"]] if row["effect"] in TIED else []
        assert row["indistinguishable_from"] == tied
    assert all(r["separation_sigma"] < 3 for r in answer["ranking"][:3])
    assert "well within what is plausible" in answer["ranking"][0]["in_favour"]
    assert all("near the edge of what is plausible" in r["against"] for r in answer["ranking"][1:3])
    assert {answer["decisions"][n]["decision"] for n in TIED} == {"cannot_tell"}
    assert answer["held_out_error_after"] < 0.5 * answer["held_out_error_before"]


@pytest.mark.whole
def test_what_decides_is_the_deep_sensor_in_the_third_motion(answer: Any) -> None:
    found = answer["next_experiment"]
    assert found["between"] == TIED
    assert (found["sensor"], found["motion"]) == ("hall_4", 3)
    assert found["turned"][0] == pytest.approx(-19.0, abs=1.5)
    assert found["turned"][1:] == pytest.approx([0.0, 0.0], abs=0.1)
    assert found["expected"][1] - found["expected"][0] == pytest.approx(19.0, abs=1.5)
    assert found["separation_sigma"] > 5
    assert [p["between"] for p in found["pairs"]] == [TIED[:2], TIED[::2], TIED[1:]]


@pytest.mark.whole
def test_what_the_source_gives_without_scatter_is_shown_and_not_weighed(answer: Any) -> None:
    said = [n for n in answer["notes"] if "not weighed" in n]
    assert [number for n in said for number in re.findall(r"^.*?: ([\d.]+) ", n)] == ["0.068", "43.8", "4.4"]


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        (rig(0.0996), (26.0, 0.0, -6.5)),
        (load_parameters("rig_elastic"), (26.0, 12.0, 4.9)),
        (rig(0.054, effect("chuck_compliance", stiffness_nmm_per_rad=0.256)), (26.0, 12.0, 0.0)),
        (rig(0.0996, effect("torque_gain", gain=0.54)), (26.0, 12.0, 0.0)),
    ],
)
def test_values_are_predicted_with_the_strategy_s_loop_inside(
    model: NeedleModel, expected: tuple[float, ...]
) -> None:
    data = paper()
    problem = SettledProblem(data, model, {}, data.weighed)
    assert problem.predict(model) == pytest.approx(expected, abs=0.5)


@pytest.mark.whole
def test_the_deciding_reading_decides() -> None:
    ofs = [v.of for v in paper().weighed] + [Seen(0, "back", "hall_deg", 3)]
    ofs += [Seen(0, m, "torque_nmm") for m in ("rotate", "overshoot", "back")]
    errors = {"tip_lag_deg": 2.2, "hall_deg": 2.2, "torque_nmm": 0.005}
    for truth in (
        rig(0.0996, effect("torque_gain", gain=0.54)),
        load_parameters("rig_elastic"),
    ):
        ran = SettledProblem(paper(), truth, {}, ()).run(truth)[0]
        base = {m.name: deg(m.base_angle_rad) for m in ran[1:]}
        first, second = paper().sequences
        data = dataclasses.replace(paper(), sequences=(dataclasses.replace(first, base_deg=base), second))
        found = diagnose_settled(readings(truth, data, ofs, errors), few("tissue_elasticity", "torque_gain"))
        assert found.effects == (truth.effects[0].name(),)
        assert found.ranking[0].indistinguishable_from == ()
        assert found.decisions[found.effects[0]].decision == "present"
        assert found.next_experiment is None


def test_the_recorded_base_drives_the_model(tmp_path: Path) -> None:
    text = (shipped_datasets()["reed2008"] / "settled.yaml").read_text()
    recorded = text.replace(
        "{motion: rotate, tip", "{motion: back, base_deg: 40}\n      - {motion: rotate, tip"
    )
    (tmp_path / "settled.yaml").write_text(recorded)
    data = read_settled(tmp_path)
    model = load_parameters("rig_elastic")
    runs = SettledProblem(data, model, {}, data.weighed).run(model)
    assert [m.name for m in runs[0] if abs(deg(m.base_angle_rad) - 40) < 1e-6] == ["back"]
    assert [v.of for v in data.values] == [v.of for v in paper().values]


def test_any_strategy_with_its_options_can_be_told(tmp_path: Path) -> None:
    text = (shipped_datasets()["reed2008"] / "settled.yaml").read_text()
    steps = "strategy: protocol\n    options: {steps_deg: [45, -30], dwell_s: 1}\n"
    text = (
        text.replace("strategy: reed2008\n", steps).replace("rotate", "step_1").replace("final", "step_2", 1)
    )
    (tmp_path / "settled.yaml").write_text(text)
    data = read_settled(tmp_path)
    assert data.words(data.values[1].of) == "protocol (steps_deg=45, -30, dwell_s=1), step_2: tip lag"
    runs = SettledProblem(data, load_parameters("rig_rigid"), {}, data.weighed).run(
        load_parameters("rig_rigid")
    )
    assert [round(deg(m.base_angle_rad)) for m in runs[0]] == [0, 45, -30]


@pytest.mark.whole
def test_without_zeroed_sensors_a_torque_bias_ties_as_well() -> None:
    data = dataclasses.replace(paper(), zeroed_at_rest=False)
    found = diagnose_settled(data, few("torque_bias", "torque_gain"))
    assert {found.effects[0], *found.ranking[0].indistinguishable_from} == {"torque_bias", "torque_gain"}


@pytest.mark.whole
def test_a_user_s_effect_ties_under_its_own_name(tmp_path: Path) -> None:
    source = Path(find_effects()["chuck_compliance"].__module__.replace(".", "/") + ".py").read_text()
    (tmp_path / "soft_holder.py").write_text(source.replace("class ChuckCompliance", "class SoftHolder"))
    every = find_effects([tmp_path])
    found = diagnose_settled(
        paper(), {n: every[n] for n in ("soft_holder", "chuck_compliance", "tip_friction")}
    )
    assert {found.effects[0], *found.ranking[0].indistinguishable_from} == {"soft_holder", "chuck_compliance"}
    assert known(found.ranking[0].separation_sigma) < 0.1


@pytest.mark.whole
def test_what_no_plausible_effect_meets_is_unknown_and_told() -> None:
    found = diagnose_settled(paper(), few("tip_friction", "chuck_backlash", "torque_bias"))
    assert (found.verdict, found.effects) == ("unknown", ())
    assert "final: tip lag" in found.residual_patterns.patterns[0].sentence()
    assert (
        "outside what is plausible" in next(r for r in found.ranking if r.effect == "chuck_backlash").against
    )


def test_an_effect_with_as_many_parameters_as_values_is_no_answer() -> None:
    found = diagnose_settled(paper(), few("bending_torque"))
    assert found.verdict == "unknown"
    assert "would fit anything" in found.ranking[0].against


@pytest.mark.whole
def test_nothing_hidden_is_none() -> None:
    data = paper()
    ofs = [Seen(0, m, "hall_deg", k) for m in ("rotate", "back", "final") for k in range(4)]
    found = diagnose_settled(
        readings(rig(0.09), data, ofs, {"hall_deg": 1.0}, seed=4), few("tissue_elasticity", "torque_gain")
    )
    assert (found.verdict, found.effects, found.next_experiment) == ("none", (), None)
    assert found.residual_patterns.patterns == ()


@pytest.mark.whole
def test_a_model_that_has_the_effect_needs_no_other() -> None:
    found = diagnose_settled(paper(), few("torque_gain", "tissue_elasticity"), load_parameters("rig_elastic"))
    assert found.verdict == "none"
    assert set(found.decisions) == {"torque_gain"}


def test_compare_puts_the_values_beside_the_null_model(tmp_path: Path) -> None:
    result = CliRunner().invoke(compare, ["reed2008", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert [(w["motion"], w["measured"]) for w in found["worst"]] == [("final", 12.0), ("final", 3.0)]
    assert found["worst"][0]["model"] == pytest.approx(0.0, abs=0.5)
    assert found["channels"]["torque_nmm"]["noise"] is None
    assert found["channels"]["tip_lag_deg"]["whitened"] > 3
    assert found["reduced_chi2"] > 10
    assert "not weighed" in CliRunner().invoke(compare, ["reed2008"]).stdout
    refused = CliRunner().invoke(compare, ["reed2008", "--html", str(tmp_path / "x.html")])
    assert isinstance(refused.exception, BadInput)
    assert "no traces to draw" in str(refused.exception)


def test_a_set_is_held_against_published_values_as_it_stands() -> None:
    result = CliRunner().invoke(compare, ["reed2008", "--model", "rig_rigid", "--json"])
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["held"]["error"] > found["refit"]["error"] > 2.0
    assert found["channels"] == found["held"]["channels"]
    friction, rigidity = found["parameters"]
    assert friction["model"] == pytest.approx(load_parameters("rig_rigid").values()[friction["name"]])
    assert friction["refit_uncertainty"] > 0.0
    assert rigidity["model"] == pytest.approx(62.56, rel=0.01)
    said = CliRunner().invoke(compare, ["reed2008", "--model", "rig_rigid"]).stdout
    assert "as it stands" in said
    assert "refitted" in said
    refused = CliRunner().invoke(compare, ["reed2008", "--model", "rig_rigid", "--free", friction["name"]])
    assert isinstance(refused.exception, BadInput)
    assert "leave fixed and free out" in str(refused.exception)


def test_commands_that_need_traces_say_so(tmp_path: Path) -> None:
    words = ["reed2008", "--between", "tissue_elasticity", "torque_gain", "--out", str(tmp_path / "p.yaml")]
    result = CliRunner().invoke(experiment, words)
    assert isinstance(result.exception, BadInput)
    assert "holds settled values only, too few to fit both effects" in str(result.exception)


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("motion: rotate", "motion: turn", "has no motion turn; it has rest, rotate"),
        ("strategy: reed2008\n", "strategy: reed\n", "strategy 'reed' is unknown"),
        ("{extra_deg: 12}", "{extra: 12}", "has no option 'extra'"),
        ("{extra_deg: 12}", "{}", "does not know its extra turn"),
        ("tip_lag_deg: 26}", "hall_deg: [1, 2]}", "2 angles for 4 sensors; write null for a missing one"),
        ("tip_lag_deg: 26}", "tip_lag: 26}", "unknown key; did you mean tip_lag_deg"),
        ("tip_lag_deg: 26}", "tip_lag_deg: .nan}", "is not a finite number"),
        ("motion: rotate", "motion: final", "tip_lag_deg of motion final is given twice; keep one"),
        ("{tip_lag_deg: 2.2, hall_deg: 2.2}", "{}", "no number has a standard error"),
        ("{tip_lag_deg: 2.2, hall_deg: 2.2}", "{tip_lag_deg: 0}", "is not above 0"),
        ("needle_length_mm: 397", "needle_length_mm: 300", "beyond the needle's 300 mm"),
        ("  tissue_sections_mm", "  colour: red\n  tissue_sections_mm", "unknown key; remove it"),
    ],
)
def test_what_is_wrong_with_the_file_is_a_sentence_with_its_line(
    tmp_path: Path, old: str, new: str, sentence: str
) -> None:
    text = (shipped_datasets()["reed2008"] / "settled.yaml").read_text()
    assert old in text
    (tmp_path / "settled.yaml").write_text(text.replace(old, new))
    with pytest.raises(BadInput, match=re.escape(sentence)) as refused:
        diagnose_settled(read_settled(tmp_path), {})
    assert re.search(r"settled\.yaml:\d+", str(refused.value))
