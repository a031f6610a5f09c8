"""Rows of text: what must not slip through where whole chunks are read at once."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from needle_rig.errors import BadInput
from needle_rig.importing import read_recording, text_rows
from needle_rig.importing.recording import Column


def columns(path: Path, *rows: str, head: str = "note,time_s,base_deg") -> dict[str, Column]:
    path.write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return {column.name: column for column in read_recording(path).columns}


PLAIN = [f"run,{k},{k / 2}" for k in range(8)]


def test_a_delimiter_in_quotes_does_not_stand_for_a_lost_field(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"log\.csv:10: 2 fields where the table has 3; complete or remove"):
        columns(tmp_path / "log.csv", *PLAIN, '"a,b",8')


def test_words_in_quotes_with_a_delimiter(tmp_path: Path) -> None:
    found = columns(tmp_path / "log.csv", *PLAIN, '"a,b",8,4')
    assert found["note"].labels == ("run", "a,b")
    assert found["base_deg"].values[-1] == 4.0


def test_numbers_in_quotes(tmp_path: Path) -> None:
    found = columns(tmp_path / "log.csv", *(f'"run","{k}","{k / 2}"' for k in range(8)))
    assert found["time_s"].values.tolist() == list(range(8))


def test_chunks_are_one_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(text_rows, "CHUNK_BYTES", 20)
    rows = [*PLAIN, *[""] * 30, "stop,8,", "stop,9,4.5"]
    found = columns(tmp_path / "log.csv", *rows)
    assert found["time_s"].values.tolist() == list(range(10))
    assert math.isnan(found["base_deg"].values[8])
    assert found["note"].values.tolist() == [0.0] * 8 + [1.0, 1.0]
    with pytest.raises(BadInput, match=r"log\.csv:41: base_deg: 'off' is no number"):
        columns(tmp_path / "log.csv", *rows[:-1], "stop,9,off", *PLAIN)


@pytest.mark.parametrize(
    ("written", "seconds"),
    [
        ("2026-03-01 00:00:{:02d}.25", 1772323200.25),
        ("01.03.2026 00:00:{:02d},25", 1772323200.25),
        ("2026-03-01T00:00:{:02d}.250000000Z", 1772323200.25),
        ("12/31/2025 23:00:{:02d}", 1767222000.0),
        ("31/12/2025 23:00:{:02d}", 1767222000.0),
        ("9:00:{:02d}.5", 32400.5),
    ],
)
def test_dates_and_times_are_seconds(written: str, seconds: float, tmp_path: Path) -> None:
    rows = [f"{written.format(k)};{k}" for k in range(8)]
    found = columns(tmp_path / "log.csv", *rows, head="when;base_deg")["when"]
    assert found.unit == "s"
    np.testing.assert_allclose(found.values, seconds + np.arange(8), rtol=0, atol=1e-6)


def test_a_thirteenth_month_is_no_date(tmp_path: Path) -> None:
    rows = [f"2026-13-01 00:00:{k:02d};{k}" for k in range(8)]
    assert columns(tmp_path / "log.csv", *rows, head="when;base_deg")["when"].labels
