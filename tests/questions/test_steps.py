"""Steps are told while a question is worked, with their number where it is known."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from functools import cache

import pytest

import needle_rig as nr
from needle_rig.dataset import Dataset
from needle_rig.dataset.settled import SettledData
from needle_rig.notebook.asking import step
from needle_rig.questions.compare import Compare
from needle_rig.questions.doing import Doing
from needle_rig.questions.fit import Fit
from needle_rig.questions.identify import Identify
from tests.workbench.hidden import PROTOCOL


@cache
def data() -> Dataset | SettledData:
    return nr.simulate({"tissue_elasticity": 0.35}, protocol=PROTOCOL, name="mine", rate_hz=20.0).given


@pytest.mark.parametrize(
    ("question", "steps"),
    [
        (lambda: Compare(data=data()), 2),
        (lambda: Compare(data=data(), model="rig_elastic"), 3),
        (lambda: Compare(data=data(), model="rig_elastic", refit=True), 2),
        (lambda: Fit(data=data()), 2),
        (lambda: Fit(data=data(), added=("tissue_elasticity", "torque_bias")), 5),
        (lambda: Identify(data=data()), 3),
        (lambda: Identify(data=data(), model="rig_elastic", update=True), 3),
    ],
)
def test_each_step_is_told_once_with_its_number(
    question: Callable[[], Compare | Fit | Identify], steps: int
) -> None:
    said: list[str] = []
    question().answer(Doing(say=said.append))
    numbers = [re.search(r"\((\d) of (\d)\)$", text) for text in said]
    assert [found and (int(found[1]), int(found[2])) for found in numbers] == [
        (k, steps) for k in range(1, steps + 1)
    ]


def test_a_notebook_tells_each_step_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    step("fitting")
    assert capsys.readouterr() == ("", "")
    monkeypatch.setitem(sys.modules, "ipykernel", sys)
    step("fitting")
    assert capsys.readouterr() == ("fitting …\n", "")
