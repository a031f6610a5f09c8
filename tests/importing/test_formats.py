"""Formats of other programs: read as their own libraries read them, or a sentence with the way on."""

from __future__ import annotations

import contextlib
import datetime
import json
import pickle
import random
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import cantools
import numpy as np
import pytest

from campaigns.files.import_kinds import CASES, Source, Truth
from needle_rig.cli.main import run as command
from needle_rig.dataset import read_dataset
from needle_rig.errors import BadInput
from needle_rig.importing import read_recording
from needle_rig.importing.bus_log import by_can, unpacked

ROOT = Path(__file__).parents[2]
PRACTICE = ROOT / "tests/data/practice/elastic"
PACKAGE = {
    "labview_tdms_waveforms": "nptdms",
    "asammdf_mf4": "asammdf",
    "can_asam_mf4": "asammdf",
    "polars_parquet": "polars",
    "polars_feather_dates": "polars",
    "pandas_json_lines": "polars",
    "matlab_timetable_7": "matio",
    "matlab_timetable_73": "matio",
    "matlab_timeseries_7": "matio",
    "matlab_timeseries_73": "matio",
    "simulink_dataset_7": "matio",
    "simulink_dataset_73": "matio",
}
WRITTEN_BY = {"openpyxl_text_cells": "openpyxl", "ros1_bag": "rosbags"}
"""Packages that write these kinds."""
OF_A_BUS = ("can_candump", "can_vector_asc", "can_vector_blf", "can_peak_trc", "can_python_csv")


@pytest.fixture(scope="module")
def source() -> Source:
    trial = read_dataset(PRACTICE).trials[0]
    return Source(trial.trial.time_s, trial.base_measured_rad, trial.torque_nm, trial.hall_rad)


def made(name: str, source: Source, folder: Path) -> Truth:
    if needed := (PACKAGE | WRITTEN_BY).get(name):
        pytest.importorskip(needed)
    return CASES[name](source, folder)


def a_database(seed: int) -> tuple[str, Any]:
    """A .dbc with one message of every kind of signal, at places that do not overlap."""
    draw = random.Random(seed)
    lines: list[str] = []
    at = 0
    while at < 60 and len(lines) < 6:
        length = draw.choice([1, 3, 8, 11, 16, 24, 32])
        length = min(length, 64 - at)
        little, signed = draw.random() < 0.5, draw.random() < 0.5 and length > 1
        if not little:
            at, length = 8 * ((at + 7) // 8), length
            if at + length > 64:
                break
        start = at if little else 8 * (at // 8) + 7 - at % 8
        scale, offset = draw.choice([1, 0.01, 0.5]), draw.choice([0, -40])
        lines.append(
            f" SG_ s{len(lines)} : {start}|{length}@{int(little)}{'-' if signed else '+'}"
            f' ({scale},{offset}) [0|0] "deg" X'
        )
        at += length if little else 8 * ((length + 7) // 8)
        at = 8 * ((at + 7) // 8) if little and draw.random() < 0.5 else at
    text = 'VERSION ""\n\nBU_: X\n\nBO_ 291 MOTION: 8 X\n' + "\n".join(lines) + "\n"
    return text, cantools.database.load_string(text, database_format="dbc", strict=False)


@pytest.mark.parametrize("seed", range(40))
def test_signals_are_those_of_cantools(seed: int) -> None:
    text, database = a_database(seed)
    message = database.get_message_by_name("MOTION")
    frames = np.random.default_rng(seed).integers(0, 256, (50, 8), dtype=np.uint8)
    for signal in message.signals:
        found = unpacked(frames, signal) * float(signal.scale) + float(signal.offset)
        told = [message.decode(row.tobytes(), decode_choices=False)[signal.name] for row in frames]
        assert found == pytest.approx(told, rel=1e-12), text


def test_a_float_and_what_is_multiplexed_are_those_of_cantools(tmp_path: Path) -> None:
    text = (
        'VERSION ""\n\nBU_: X\n\nBO_ 291 MOTION: 8 X\n'
        ' SG_ which M : 0|8@1+ (1,0) [0|0] "" X\n'
        ' SG_ angle m1 : 8|32@1- (1,0) [0|0] "rad" X\n'
        ' SG_ torque m2 : 8|32@1- (0.001,0) [0|0] "Nm" X\n'
        "\nSIG_VALTYPE_ 291 angle : 1;\n"
    )
    (tmp_path / "bus.dbc").write_text(text)
    database: Any = cantools.database.load_string(text, database_format="dbc")
    message = database.get_message_by_name("MOTION")
    with can.Logger(tmp_path / "run.log") as log:
        for k in range(20):
            named = {"which": 1, "angle": 0.125 * k} if k % 2 else {"which": 2, "torque": -0.004 * k}
            log(can.Message(arbitration_id=291, data=message.encode(named), timestamp=1.0 + k, channel="c"))
        log(can.Message(arbitration_id=291, data=b"\1\2", timestamp=30.0, channel="c"))
        log(can.Message(arbitration_id=0x7FF, data=b"\1\2", timestamp=31.0, channel="c"))
    found = read_recording(tmp_path / "run.log", tmp_path / "bus.dbc")
    values = {c.name: c.values for c in found.columns}
    np.testing.assert_allclose(values["MOTION.angle"][1:20:2], 0.125 * np.arange(1, 20, 2))
    np.testing.assert_allclose(values["MOTION.torque"][:20:2], -0.004 * np.arange(0, 20, 2), atol=1e-9)
    assert np.isnan(values["MOTION.angle"][:20:2]).all()
    assert np.isnan(values["MOTION.angle"][20])
    assert values["MOTION.which"][20] == 1.0
    (other,) = [c for c in found.columns if c.fault]
    assert "has no message 0x7FF" in other.fault


@pytest.mark.parametrize("name", OF_A_BUS)
def test_a_log_of_this_rigs_bus_is_read_without_naming_it(name: str, source: Source, tmp_path: Path) -> None:
    truth = made(name, source, tmp_path)
    found = read_recording(truth.files[0])
    for role, (column, unit_si, _) in truth.channels.items():
        values = next(c.values for c in found.columns if c.name == column) * unit_si
        np.testing.assert_allclose(values, source.of(role), atol=1e-5)


def test_a_database_that_is_named_is_kept_in_the_mapping(source: Source, tmp_path: Path) -> None:
    (tmp_path / "other.dbc").write_text(
        'VERSION ""\n\nBU_: X\n\nBO_ 5 MOTOR: 8 X\n SG_ MotorAngle : 0|32@1- (0.001,0) [0|0] "deg" X\n'
        ' SG_ Torque : 32|32@1- (0.00001,0) [0|0] "mNm" X\n'
    )
    database: Any = cantools.database.load_file(tmp_path / "other.dbc")
    message = database.get_message_by_name("MOTOR")
    (tmp_path / "logs").mkdir()
    with can.Logger(tmp_path / "logs/run.blf") as log:
        for time_s, base, torque in zip(source.time_s, source.base, source.torque, strict=True):
            data = message.encode({"MotorAngle": float(np.degrees(base)), "Torque": float(torque * 1e3)})
            log(can.Message(arbitration_id=5, data=data, timestamp=float(time_s) + 1e9, channel=1))
    line = ["import", str(tmp_path / "logs/run.blf"), "--layout", str(PRACTICE)]
    assert command([*line, "--guess", "--out", str(tmp_path / "ours"), "--yes"]) == 2
    one = [*line, "--guess", "--dbc", str(tmp_path / "other.dbc"), "--out", str(tmp_path / "one")]
    assert command(one) == 0
    assert command(["import", str(tmp_path / "one/import.yaml"), "--out", str(tmp_path / "two")]) == 0
    one_csv, two_csv = ((tmp_path / n / "trials/01.csv").read_bytes() for n in ("one", "two"))
    assert one_csv == two_csv


def test_frames_that_no_database_knows_are_named_with_the_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "run.log").write_text("(1.0) can0 7DF#0201\n" * 20)
    assert command(["import", str(tmp_path / "run.log"), "--guess", "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "0x7DF" in said
    assert "--dbc FILE.dbc" in said
    (tmp_path / "bus.dbc").write_text("no database")
    with pytest.raises(BadInput, match="cannot be read as a CAN database"):
        read_recording(tmp_path / "run.log", tmp_path / "bus.dbc")


@pytest.mark.parametrize("name", [*PACKAGE, *OF_A_BUS, "json_arrays", "openpyxl_text_cells", "ros1_bag"])
def test_a_damaged_file_ends_in_a_sentence(name: str, source: Source, tmp_path: Path) -> None:
    file = made(name, source, tmp_path).files[0]
    whole, draw = file.read_bytes(), random.Random(name)
    for _ in range(12):
        cut = bytearray(whole[: draw.randrange(1, len(whole))] if draw.random() < 0.5 else whole)
        for _ in range(draw.choice([0, 1, 5])):
            cut[draw.randrange(len(cut))] = draw.randrange(256)
        file.write_bytes(bytes(cut))
        with contextlib.suppress(BadInput):  # any other error is one of this program
            read_recording(file)


@pytest.mark.parametrize("name", PACKAGE)
def test_a_package_that_is_not_there_is_named_with_its_command(
    name: str, source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = made(name, source, tmp_path).files[0]
    monkeypatch.setitem(sys.modules, PACKAGE[name], None)
    with pytest.raises(BadInput, match=rf"needs the package {PACKAGE[name]}, .*pip install"):
        read_recording(file)


def test_lines_of_json_keep_what_is_inside_of_each_other(tmp_path: Path) -> None:
    pytest.importorskip("polars")
    (tmp_path / "log.jsonl").write_text(
        "".join(
            f'{{"t": {k * 0.1}, "motor": {{"deg": {k}}}, "hall": [{k}, {2 * k}], "torque": "{k}.5",'
            f' "note": "a", "gone": {k if k % 2 else "null"}}}\n'
            for k in range(30)
        )
    )
    values = {c.name: c.values for c in read_recording(tmp_path / "log.jsonl").columns}
    assert list(values) == ["t", "motor.deg", "hall[1]", "hall[2]", "torque", "note", "gone"]
    assert values["hall[2]"][29] == 58.0
    assert values["torque"][29] == 29.5
    assert np.isnan(values["gone"][0])


def test_times_of_a_frame_are_seconds(tmp_path: Path) -> None:
    polars = pytest.importorskip("polars")
    began = datetime.datetime(2024, 3, 1, 12)
    steps = [datetime.timedelta(milliseconds=20 * k) for k in range(20)]
    polars.DataFrame(
        {
            "at": [began + s for s in steps],
            "since": steps,
            "of_day": [(began + s).time() for s in steps],
            "lost": [None, *(began + s for s in steps[1:])],
        }
    ).write_parquet(tmp_path / "run.parquet")
    for column in read_recording(tmp_path / "run.parquet").columns:
        assert column.unit == "s"
        assert np.diff(column.values[1:]) == pytest.approx(0.02, abs=1e-6)
    assert np.isnan(column.values[0])


def _pickled(path: Path) -> None:
    path.write_bytes(pickle.dumps({"a": 1}))


NOT_READ: dict[str, tuple[Callable[[Path], object], str]] = {
    "run.pkl": (_pickled, "to_parquet"),
    "run.feather": (lambda p: p.write_bytes(b"FEA1" + bytes(50)), "to_feather"),
    "run.tdms_index": (lambda p: p.write_bytes(b"TDSh" + bytes(50)), "give the .tdms"),
    "run.csv.xz": (lambda p: p.write_bytes(b"\xfd7zXZ\0" + bytes(50)), "unpack it first"),
    "run.bin": (lambda p: p.write_bytes(b"\1\0\2\0" * 50), "Parquet"),
}


@pytest.mark.parametrize("name", NOT_READ)
def test_what_is_not_read_names_the_conversion(name: str, tmp_path: Path) -> None:
    write, said = NOT_READ[name]
    write(tmp_path / name)
    with pytest.raises(BadInput, match=said):
        read_recording(tmp_path / name)


def test_names_again_in_the_middle_are_a_second_table(tmp_path: Path) -> None:
    part = "time_s,base_deg\n" + "".join(f"{k * 0.1:.1f},{k}\n" for k in range(40))
    (tmp_path / "log.csv").write_text(part + part)
    with pytest.raises(BadInput, match=r"log\.csv:42: a second table begins here"):
        read_recording(tmp_path / "log.csv")


def test_text_cells_beside_numbers_are_numbers_and_those_of_two_readings_are_not(tmp_path: Path) -> None:
    openpyxl = pytest.importorskip("openpyxl")
    pytest.importorskip("python_calamine")
    book = openpyxl.Workbook()
    book.active.append(["time", "base [deg]", "torque [mNm]", "count", "who"])
    for k in range(40):
        told = f"1.{234 + k}" if k % 2 else "7"
        book.active.append([k * 0.1, f"{k},25", f"1.234,{k:02d}", told, "ann"])
    book.save(tmp_path / "run.xlsx")
    found = {c.name: c for c in read_recording(tmp_path / "run.xlsx").columns}
    assert found["base [deg]"].values[3] == 3.25
    assert found["torque [mNm]"].values[3] == 1234.03
    assert found["count"].labels or found["count"].fault
    assert found["who"].labels == ("ann",)


def test_a_tdms_file_that_is_cut_off_keeps_the_rows_that_all_channels_have(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    channels = [("base", np.arange(100.0)), ("torque", np.arange(100.0) / 7)]
    with nptdms.TdmsWriter(tmp_path / "run.tdms") as writer:
        for _ in range(2):
            writer.write_segment(
                [
                    nptdms.ChannelObject("log", name, values, {"wf_increment": 0.01})
                    for name, values in channels
                ]
            )
    whole = (tmp_path / "run.tdms").read_bytes()
    (tmp_path / "run.tdms").write_bytes(whole[:-400])
    found = {c.name: c.values for c in read_recording(tmp_path / "run.tdms").columns}
    assert {len(values) for values in found.values()} == {150}
    assert found["torque"][149] == 49 / 7
    (tmp_path / "run.tdms").write_bytes(whole[: len(whole) // 2 - 800])
    with pytest.raises(BadInput, match="is cut off: torque has 0 of 100 samples"):
        read_recording(tmp_path / "run.tdms")


def test_what_a_damaged_mf4_loses_is_told(source: Source, tmp_path: Path) -> None:
    """The block of the torque, the third of the chain: its kind, its link to the next one, and its size."""
    file = made("asammdf_mf4", source, tmp_path).files[0]
    whole = file.read_bytes()
    blocks = [at for at in range(0, len(whole), 8) if whole.startswith(b"##CN", at)]
    torque = next(at for at in blocks if int.from_bytes(whole[at + 24 + 64 + 4 :][:4], "little") == 16)
    too_long = b"\0\0\x10\0\0\0\xff\xff\xff"  # a whole number at byte 16, of 2²⁴ bits
    after = {"holds words": (90, b"\x07"), "belong to no channel": (24, bytes(8)), "": (90, too_long)}
    for told, (at, value) in after.items():
        damaged = bytearray(whole)
        damaged[torque + at : torque + at + len(value)] = value
        file.write_bytes(damaged)
        if told:
            faults = [c.fault for c in read_recording(file).columns if c.fault]
            assert any(told in fault for fault in faults), faults
            continue
        with pytest.raises(BadInput, match="Torque reaches beyond the 56 bytes of a row"):
            read_recording(file)


@pytest.mark.parametrize(("version", "mark", "first"), [("4.10", b"##DG", 24), ("3.30", b"HD", 4)])
def test_a_group_of_an_mdf_that_no_link_reaches_is_told(
    version: str, mark: bytes, first: int, tmp_path: Path
) -> None:
    pytest.importorskip("can")
    asammdf = pytest.importorskip("asammdf")
    time_s = np.arange(200) * 0.01
    with asammdf.MDF(version=version) as mdf:
        for name in ("angle", "torque"):
            mdf.append([asammdf.Signal(np.sin(time_s), time_s, name=name, unit="deg")])
        file = Path(mdf.save(tmp_path / f"run.m{'f4' if version[0] == '4' else 'df'}"))
    assert not any(c.fault for c in read_recording(file).columns)
    whole = bytearray(file.read_bytes())
    at = whole.find(mark) + first
    if mark == b"HD":  # its first link is to the data group, whose first one is to the next
        at = int.from_bytes(whole[at : at + 4], "little") + 4
    whole[at : at + 4] = bytes(4)
    file.write_bytes(whole)
    told = {c.name: c.fault for c in read_recording(file).columns}
    assert "angle" in told
    assert "torque" not in told
    assert sum("no link leads to it" in fault for fault in told.values()) == 1, told


@pytest.mark.parametrize("name", ["matlab_timeseries_7", "matlab_timeseries_73", "simulink_dataset_73"])
def test_objects_of_matlab_have_units_and_one_clock(name: str, source: Source, tmp_path: Path) -> None:
    found = read_recording(made(name, source, tmp_path).files[0])
    columns = {c.name: c for c in found.columns}
    assert {c.table for c in found.columns} == {columns["motor"].table}
    assert columns["torque"].unit == "N*mm"
    np.testing.assert_allclose(columns["Time"].values, source.time_s, atol=1e-9)
    np.testing.assert_allclose(columns["torque"].values, source.torque * 1e3, atol=1e-6)


@pytest.mark.parametrize(
    "line", ["t:{0},angle:{1}", "angle: {1} t: {0}", "12:34:5{2}.000 -> t:{0}\tangle:{1}"]
)
def test_lines_of_a_serial_plotter_are_columns(line: str, tmp_path: Path) -> None:
    rows = [line.format(k, 0.5 * k, k % 10) for k in range(10)]
    (tmp_path / "run.txt").write_text("\n".join(["Ready", *rows, "t:10,ang"]))
    columns = {c.name: c.values for c in read_recording(tmp_path / "run.txt").columns}
    np.testing.assert_array_equal(columns["t"], np.arange(10.0))
    np.testing.assert_array_equal(columns["angle"], 0.5 * np.arange(10.0))
    if "->" in line:
        np.testing.assert_array_equal(np.diff(columns["recorded at"]), np.ones(9))
    (tmp_path / "run.txt").write_text("\n".join([*rows, "overrun", *rows, ""]))
    with pytest.raises(BadInput, match=r"run\.txt:11: 'overrun' is not label:value"):
        read_recording(tmp_path / "run.txt")


@pytest.mark.parametrize(
    "late", ['{"t": 1, "angle": 0.5, "torque": 2}', '{"t": 1.5}', '{"t": 1, "angle": 7}']
)
def test_json_lines_keep_what_their_first_lines_lack(late: str, tmp_path: Path) -> None:
    pytest.importorskip("polars")
    lines = ['{"t": 1, "angle": 0.5}' if "torque" in late else '{"t": 1, "angle": 3}'] * 300
    (tmp_path / "run.jsonl").write_text("\n".join([*lines, late, ""]))
    columns = {c.name: c.values for c in read_recording(tmp_path / "run.jsonl").columns}
    for name, value in json.loads(late).items():
        assert columns[name][-1] == value


def test_a_bus_in_an_mf4_is_read_by_a_process_that_did_not_write_it(source: Source, tmp_path: Path) -> None:
    file = made("can_asam_mf4", source, tmp_path).files[0]
    line = (
        "from pathlib import Path; from needle_rig.importing import read_recording;"
        f" print(read_recording(Path({str(file)!r})).dialect)"
    )
    done = subprocess.run([sys.executable, "-c", line], capture_output=True, text=True, check=False)
    assert done.stdout.strip().endswith("decoded by needle_rig.dbc"), done.stderr


def test_a_log_that_ends_within_a_frame_ends_before_it(tmp_path: Path) -> None:
    frame = " {}.000000 1  111             Rx   d 8 {}\n"
    rows = [frame.format(1, "E6 33 FF 00 00 00 00 00"), frame.format(2, "E6 33 F")]
    (tmp_path / "run.asc").write_text(
        "date Fri Mar 01 13:03:11.000 2024\nbase hex  timestamps absolute\ninternal events logged\n"
        "Begin Triggerblock Fri Mar 01 13:03:11.0 2024\n 0.000000 Start of measurement\n"
        + "".join(rows).rstrip("\n"),
        encoding="utf-8",
    )
    (read,) = by_can("ASCReader")(tmp_path / "run.asc")
    assert read.data.hex() == "e633ff0000000000"


def test_a_classic_frame_that_says_more_than_eight_bytes_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    import can

    sent = can.Message(arbitration_id=0x111, data=bytes(8), is_extended_id=False)
    sent.dlc = 15
    monkeypatch.setattr(can, "BLFReader", lambda _: contextlib.nullcontext([sent]))
    assert [found.data for found in by_can("BLFReader")(Path("run.blf"))] == [bytes(8)]


@pytest.mark.parametrize("damage", ["no properties", "no numbers"])
def test_a_signal_of_matlab_that_cannot_be_read_is_told(
    damage: str, source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    matio = pytest.importorskip("matio")
    file = made("simulink_dataset_73", source, tmp_path).files[0]
    content = matio.load_from_mat(str(file), add_table_attrs=True)
    logged = content["out"].reshape(-1)[0]["logsout"]
    last = logged.properties["Storage_"].properties["Elements"].reshape(-1)[-1].properties["Values"]
    if damage == "no properties":
        last.properties = ()
    else:
        last.properties["Data_"] = np.empty((0, 1))
    monkeypatch.setattr(matio, "load_from_mat", lambda *_, **__: content)
    faults = {c.name: c.fault for c in read_recording(file).columns if c.fault}
    assert list(faults) == ["hall_4"]
    assert "no numbers that can be read" in faults["hall_4"]


def test_a_panic_of_the_library_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    polars = pytest.importorskip("polars")
    polars.DataFrame({"t": [0.0, 1.0]}).write_parquet(tmp_path / "run.parquet")

    def panics(_: Path) -> None:
        raise polars.exceptions.PanicException("assertion failed")

    monkeypatch.setattr(polars, "read_parquet", panics)
    with pytest.raises(BadInput, match="cannot be read as Parquet: assertion failed"):
        read_recording(tmp_path / "run.parquet")
