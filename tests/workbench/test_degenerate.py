"""Recordings of every degenerate shape end in an answer, or in a sentence that says why there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from needle_rig.cli.main import CRASHED, run
from needle_rig.numerics import lower_root
from tests.workbench.degenerate import write_dataset

QUESTIONS = (["compare"], ["identify"], ["diagnose", "--quick", "--jobs", "1"])
KNOWN = (3, 16, 36, 70, 2058, 2155, 2389, 2396)
"""Each ended in a traceback once: values of 10¹²°, no sensor, no tissue, nothing to test, no reading."""


def asked(folder: Path, question: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = run([question[0], str(folder), *question[1:]])
    out, err = capsys.readouterr()
    assert out if code == 0 else err.strip()
    return code, err


@pytest.mark.parametrize("seed", range(1000, 1060))
def test_values_are_compared_and_identified_or_refused(
    seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_dataset(tmp_path, seed)
    for question in QUESTIONS[:2]:
        code, said = asked(folder, question, capsys)
        assert code in (0, 2), said
        assert "Traceback" not in said
        assert code == 0 or len(said.splitlines()) <= 5, said


@pytest.mark.whole
@pytest.mark.parametrize("seed", KNOWN)
def test_a_diagnosis_ends_in_an_answer(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = asked(write_dataset(tmp_path, seed), QUESTIONS[2], capsys)
    assert code in (0, 2), said


@pytest.mark.slow
@pytest.mark.parametrize("first", range(2000, 2032, 8))
def test_none_of_many_ends_in_a_traceback(
    first: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ended = {}
    for seed in range(first, first + 8):
        folder = write_dataset(tmp_path / str(seed), seed)
        ended[seed] = [asked(folder, question, capsys) for question in QUESTIONS]
    assert {seed: each for seed, each in ended.items() if any(code == CRASHED for code, _ in each)} == {}


@pytest.mark.parametrize("white", [1e-3, 1e-9, 1e-15])
def test_a_root_is_real_beside_a_part_of_low_rank(white: float) -> None:
    covariance = np.full((40, 40), 1e6) + white**2 * np.eye(40)
    lower = lower_root(covariance)
    assert np.allclose(lower @ lower.T, covariance, rtol=1e-12)
    assert np.array_equal(lower, np.tril(lower))
    assert np.allclose(lower_root(np.diag([4.0, 9.0])), np.diag([2.0, 3.0]), rtol=1e-14)
