"""The notebooks of the docs, executed: their pictures show."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import needle_rig as nr
from tests.notebook.notebooks import ROOT, executed, pictures

CIRCLE = ROOT / "docs/tutorial/circle.ipynb"
FIT = ROOT / "docs/tutorial/fit.md"
MOST_LINES = 40


def fit_blocks() -> list[str]:
    return re.findall(r"```python\n(.*?)```", FIT.read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.slow
def test_each_result_and_figure_of_the_circle_shows_a_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cells = [
        "".join(c["source"]) for c in json.loads(CIRCLE.read_text())["cells"] if c["cell_type"] == "code"
    ]
    for cell, shown in zip(cells, executed(cells, tmp_path, monkeypatch), strict=True):
        last = cell.splitlines()[-1]
        expected = last in ("null", "answer", "model", "planned") or last.startswith(("nr.", "null.plot"))
        expected = expected or last.endswith(".plot()")
        assert pictures(shown) == int(expected), cell


@pytest.mark.slow
def test_the_tutorial_s_fit_runs_in_a_fresh_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cells = fit_blocks()
    shown = executed(cells, tmp_path, monkeypatch)
    assert sum(map(pictures, shown)) == 1 + 4 + 2
    assert (tmp_path / "fitted.yaml").is_file()


@pytest.mark.whole
def test_the_tutorial_s_fit_is_short_and_each_of_its_lines_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pandas")
    blocks = fit_blocks()
    assert 20 < sum(len(block.splitlines()) for block in blocks) <= MOST_LINES
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block.replace("seed=", "rate_hz=20.0, seed="), str(FIT), "exec"), names)
    fit = names["fit"]
    assert names["low"] < 0.35 < names["high"]
    assert fit.redchi == pytest.approx(1.0, abs=0.1)
    assert names["held"].redchi > 3.0
    assert set(names["residuals"]["unit"]) == {"N·mm", "°"}


@pytest.mark.slow
def test_a_figure_shows_itself_in_a_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trial = 'nr.simulate({"tissue_elasticity": 0.35}, rate_hz=20.0)[0]'
    asked = [f"import needle_rig as nr\nfigure = {trial}.plot()", "figure.show(); 1", "figure"]
    assert [pictures(shown) for shown in executed(asked, tmp_path, monkeypatch)] == [0, 1, 1]


def test_a_figure_says_what_to_do_where_it_cannot_be_shown() -> None:
    figure = nr.simulate({"tissue_elasticity": 0.35}, rate_hz=20.0)[0].plot()
    with pytest.raises(nr.BadInput, match=r'write it to a file: figure\.savefig\("figure\.png"\)'):
        figure.show()
