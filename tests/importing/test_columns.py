"""Every column of a recording is used, asked, or not used with its reason; what is written wins."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset
from needle_rig.dataset.description import RigPart, read_description
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, dataset_of, guess, read_recording, signals
from needle_rig.importing.became import became
from needle_rig.importing.mapping import NO_REASON, read_mapping, write_mapping
from needle_rig.importing.unit_text import NAMED, unit_of

ROOT = Path(__file__).parents[2]
PRACTICE = ROOT / "tests/data/practice/elastic"
NAMES = ("time_s", "motor_deg", "torque_nmm", "hall_1_deg", "hall_2_deg", "hall_3_deg", "hall_4_deg")


@pytest.fixture(scope="module")
def rig() -> RigPart:
    return read_description(PRACTICE)[0].rig


@pytest.fixture(scope="module")
def table() -> np.ndarray:
    """Time s, base °, torque N·mm, four angles °: a trial of another code's needle."""
    trial = read_dataset(PRACTICE).trials[0]
    angles = np.degrees(np.column_stack((trial.base_measured_rad, trial.hall_rad)))
    return np.column_stack((trial.trial.time_s, angles[:, 0], trial.torque_nm * 1e3, angles[:, 1:]))


def saved(path: Path, names: Sequence[str], rows: Sequence[Sequence[str]], delimiter: str = ",") -> Path:
    text = io.StringIO()
    writer = csv.writer(text, delimiter=delimiter, lineterminator="\n")
    writer.writerows([names, *rows])
    path.write_text(text.getvalue(), encoding="utf-8")
    return path


def cells(table: np.ndarray, form: str = "{:.6f}") -> list[list[str]]:
    return [[form.format(v) if np.isfinite(v) else "" for v in row] for row in table]


def guessed(path: Path, rig: RigPart | None) -> Mapping:
    return guess([read_recording(path)], "mine", rig, Path())


def units(mapping: Mapping) -> dict[str, str | None]:
    return {c.role: c.unit for c in mapping.channels}


WORDS = some.sampled_from(
    (
        "Motor",
        "Hall 1",
        "Hall 2",
        "Torque",
        "Time",
        "Trial",
        "AS5048",
        "x",
        "Setpoint",
        "Speed",
        "Note",
        "Tip torque",
    )
)
UNITS = some.sampled_from(
    ("", " (deg)", " (º)", " (N·mm)", " (cNm)", " (furlong)", " (blah)", " (counts)", " [ms]", " [s]", " (A)")
)
KINDS = some.sampled_from(
    ("time", "base", "hall", "torque", "constant", "empty", "words", "many words", "clock", "sparse")
)


def made(kind: str, table: np.ndarray) -> list[str]:
    n = len(table)
    if kind in ("constant", "empty", "words", "many words", "clock"):
        told = {"constant": "1.5", "empty": ""}
        return [
            told.get(kind) or ("" if kind == "empty" else ["up", "down"][k % 2] if kind == "words"
            else f"w{k}x" if kind == "many words" else f"14:{k // 60 % 60:02d}:{k % 60:02d}.25 PM")
            for k in range(n)
        ]  # fmt: skip
    column = {"time": 0, "base": 1, "torque": 2, "hall": 3, "sparse": 4}[kind]
    return [f"{v:.5f}" if kind != "sparse" or k % 3 == 0 else "" for k, v in enumerate(table[:, column])]


@pytest.mark.whole
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(some.lists(some.tuples(WORDS, UNITS, KINDS), min_size=1, max_size=7))
def test_every_column_ends_in_one_place(
    tmp_path_factory: pytest.TempPathFactory,
    rig: RigPart,
    table: np.ndarray,
    columns: list[tuple[str, str, str]],
) -> None:
    names = [f"{word}{unit}" for word, unit, _ in columns]
    path = tmp_path_factory.mktemp("t") / "log.csv"
    saved(path, names, list(zip(*(made(kind, table[::4]) for *_, kind in columns), strict=True)))
    try:
        recording = read_recording(path)
        mapping = guess([recording], "mine", rig, Path())
    except BadInput:
        return  # a sentence: the tests of degenerate recordings look at it
    assert len(recording.columns) == len(columns)
    ends = became(mapping)
    assert sorted(end.source for end in ends) == sorted(column.name for column in recording.columns)
    assert all(end.told for end in ends)


@pytest.mark.parametrize(
    ("delimiter", "form", "swap"),
    [(";", "{:,.6f}", str.maketrans(",.", ".,")), (",", "{:,.6f}", {}),
     (";", "{:,.6f}", str.maketrans(",.", " ,")),
     (";", "{:,.6f}", str.maketrans(",.", "\u202f,")), ("\t", "{:,.6f}", str.maketrans(",", "'"))],
)  # fmt: skip
def test_thousands_apart_are_numbers(
    delimiter: str, form: str, swap: dict[int, str], tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    small = table.copy()
    small[:, 2] *= 1e6
    names = [*NAMES[:2], "torque (nNm)", *NAMES[3:]]
    rows = [[cell.translate(swap) for cell in row] for row in cells(small, form)]
    mapping = guessed(saved(tmp_path / "log.csv", names, rows, delimiter), rig)
    assert mapping.doubts() == []
    assert mapping.not_used == ()
    torque = dataset_of(mapping, Path()).trials[0].torque_nm
    assert np.ptp(torque) == pytest.approx(1e-3 * np.ptp(table[:, 2]), rel=1e-6)


def test_thousands_that_may_be_decimals_are_not_read(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    rows = cells(table)
    for k, row in enumerate(rows):
        row[2] = f"{800 + k:,}".replace(",", ".")
    mapping = guessed(saved(tmp_path / "log.csv", NAMES, rows), rig)
    (left,) = mapping.not_used
    assert left.source == "torque_nmm"
    assert "may be 1000 or have three decimals" in left.why


@pytest.mark.parametrize("begin", [350.0, 160.0])
def test_angles_that_wrap_are_unwrapped_before_a_torque_is_judged(
    begin: float, tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    plain = guessed(saved(tmp_path / "plain.csv", NAMES, cells(table)), rig)
    turned = table.copy()
    low = 0.0 if begin == 350.0 else -180.0
    place = [1, 3, 4, 5, 6]
    turned[:, place] = (turned[:, place] + begin - low) % 360.0 + low
    assert np.abs(np.diff(turned[:, 1])).max() > 300.0
    mapping = guessed(saved(tmp_path / "turned.csv", NAMES, cells(turned)), rig)
    assert mapping.doubts() == []
    assert units(mapping) == units(plain)
    assert [c.sign for c in mapping.channels] == [c.sign for c in plain.channels]


def test_an_average_over_a_wrap_is_no_half_turn(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    time_s = np.arange(0.0, table[-1, 0], 0.001)
    fine = np.column_stack([time_s, *(np.interp(time_s, table[:, 0], c) for c in table.T[1:])])
    fine[:, [1, 3, 4, 5, 6]] = (fine[:, [1, 3, 4, 5, 6]] + 350.0) % 360.0
    mapping = guessed(saved(tmp_path / "log.csv", NAMES, cells(fine)), rig)
    trial = dataset_of(mapping.model_copy(update={"rate_hz": 50.0}), Path()).trials[0]
    known = trial.base_measured_rad[np.isfinite(trial.base_measured_rad)]
    assert math.degrees(np.ptp(known)) == pytest.approx(np.ptp(table[:, 1]), rel=0.02)


@pytest.mark.parametrize("turn", [1.0, 2 * math.pi, 360.0, 4096.0, 16384.0])
def test_a_turn_is_found_where_no_unit_says_it(turn: float) -> None:
    way = np.linspace(0.7, 2.4, 500) * turn
    back = signals.without_wraps(way % turn, None)
    assert back - back[0] == pytest.approx(way - way[0])
    far = np.concatenate((way, way[::-1]))
    assert np.array_equal(signals.without_wraps(far, 360.0 if turn == 360.0 else turn), far)


def test_a_column_without_name_that_leads_the_sensors_is_asked_as_the_base(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    raw = np.delete(table, 2, axis=1)
    raw[:, 1] = np.round(raw[:, 1] * 16384 / 360 + 900)
    path = saved(tmp_path / "log.csv", ["time_ms", "AS5048 raw", *NAMES[3:]], cells(raw))
    mapping = guessed(path, rig)
    base = mapping.channels[0]
    assert base.role == "base_angle"
    assert "AS5048 raw" in (base.source if base.unit is None else base.doubt)
    assert base.doubt


@pytest.mark.parametrize("unit", ["cNm", "in-lbs", "ft-lb", "oz·in"])
def test_a_torque_in_a_unit_of_workshops_is_read(
    unit: str, tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    size = unit_of(unit)
    assert size is not None
    told = table.copy()
    told[:, 2] *= 1e-3 / size.si
    mapping = guessed(
        saved(tmp_path / "log.csv", [*NAMES[:2], f"Torque ({unit})", *NAMES[3:]], cells(told, "{:.9f}")), rig
    )
    assert mapping.doubts() == []
    assert np.ptp(dataset_of(mapping, Path()).trials[0].torque_nm) == pytest.approx(
        1e-3 * np.ptp(table[:, 2]), rel=1e-3
    )


def test_a_unit_that_nobody_knows_is_asked_by_its_name(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    names = ["time_s", "Motor (wobble)", "Torque (zonk)", *NAMES[3:]]
    mapping = guessed(saved(tmp_path / "log.csv", names, cells(table)), rig)
    assert units(mapping)["base_angle"] is None
    assert units(mapping)["base_torque"] is None
    doubts = " ".join(mapping.doubts())
    assert "'wobble' is not known" in doubts
    assert "'zonk' is not known" in doubts


def test_a_sensor_of_the_layout_that_does_not_follow_is_asked(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    wild = table.copy()
    wild[300, 5] = 1e20
    mapping = guessed(saved(tmp_path / "log.csv", NAMES, cells(wild)), rig)
    assert "hall_3" in [c.role for c in mapping.channels if c.doubt]


def test_topics_side_by_side_are_as_one_table(tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    rows = []
    for row in table:
        for k, column in enumerate((1, 2, 3)):
            cell = [f"{row[0] + 0.003 * k:.6f}", *[""] * 6]
            for place in range(3, 7) if column == 3 else (column,):
                cell[place] = f"{row[place]:.6f}"
            rows.append(cell)
    mapping = guessed(saved(tmp_path / "log.csv", NAMES, rows), rig)
    plain = guessed(saved(tmp_path / "plain.csv", NAMES, cells(table)), rig)
    assert mapping.doubts() == []
    assert [(c.role, c.unit, c.sign) for c in mapping.channels] == [
        (c.role, c.unit, c.sign) for c in plain.channels
    ]
    trial = dataset_of(mapping, Path()).trials[0]
    assert np.isfinite(trial.torque_nm).mean() > 0.95


@pytest.mark.parametrize(
    "stamp",
    [
        "03/01/2024 {h}:59:{s:09.6f} AM",
        "{h}:59:{s:09.6f} AM",
        "2024-03-01T{h}:59:{s:09.6f}Z",
        "01.03.2024 {h}:59:{s:09.6f}",
    ],
)
def test_times_of_day_are_a_clock(stamp: str, tmp_path: Path, rig: RigPart, table: np.ndarray) -> None:
    rows = cells(table)
    for k, row in enumerate(rows):
        row[0] = stamp.format(h=11, s=table[k, 0] % 60.0)
    path = saved(tmp_path / "log.csv", ["Timestamp", *NAMES[1:]], rows)
    (column, *_) = read_recording(path).columns
    assert np.diff(column.values)[:50] == pytest.approx(np.diff(table[:, 0])[:50], abs=2e-6)
    assert guessed(path, rig).clocks["log"].source == "Timestamp"


def test_a_clock_goes_on_after_midnight(tmp_path: Path) -> None:
    rows = [
        [f"{23 if k < 30 else 0:02d}:{59 if k < 30 else 0:02d}:{(30 + k) % 60:02d}", f"{k}"]
        for k in range(60)
    ]
    column = read_recording(saved(tmp_path / "log.csv", ["clock", "x"], rows)).columns[0]
    assert np.array_equal(np.diff(column.values), np.ones(59))


def test_lines_of_a_serial_monitor_have_the_time_of_their_arrival(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    lines = ["Ready", ",".join(["ms", *NAMES[1:]])]
    for row in cells(table):
        seconds = float(row[0])
        lines.append(f"14:{int(seconds // 60):02d}:{seconds % 60:06.3f} -> {','.join(row)}")
    (tmp_path / "log.txt").write_text("\n".join(lines) + "\n")
    recording = read_recording(tmp_path / "log.txt")
    assert [c.name for c in recording.columns] == ["recorded at", "ms", *NAMES[1:]]
    assert units(guess([recording], "mine", rig, Path()))["base_angle"] == "deg"


@settings(deadline=None)
@given(
    some.sampled_from([text for texts in NAMED.values() for text in texts]),
    some.sampled_from(("{}", "[{}]", " ({}) ")),
)
def test_a_unit_is_called_the_same_when_it_is_read_again(text: str, form: str) -> None:
    unit = unit_of(form.format(text))
    assert unit is not None
    assert unit.text == text
    assert unit_of(unit.text) == unit


SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "no motion": lambda t: np.column_stack((t[:, 0], np.zeros((len(t), 6)))),
    "all equal": lambda t: np.ones_like(t),
    "two rows": lambda t: t[:2],
    "one row": lambda t: t[:1],
    "nine rows": lambda t: t[:9],
    "one channel": lambda t: t[:, :1],
    "time and base": lambda t: t[:, :2],
    "a tip that stands": lambda t: np.column_stack((t[:, :6], np.zeros(len(t)))),
    "all sensors stand": lambda t: np.column_stack((t[:, :3], np.zeros((len(t), 4)))),
    "base stands": lambda t: np.column_stack((t[:, :1], 0 * t[:, 1], t[:, 2:])),
    "no number": lambda t: np.full_like(t, np.nan),
    "huge": lambda t: np.column_stack((t[:, 0], t[:, 1:] * 1e30)),
    "one time": lambda t: np.column_stack((np.ones(len(t)), t[:, 1:])),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("more", [[], ["--yes"]])
def test_a_degenerate_recording_ends_in_a_sentence(
    shape: str, more: list[str], tmp_path: Path, table: np.ndarray, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = SHAPES[shape](table)
    path = saved(tmp_path / "log.csv", NAMES[: rows.shape[1]], cells(rows))
    line = ["import", str(path), "--guess", "--layout", str(PRACTICE), "--out", str(tmp_path / "out"), *more]
    end = command(line)
    said = capsys.readouterr()
    assert end in (0, 2), said
    assert "Traceback" not in said.err
    assert len(said.err) > 20


def test_a_mapping_that_names_what_it_leaves_aside_without_a_reason_is_still_read(
    tmp_path: Path, rig: RigPart, table: np.ndarray
) -> None:
    mapping = guessed(saved(tmp_path / "a.csv", NAMES, cells(table)), rig)
    path = tmp_path / "old.yaml"
    write_mapping(mapping, path, Path())
    path.write_text(path.read_text() + "not_used: [spare, Temperature]\n")
    read = read_mapping(path)[0]
    assert [(n.source, n.why) for n in read.not_used] == [("spare", NO_REASON), ("Temperature", NO_REASON)]
    write_mapping(read, path, tmp_path)
    assert read_mapping(path)[0].not_used == read.not_used
