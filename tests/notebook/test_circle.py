"""`import needle_rig` for notebooks: the notebook of the docs runs, and its results show themselves."""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import needle_rig as nr
from needle_rig.errors import BadInput
from needle_rig.notebook.shown import Shown
from tests.workbench.hidden import dataset, effect

ROOT = Path(__file__).parents[2]
NOTEBOOK = ROOT / "docs/tutorial/circle.ipynb"


def shown(value: Any) -> str:
    """What a notebook shows of a cell's last value."""
    if isinstance(value, Shown):
        assert value._repr_html_().count("<table>") == 1
        assert value._repr_html_().count('src="data:image/png;base64,') == 1
        return repr(value)
    if hasattr(value, "savefig"):
        return f"figure with {len(value.axes)} axes"
    return repr(value)


def circle() -> tuple[dict[str, Any], list[str]]:
    """The names that the notebook's cells leave behind, and what each shows."""
    cells = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    names: dict[str, Any] = {}
    said = []
    for cell in cells:
        if cell["cell_type"] != "code":
            continue
        tree = ast.parse("".join(cell["source"]))
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, str(NOTEBOOK), "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), str(NOTEBOOK), "eval"), names)
            said.append(shown(value))
    return names, said


@pytest.mark.whole
def test_the_notebook_tells_the_whole_circle(tmp_path: Path) -> None:
    """One test: processes that share tests would each run the notebook."""
    names, said = circle()
    says_what_it_found(names, said)
    tables_are_structured_arrays_in_the_units_of_files(names)
    a_model_is_saved_and_read_again(names, tmp_path)


def says_what_it_found(names: dict[str, Any], said: list[str]) -> None:
    text = "\n".join(said)
    assert names["null"].held_out_error > 30.0
    assert (names["answer"].verdict, names["answer"].effects) == ("effect", ("tissue_elasticity",))
    assert "error on commands left out 0.9" in text
    planned, plain = (float(line.split("lags ")[1].split("°")[0]) for line in said if "the tip lags" in line)
    assert planned < 1.0 < 5.0 < plain
    assert text.count("figure with") == 4


def tables_are_structured_arrays_in_the_units_of_files(names: dict[str, Any]) -> None:
    values = names["answer"].values()
    assert values["low"][0] < 0.35 < values["high"][0]
    assert values["unit"][0] == "N·mm/rad per 100 mm"
    assert names["null"].table().dtype.names == ("channel", "rmse", "noise", "unit", "in_noise_units")
    assert names["model"].table()["held_out"][-1] == pytest.approx(0.975, abs=0.02)
    motions = names["planned"].table()
    assert motions["base_deg"][-1] == pytest.approx(45.0, abs=0.1)
    assert names["answer"].table()["effect"][0] == "tissue_elasticity"
    assert names["answer"].model_values == ()


def a_model_is_saved_and_read_again(names: dict[str, Any], tmp_path: Path) -> None:
    names["model"].save(tmp_path / "fitted.yaml")
    again = nr.read_model(tmp_path / "fitted.yaml")
    assert again.values.keys() == names["model"].values.keys()
    assert np.array_equal(again.table()["held_out"], names["model"].table()["held_out"])


def test_a_run_shows_itself_and_is_a_dataset(run_path: Path) -> None:
    run = nr.read_run(run_path)
    assert "reed2008" in repr(run)
    assert len(run.plot().axes) == 3
    assert len(run.table()) > 100
    assert len(run.dataset().trials) == 1


def test_what_is_not_there_is_one_sentence() -> None:
    with pytest.raises(BadInput, match="no such effect; there are"):
        nr.simulate({"phlogiston": 1.0})
    with pytest.raises(BadInput):
        nr.read_dataset("nowhere")
    with pytest.raises(AttributeError, match="no attribute 'phlogiston'"):
        _ = nr.phlogiston


def test_importing_the_package_imports_no_workbench() -> None:
    loaded = "any('workbench' in name or name == 'numpy' for name in sys.modules)"
    code = f"import sys, needle_rig; sys.exit({loaded})"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.mark.whole
def test_a_quick_diagnosis_says_what_it_left_out_and_whether_values_hold() -> None:
    hidden = dataset(effect("tissue_elasticity", stiffness_nmm_per_rad_per_100mm=0.45))
    found = nr.diagnose(hidden, "rig_rigid", quick=True, jobs=1)
    assert found.effects == ("tissue_elasticity",)
    assert "whether a second is missing" in found.notes[0]
    assert found.notes[0] in found._repr_html_()
    assert found.model_values[0].startswith("its values as they stand leave")
