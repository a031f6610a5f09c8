"""A law that no library holds, for the page: its curve, its formula, and the files that hold its effect.

The effect file is written by this program from what was learnt; no upload adds Python.
"""

from __future__ import annotations

from typing import Any

from needle_rig.numerics import Array
from needle_rig.questions.doing import Doing
from needle_rig.questions.learn import Learn
from needle_rig.web.models import finite
from needle_rig.workbench.laws.learnt import LearntLaw

Document = dict[str, Any]


def learn(question: Learn, doing: Doing, _out: str) -> Document:
    """Which law is missing: the verdict in words, and each law with its curve."""
    answer = question.answer(doing)
    found = answer.found
    return {
        "verdict": found.verdict,
        "sentence": found.sentence,
        "library": list(found.library),
        "tried": found.tried,
        "held_out_before": finite(found.held_out_before),
        "held_out_after": finite(found.held_out_after),
        "laws": [_law(law) for law in found.laws],
        "files": [file.name for file in answer.drafts],
    }


def _law(law: LearntLaw) -> Document:
    curve = law.curve
    return {
        "name": law.law.name,
        "words": law.law.words(),
        "tied_with": [other.words() for other in law.tied_with],
        "experiment": None if law.experiment is None else law.experiment["sentence"],
        "held_out_before": finite(law.held_out_before),
        "held_out_after": finite(law.held_out_after),
        "formula": law.formula,
        "parameters": [
            {"name": name, "value": finite(value), "uncertainty": finite(spread), "unit": of}
            for name, value, spread, of in law.parameters
        ],
        "unit": law.law.unit,
        "variable": law.law.variable,
        "variable_unit": law.law.variable_unit,
        "at": _numbers(curve.at),
        "value": _numbers(curve.value),
        "low": _numbers(curve.low),
        "high": _numbers(curve.high),
        "data": _numbers(curve.data),
        "halves": [_numbers(half) for half in curve.halves],
    }


def _numbers(values: Array) -> list[float | None]:
    return [finite(float(v)) for v in values]
