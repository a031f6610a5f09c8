"""What a newcomer typed, and what it prints now: commands and Python, with the test that holds each.

scripts/evidence face python -m campaigns face      writes docs/evidence/face.md

Every line is asked in one folder, in this order. Exit code 1 when one prints something else than is meant.
"""

from __future__ import annotations

import contextlib
import io
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import needle_rig as nr
from campaigns import ROOT
from needle_rig.cli.main import run
from needle_rig.errors import NeedleRigError

MOST_LETTERS = 210
"""Of what a line prints, in the table."""
SHIPPED = ROOT / "config/rig.yaml"
LOG = "Time [ms];Encoder [counts];Mz [mNm];H1 [deg];H2 [deg]"
SHAFT = """\
needle: {diameter_mm: 0.39, shear_modulus_gpa: 27.2}
needle_length_mm: 397
tissue_sections_mm: [[175, 200], [240, 265]]
hall_sensors: [{name: hall_1, position_mm: 220}, {name: tip, position_mm: 396}]
"""
HELD, CLI, OWN = "workbench/learning/test_held.py", "unit/cli/test_shape.py", "unit/test_own_things.py"
ASKING, DATA, CONFIG = "notebook/test_asking.py", "notebook/test_data.py", "unit/test_config.py"
RIG = f"{CONFIG}::test_a_mistake_is_answered_with_place_and_hint"
TRIAL = "dataset/test_dataset.py::test_what_a_trial_says_and_nobody_reads_is_said"


@dataclass(frozen=True)
class Line:
    """One line, what it is to print (a pattern of one printed line), and what holds it in the tests."""

    about: str
    typed: str
    prints: str
    test: str


LINES = tuple(Line(*row) for row in (
    ("a model wrong by a factor of two", "needle-rig compare data/other --model fitted.yaml", r"model's values contradict these data .*stiffness_nmm_per_rad_per_100mm is off by \d{3}", f"{HELD}::test_a_wrong_value_is_told_with_its_size_and_its_distance"),
    ("… by diagnose", "needle-rig diagnose data/other --model fitted.yaml --quick", r"its values as they stand leave 1\d\.\d+ × the noise", f"{HELD}::test_a_diagnosis_says_whether_values_fail_before_it_speaks_of_the_structure"),
    ("… by identify", "needle-rig identify data/other --update fitted.yaml", r"contradicts fitted \(p < 1e-09", "workbench/learning/test_identify.py::test_a_run_that_contradicts_a_model_file_is_refused"),
    ("… before the needle turns with it", "", "", "workbench/learning/test_last_run.py::test_the_command_warns_before_it_turns_the_needle"),
    ("values held", "needle-rig compare data/mine --fixed torsional_rigidity_nmm2=65", r"torsional_rigidity_nmm2 = 65.*", f"{HELD}::test_the_null_models_constants_may_be_fixed_one_by_one"),
    ("pictures in a notebook", 'nr.compare(data).plot("loop")._repr_png_()[1:4]', "PNG", "notebook/test_notebooks.py::test_each_result_and_figure_of_the_circle_shows_a_picture"),
    ("completion", "sorted(set(dir(nr)) - set(dir(object)))", "'compare', 'diagnose'.*'fit'.*'strategies'", f"{ASKING}::test_every_name_is_there_and_completes"),
    ("a CSV by the base install", "needle-rig import log.csv --guess --layout shaft.yaml --out lab", r"columns: 4 used, 1 asked", "unit/test_extras.py::test_a_base_installation_reads_a_csv"),
    ("printed install commands", "", "", "unit/test_extras.py::test_pip_takes_the_printed_command"),
    ("a strategy of one's own", "needle-rig compensate --target 45 --fast --no-picture --strategy my_lag", r"run: +runs/.*my_lag", f"{OWN}::test_a_strategy_of_ones_own_is_found_and_read_again_when_edited"),
    ("… by its file", "needle-rig compensate --target 45 --fast --strategy ./my_lag.py", r"one of your own is a file config/strategies/my_lag\.py", f"{CLI}::test_a_file_for_a_strategy_gets_its_home"),
    ("tables of a run", 'nr.read_run("last.h5").table("events")[0]', "rest", f"{DATA}::test_tables_of_a_run_are_frames_in_degrees_and_nmm"),
    ("no folder to keep compiled code", "", "", "physics/test_kernel_cache.py::test_where_no_folder_can_be_written_it_compiles_and_says_so_once"),
    ("the trial that is drawn", 'nr.compare(data).plot("traces").get_suptitle()', "4 of 8 trials, those of the worst places first; 4 left out", f"{HELD}::test_the_trial_with_the_worst_place_is_drawn_first_and_those_left_out_are_counted"),
    ("columns that divide", "needle-rig compare data/mine", r"hall_1 +5\.41 ° +0\.1078 ° +50\.2", f"{HELD}::test_error_and_noise_of_each_column_divide_to_its_ratio"),
    ("the ladder's floor", "needle-rig history fitted.yaml --png ladder.png", r"wrote ladder\.png", f"{HELD}::test_each_error_of_the_ladder_has_a_floor_of_its_kind"),
    ("± and units", "needle-rig compare data/mine", r"fitted: friction_nmm_per_100mm = 0\.078\d+ ± 0\.000\d+ N·mm per 100 mm", f"{HELD}::test_a_value_has_the_digits_of_its_uncertainty"),
    ("a fit in Python", 'nr.fit(data, effects=["tissue_elasticity"]).params["torsional_rigidity_nmm2"]', r"62\.5\d+", "notebook/test_fit.py::test_what_was_hidden_lies_in_its_interval"),
    ("a dataset", "data, len(data), data[0]", r"mine: 8 trials, 10381 samples, 8, 01: kind compensate", f"{DATA}::test_a_dataset_is_a_short_sequence_of_trials"),
    ("steps and a bar in Python", "", "", "questions/test_steps.py::test_a_notebook_tells_each_step_in_a_line"),
    ("errors that speak Python", 'nr.adopt(answer, "tip_friktion")', r"BadInput: .*tip_friktion is not in it; it has tissue_elasticity", f"{ASKING}::test_a_wrong_argument_is_one_sentence_in_python_s_words"),
    ("… a list", 'nr.simulate(["tissue_elasticity"])', r'BadInput: effects is of type list; name values, as in \{"tissue_elasticity": 0.35\}', f"{ASKING}::test_a_wrong_argument_is_one_sentence_in_python_s_words"),
    ("… a field", 'nr.simulate({"tissue_elasticity": {"stifness": 0.35}})', r"BadInput: tissue_elasticity has no stifness", f"{ASKING}::test_a_wrong_argument_is_one_sentence_in_python_s_words"),
    ("an empty table", "nr.diagnose(data, model, quick=True).values().dtype.names", r"'effect', 'parameter', 'value'", f"{DATA}::test_a_table_without_rows_has_its_columns"),
    ("types", "", "", f"{ASKING}::test_mypy_accepts_what_the_docs_write_without_a_cast"),
    ("a command mistyped", "needle-rig diagnoze data/mine", r"Did you mean diagnose\?", f"{CLI}::test_an_unknown_command_gets_the_nearest"),
    ("groups", "needle-rig --help", r"Data and models:", f"{CLI}::test_every_command_stands_in_one_group_with_a_line_that_fits"),
    ("one meaning an option", "needle-rig compare data/mine --pictures x.png", r"--pictures x\.png: is the name of a picture; name a folder", f"{CLI}::test_an_option_means_the_same_everywhere"),
    ("… a file", "needle-rig history fitted.yaml --png picdir", r"--png picdir: names no kind of picture", f"{CLI}::test_a_picture_is_a_file_with_an_ending_and_pictures_a_folder"),
    ("a bar of a step", "", "", "workbench/test_parallel.py::test_progress_is_shown_on_a_terminal_alone"),
    ("a pipe", "", "", "unit/cli/test_command_line.py::test_a_pipe_gets_whole_lines"),
    ("an order out of range", "needle-rig compensate --target 4500 --fast", r"target_deg: 4500\.0 is above 3600; give 3600 at most", f"{CLI}::test_an_order_out_of_range_gets_its_limit"),
    ("a parameter set as model", "needle-rig compare data/mine --model rig_elastic", r"mine against the model rig_elastic, its values as they stand", f"{HELD}::test_the_command_takes_a_file_or_a_set_and_prints_both_columns"),
    ("a broken effect", "needle-rig effects", r"config/effects/broken\.py:1: '\(' was never closed; correct the file or move it away", f"{OWN}::test_effects_lists_the_others_and_then_the_broken_one"),
    ("completion in a shell", "", "", f"{CLI}::test_a_shell_completes_names"),
    ("the tutorial", "", "", "workbench/learning/test_tutorial.py::test_every_command_prints_what_the_page_shows"),
    ("swapped files", "needle-rig compare data/mine --model data/mine/dataset.yaml", r"this is a dataset .*name its folder as DATA", RIG),
    ("a decimal comma", "needle-rig simulate --effect tissue_elasticity=0,35 --out data/no", r"a comma separates entries here; write 0\.35", "effects/test_library.py::test_what_cannot_be_understood_on_a_command_line"),
    ("a column of another unit than its values", "", "", "dataset/test_dataset.py::test_a_column_whose_name_says_another_unit_than_its_values_have"),
    ("a field of another unit than its name", "", "", "effects/test_library.py::test_a_broken_file_is_named_with_its_line"),
    ("data on which no value depends", "", "", "workbench/test_degenerate.py::test_values_are_compared_and_identified_or_refused"),
    ("Ctrl-C, and typed again", "", "", "workbench/test_answers.py::test_a_command_that_is_stopped_three_times_says_what_one_says_that_is_not"),
))  # fmt: skip
MISTAKES: tuple[tuple[str | Path, tuple[str, str], str, str, str], ...] = (
    # what is edited, how, the line, what it prints, its test
    (SHIPPED, ("rigidity_nmm2: 62.56", "rigidity_nmm2: 6.256"), "layout", r"6\.256 N·mm² is 0\.1 times the 61\.8", RIG),
    (SHIPPED, ("needle-rig/1", "needle-rig/2"), "layout", r"format 2; needle-rig \S+ reads up to 1", RIG),
    (SHIPPED, ("  shear", "   shear"), "layout", r"indented by 3 spaces, more than the line above", RIG),
    (SHIPPED, ("simulated rig", "lab: rig 3"), "layout", r'needs quotes; write name: "lab: rig 3"', RIG),
    (SHIPPED, ("parameters: rig_elastic", "parameters: rig_elastik"), "layout", r"there is no parameter set rig_elastik; did you mean rig_elastic\?", f"{CONFIG}::test_a_needle_that_is_not_there_is_told_when_the_file_is_read"),
    ("fitted.yaml", ("uncertainty: 0.0006", "uncertanty: 0.0006"), "compare data/mine --model", r"unknown key; did you mean uncertainty\?", "effects/test_model_files.py::test_a_wrong_key_of_a_fitted_value_is_told_once"),
    ("fitted.yaml", ("unit: N·mm²", "unit: N·m²"), "compare data/mine --model", r"N·m² is not the unit of torsional_rigidity_nmm2", "effects/test_model_files.py::test_a_unit_beside_a_value_is_no_decoration"),
    ("fitted.yaml", ("value: 62.", "value: 62,"), "compare data/mine --model", r"a comma separates entries here; write 62\.", RIG),
    ("data/mine/dataset.yaml", ("kind: staircase", "kind: stairs"), "compare", r"did you mean staircase\?", TRIAL),
    ("data/mine/dataset.yaml", ("target_deg: 90.0", "target_rad: 1.57"), "compare", r"did you mean target_deg: 89\.95", TRIAL),
)  # fmt: skip


def mistakes(folder: Path) -> Iterator[Line]:
    """Writes each mistaken file, and yields the line that reads it."""
    for k, (place, (old, new), command, prints, test) in enumerate(MISTAKES):
        good = folder / place
        if dataset := good.name == "dataset.yaml":
            file = folder / f"mistake_{k}"
            shutil.copytree(good.parent, file)
        text = good.read_text(encoding="utf-8")
        assert old in text, old
        edited = file / good.name if dataset else folder / f"mistake_{k}.yaml"
        edited.write_text(text.replace(old, new, 1), encoding="utf-8")
        shown = file.name if dataset else edited.name
        yield Line(f"a file with `{new}` for `{old}`", f"needle-rig {command} {shown}", prints, test)


def prepared(folder: Path) -> dict[str, Any]:
    """Data, models and files that the lines name, in the working folder; the names that Python knows."""
    for words in (
        "simulate --parameters rig_rigid --effect tissue_elasticity=0.35 --seed 1 --out data/mine",
        "diagnose data/mine --quick --out diagnosis.yaml",
        "adopt diagnosis.yaml data/mine --out fitted.yaml",
        "simulate --effect tissue_elasticity=0.70 --seed 3 --out data/other",
        "compensate --target 45 --fast --no-picture --json --out runs",
    ):
        assert run(shlex.split(words)) == 0, words
    (last,) = (folder / "runs").glob("*.h5")
    shutil.copy(last, folder / "last.h5")
    for kind, name, text in (
        ("strategies", "my_lag", (ROOT / "needle_rig/control/strategies/single_lag.py").read_text("utf-8")),
        ("effects", "broken", "syntax ("),
    ):
        (folder / "config" / kind).mkdir(parents=True)
        (folder / "config" / kind / f"{name}.py").write_text(text, encoding="utf-8")
    data = nr.read_dataset("data/mine")
    frame = data[0].table()
    rows = zip(
        *(frame[name] for name in ("time_s", "base_deg", "torque_nmm", "hall_1_deg", "hall_4_deg")),
        strict=True,
    )
    told = "\n".join(
        ";".join(f"{value:.6f}".replace(".", ",") for value in (1e3 * time_s, 11.38 * base, torque, *halls))
        for time_s, base, torque, *halls in rows
    )
    (folder / "log.csv").write_text(f"{LOG}\n{told}\n", encoding="utf-8")
    (folder / "shaft.yaml").write_text(SHAFT, encoding="utf-8")
    return {
        "nr": nr,
        "data": data,
        "model": nr.read_model("fitted.yaml"),
        "answer": nr.diagnose(data, quick=True),
    }


def printed(line: Line, names: dict[str, Any]) -> list[str]:
    """What one line prints, on stdout and stderr; what Python raises, as its last line."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        if line.typed.startswith("needle-rig "):
            run(shlex.split(line.typed.removeprefix("needle-rig ")))
        else:
            try:
                print(eval(line.typed, names))
            except NeedleRigError as error:
                print(f"{type(error).__name__}: {error}")
    return out.getvalue().splitlines()


def table() -> tuple[str, int]:
    """The table, and how many lines print something else than is meant."""
    rows, wrong = ["| about | typed | prints | test |", "|---|---|---|---|"], 0
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        folder = Path(place)
        with contextlib.redirect_stdout(io.StringIO()):
            names = prepared(folder)
        for line in (*LINES, *mistakes(folder)):
            said = ""
            if line.typed:
                told = printed(line, names)
                said = next((each.strip() for each in told if re.search(line.prints, each)), "")
                wrong += not said
                said = said.replace(f"{place}/", "") or f"**not {line.prints}**"
            said = said if len(said) < MOST_LETTERS else f"{said[:MOST_LETTERS]}…"
            typed = f"`{line.typed}`" if line.typed else ""
            rows.append(
                f"| {line.about} | {typed} | {said.replace('|', '¦')} | `{line.test.split('::')[1]}` |"
            )
    return "\n".join(rows), wrong


def main() -> int:
    text, wrong = table()
    print(f"{text}\n\n{len(LINES) + len(MISTAKES)} lines, {wrong} print something else than is meant.")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
