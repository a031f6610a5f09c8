"""needle-rig layout."""

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from needle_rig.cli.layout import command
from needle_rig.errors import BadInput

STEPPED = """\
needle: {torsional_rigidity_nmm2: 62.5, uncertainty_percent: 10}
needle_length_mm: 400
segments:
  - {from_mm: 0, to_mm: 100, diameter_mm: 1.2, inner_diameter_mm: 1.0, shear_modulus_gpa: 75}
  - {from_mm: 100, to_mm: 120, torsional_rigidity_nmm2: 625}
tissue_sections_mm: [[0, 100], [175, 265]]
hall_sensors:
  - {name: marker, position_mm: 150}
  - {name: tip, position_mm: 399}
"""


def run(tmp_path: Path, text: str, *options: str) -> Result:
    file = tmp_path / "shaft.yaml"
    file.write_text(text)
    return CliRunner().invoke(command, [str(file), *options])


def test_ten_lines_by_hand_are_told_and_drawn(tmp_path: Path) -> None:
    assert len(STEPPED.splitlines()) <= 10
    result = run(tmp_path, STEPPED, "--png", str(tmp_path / "shaft.png"))
    assert result.exit_code == 0, result.output
    told = result.stdout.splitlines()
    assert told[0] == "shaft: 0 to 400 mm, torsional rigidity 62.5 N·mm² ± 10 %"
    # π/32 (1.2⁴ − 1.0⁴) mm⁴ · 75 GPa = 7905 N·mm²
    assert told[1] == "segment: 0 to 100 mm, 126 times as rigid (7905 N·mm²)"
    assert told[2] == "segment: 100 to 120 mm, 10 times as rigid (625 N·mm²)"
    assert told[3:5] == ["friction along: 0 to 100 mm", "friction along: 175 to 265 mm"]
    assert told[5:] == ["marker: at 150 mm", "tip: at 399 mm"]
    assert (tmp_path / "shaft.png").read_bytes().startswith(b"\x89PNG")


def test_an_unknown_rigidity_is_said(tmp_path: Path) -> None:
    text = "needle: {torsional_rigidity_nmm2: unknown}\n" + "".join(
        line for line in STEPPED.splitlines(True) if line[0] in "th" or "name" in line or "length" in line
    )
    result = run(tmp_path, text)
    assert "torsional rigidity unknown, to be learnt" in result.stdout


@pytest.mark.parametrize(
    ("wrong", "right", "said"),
    [
        ("needle: {torsional_rigidity_nmm2: 62.5, uncertainty_percent: 10}", "needle: {diameter_mm: 0.4}",
         "shear_modulus_gpa is missing"),
        ("nmm2: 62.5,", "nmm2: 62.5, diameter_mm: 0.4,", "tell the same"),
        ("inner_diameter_mm: 1.0", "inner_diameter_mm: 1.3", "is not below the outer diameter, 1.2 mm"),
        (", torsional_rigidity_nmm2: 625}", "}", "its rigidity is not told once"),
        ("from_mm: 100, to_mm: 120", "from_mm: 90, to_mm: 120", "overlaps the one before it"),
        ("to_mm: 120", "to_mm: 420", "leaves the needle, which is 0 to 400 mm"),
        ("62.5,", "unknown,", "the needle's is unknown"),
        ("inner_diameter_mm", "bore_mm", "bore_mm"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_a_sentence_with_its_line(
    tmp_path: Path, wrong: str, right: str, said: str
) -> None:
    assert wrong in STEPPED
    result = run(tmp_path, STEPPED.replace(wrong, right))
    assert isinstance(result.exception, BadInput)
    assert "shaft.yaml" in str(result.exception)
    assert said in str(result.exception)
