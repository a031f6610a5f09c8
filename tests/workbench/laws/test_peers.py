"""The peers of `learn`: scored as the project scores itself, each right where it can be."""

from __future__ import annotations

import json
from argparse import Namespace
from typing import Any

import numpy as np
import pytest

from campaigns.workbench import law_peers, strategies_learnt
from campaigns.workbench.peers import (
    TERMS,
    Data,
    Discrepancy,
    Sindy,
    Symbolic,
    left_out_error,
    library_features,
    of_command,
)
from tests.workbench.hidden import null_fit


@pytest.fixture(scope="module")
def data() -> Data:
    return Data(null_fit(seed=5))


class Told:
    """A peer whose readings are given."""

    name, settings = "told", ""

    def __init__(self, readings: Any) -> None:
        self._readings = readings
        self.asked: list[list[int]] = []

    def fitted(self, trials: Any) -> Any:
        self.asked.append(list(trials))
        return self

    def readings(self, trial: int) -> Any:
        return self._readings[trial]

    def says(self) -> str:
        return ""


def test_the_score_is_that_of_the_projects_cross_validation(data: Data) -> None:
    ours = data.baseline.validation
    assert data.error(ours.residuals) == pytest.approx(ours.error, rel=0.02)


def test_every_command_is_left_out_with_all_its_trials(data: Data) -> None:
    peer = Told([b.mean for b in data.binned])
    assert left_out_error(data, peer) == 0.0
    assert peer.asked == [[2, 3], [0, 1, 3, 4], [0, 1, 2, 4]]


def test_another_friction_of_the_trial_is_nobodys_error(data: Data) -> None:
    terms = data.linear.trials[0]
    moved = [np.zeros_like(b.mean) for b in data.binned]
    far = [np.zeros_like(b.mean) for b in data.binned]
    scatter = terms.random_effect_precision**-0.5
    moved[0] = np.nan_to_num(data.whiteners[0].raw(scatter * terms.random_effect))
    far[0] = 10.0 * moved[0]
    size = data.baseline.problem.size
    assert data.error(moved) * size**0.5 < 1.0
    assert data.error(far) * size**0.5 > 5.0


def test_what_a_command_tells_is_known_before_it_is_measured(data: Data) -> None:
    binned = data.binned[3]
    names, values = of_command(binned)
    known = dict(zip(names, values.T, strict=True))
    assert known["begun"][0] == 0.0
    last = int(np.flatnonzero(binned.motion == 0)[-1])
    assert known["begun"][last + 1] == pytest.approx(binned.base_rad[last])
    assert set(known["direction"]) <= {-1.0, 0.0, 1.0}


class Line:
    """Least squares on the inputs."""

    def fit(self, X: Any, y: Any) -> None:
        self.at = np.linalg.lstsq(np.column_stack([np.ones(len(X)), X]), y, rcond=None)[0]

    def predict(self, X: Any) -> Any:
        return np.column_stack([np.ones(len(X)), X]) @ self.at

    def formula(self, names: Any) -> str:
        return " + ".join(["1", *names])


def test_a_regression_has_what_it_is_said_to_have(data: Data) -> None:
    command, beside = Symbolic(data, Line, "a", ""), Symbolic(data, Line, "b", "", beside=True)
    assert command.inputs(0, 1).shape[1] == len(command.names(1)) == 6
    names = beside.names(1)
    assert beside.inputs(0, 1).shape[1] == len(names) == 6 + 4 + 4
    assert "hall_1" not in names
    fitted = beside.fitted(range(5))
    assert fitted.readings(0).shape == data.binned[0].mean.shape
    assert " = 1 + base" in fitted.says()
    assert left_out_error(data, beside) < left_out_error(data, command)


def test_the_terms_of_sindys_library_are_its_own() -> None:
    pysindy = pytest.importorskip("pysindy")
    rows = np.random.default_rng(1).standard_normal((4, 8))
    plain = pysindy.PolynomialLibrary(degree=2)
    both = plain + pysindy.FourierLibrary(n_frequencies=3)
    for library, terms in zip((pysindy.PolynomialLibrary(degree=1), plain, both), TERMS, strict=True):
        library.fit(rows)
        assert library_features(rows, terms) == pytest.approx(np.asarray(library.transform(rows)))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_sindy_and_a_discrepancy_predict_every_bin(data: Data) -> None:
    pytest.importorskip("pysindy")
    pytest.importorskip("sklearn")
    for peer in (Sindy(data), Discrepancy(data)):
        fitted = peer.fitted([0, 1, 2, 4])
        assert np.isfinite(fitted.readings(3)).all()
        assert fitted.says()
    # nothing is missing: the discrepancy does no harm
    assert left_out_error(data, Discrepancy(data)) < 1.5


def test_the_table_has_a_row_for_each_case_and_says_what_failed() -> None:
    rows: list[dict[str, Any]] = [
        {
            "case": "slit",
            "peer": law_peers.LEARN,
            "says": "law: a|b",
            "error": 1.01,
            "cpu_s": 9,
            "settings": "",
        },
        {
            "case": "slit",
            "peer": "PySINDy",
            "says": "x" * 999,
            "error": None,
            "cpu_s": 3,
            "settings": "s",
        },
        {"case": "nothing", "peer": "PySINDy", "says": "y", "error": 4.0, "cpu_s": 5, "settings": "s"},
    ]
    text = law_peers.table(json.loads(json.dumps(rows)), Namespace())
    assert "| slit: torque · section_3 · angle | 1.01 | fails |" in text
    assert "| nothing | — | 4.00 |" in text
    assert "law: a¦b" in text
    assert "(999 characters)" in text
    assert "- **PySINDy**: s" in text
    assert "stands in its stead" not in text
    assert "PyOperon stands in its stead" in law_peers.table(
        [*rows, {**rows[2], "peer": "PyOperon, from the command"}], Namespace()
    )


def test_the_strategies_table_counts_rigs_and_says_what_was_refused() -> None:
    none = {"worst_deg": [], "tip_deg": [], "gave_way": 0, "refused": "needs a model"}
    good = {"worst_deg": [1.0, 2.0], "tip_deg": [0.5, 1.0], "gave_way": 1, "refused": ""}
    worse = {"worst_deg": [4.0, 4.0], "tip_deg": [3.0, 3.0], "gave_way": 0, "refused": ""}
    row = {
        "law": "slit",
        "size": 2.0,
        "verdict": "law",
        "laws": ["torque_section_3_angle"],
        "formulas": ["sine: 1 · sin(v)"],
        "library": [],
        "adopted": ["found"],
        "before": 20.0,
        "after": None,
        "runs": dict(zip(strategies_learnt.WAYS, (worse, none, worse, good), strict=True)),
    }
    text = strategies_learnt.table([row], Namespace())
    assert "| slit × 2 | law: torque_section_3_angle (sine) | 20.00 → — | reed2008 | 3.0 (3.0) |" in text
    assert "smaller than reed2008's in 1 of 1 rigs (2.7 times in the median)" in text
    assert "than with the null model in 1 (2.7 times)" in text
    assert "| planned, null model | refused | refused | — |" in text
    assert "- refused: needs a model" in text
    row["runs"] = dict.fromkeys(strategies_learnt.WAYS, none)
    row["adopted"] = []
    assert "| refused | refused | — |" in strategies_learnt.table([row], Namespace())
