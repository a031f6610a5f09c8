"""Recordings in twenty formats and their dialects, written by other people's writers, with the truth
of each.

Every case turns one recording (time, base, torque, four angles; SI) into files as laboratories keep them, and
says which column is what, in which unit and with which sign.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from campaigns import ROOT

DEG = np.pi / 180
FACTORS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "deg": DEG, "rad": 1.0, "turn": 2 * np.pi,
           "nm": 1.0, "nmm": 1e-3, "ncm": 1e-2, "unm": 1e-6}  # fmt: skip
ROLES = ("base_angle", "base_torque", "hall_1", "hall_2", "hall_3", "hall_4")


@dataclass(frozen=True)
class Source:
    """One recording in SI; `hall` is (samples, 4)."""

    time_s: np.ndarray
    base: np.ndarray
    torque: np.ndarray
    hall: np.ndarray

    def of(self, role: str) -> np.ndarray:
        if role == "base_angle":
            return self.base
        return self.torque if role == "base_torque" else self.hall[:, int(role[-1]) - 1]


@dataclass(frozen=True)
class Truth:
    """What is in the files: by role the column, its unit in SI and its sign; the clock's step in seconds."""

    files: tuple[Path, ...]
    channels: dict[str, tuple[str, float, int]]
    step_s: float
    askable: bool = False
    """What only a person knows is missing: the guess must ask, and cannot be right."""
    offset_s: dict[str, float] = field(default_factory=dict)
    places: tuple[int, ...] = ()
    """Column of each role in the file, where they do not follow the time in the order of `channels`."""

    def place(self, role: str) -> int:
        """Column of a role in the file, the first is 0."""
        k = list(self.channels).index(role)
        return self.places[k] if self.places else k + 1


@dataclass(frozen=True)
class Columns:
    """Columns to write: names as in the file, values in the file's units, and what they are."""

    names: tuple[str, ...]
    values: np.ndarray
    channels: dict[str, tuple[str, float, int]]
    step_s: float

    def truth(self, file: Path) -> Truth:
        return Truth((file,), self.channels, self.step_s)


def _frame(rows: Columns) -> Any:
    """The rows as a pandas table."""
    import pandas

    return pandas.DataFrame(rows.values, columns=list(rows.names))


def _records(rows: Columns) -> Any:
    """The rows as a structured array, one field a column."""
    table = np.empty(len(rows.values), dtype=[(name, "f8") for name in rows.names])
    for name, values in zip(rows.names, rows.values.T, strict=True):
        table[name] = values
    return table


def columns(
    source: Source, names: Sequence[str], units: Sequence[str], signs: Sequence[int] = (), decimals: int = 6
) -> Columns:
    """Time, base, torque and as many angles as there are names, in `units`, with `signs` (+1 by default)."""
    signs = tuple(signs) or (1,) * (len(names) - 1)
    values = [source.time_s / FACTORS[units[0]]]
    channels = {}
    for name, unit, sign, role in zip(names[1:], units[1:], signs, ROLES, strict=False):
        values.append(sign * source.of(role) / FACTORS[unit])
        channels[role] = (name, FACTORS[unit], sign)
    table = np.column_stack(values)
    table = np.round(table, decimals)
    return Columns(tuple(names), table, channels, float(np.median(np.diff(source.time_s))))


Make = Callable[[Source, Path], Truth]
CASES: dict[str, Make] = {}


def case(function: Make) -> Make:
    CASES[function.__name__] = function
    return function


def text(
    path: Path, rows: Columns, delimiter: str = ",", comma: bool = False, above: Sequence[str] = (),
    encoding: str = "utf-8", names: bool = True, end: str = "\n", digits: str = "%.6f", after: str = "",
) -> Truth:  # fmt: skip
    """Written row by row, as data loggers do."""
    lines = [*above]
    if names:
        lines.append(delimiter.join(rows.names) + after)
    for row in rows.values:
        cells = delimiter.join("" if np.isnan(v) else digits % v for v in row)
        lines.append((cells.replace(".", ",") if comma else cells) + after)
    path.write_bytes((end.join(lines) + end).encode(encoding))
    return rows.truth(path)


PLAIN = (
    "time_s",
    "base_angle_deg",
    "base_torque_nmm",
    "hall_1_deg",
    "hall_2_deg",
    "hall_3_deg",
    "hall_4_deg",
)
PLAIN_UNITS = ("s", "deg", "nmm", "deg", "deg", "deg", "deg")


@case
def pandas_csv(source: Source, folder: Path) -> Truth:

    rows = columns(source, PLAIN, PLAIN_UNITS)
    _frame(rows).to_csv(folder / "log.csv", index=False)
    return rows.truth(folder / "log.csv")


@case
def pandas_csv_with_index(source: Source, folder: Path) -> Truth:

    names = (
        "Time [s]",
        "Motor angle [deg]",
        "Torque [N·mm]",
        "Hall 1 [deg]",
        "Hall 2 [deg]",
        "Hall 3 [deg]",
        "Hall 4 [deg]",
    )
    rows = columns(source, names, PLAIN_UNITS)
    _frame(rows).to_csv(folder / "log.csv")
    return rows.truth(folder / "log.csv")


@case
def pandas_gzip_dates(source: Source, folder: Path) -> Truth:
    import pandas

    rows = columns(
        source, ("timestamp", "encoder_deg", "Mz_mNm", "h1_deg", "h2_deg", "h3_deg", "h4_deg"), PLAIN_UNITS
    )
    frame = _frame(rows)
    frame["timestamp"] = pandas.Timestamp("2024-03-01 12:00:00") + pandas.to_timedelta(
        frame["timestamp"], unit="s"
    )
    frame.to_csv(folder / "log.csv.gz", index=False, date_format="%Y-%m-%d %H:%M:%S.%f")
    return rows.truth(folder / "log.csv.gz")


@case
def german_excel_csv(source: Source, folder: Path) -> Truth:
    names = (
        "Zeit",
        "Antrieb Winkel",
        "Drehmoment",
        "Spitze Winkel 1",
        "Spitze Winkel 2",
        "Spitze Winkel 3",
        "Spitze Winkel 4",
    )
    rows = columns(source, names, PLAIN_UNITS)
    head = [";".join(names), "s;°;mNm;°;°;°;°"]
    return text(
        folder / "Messung.csv", rows, ";", comma=True, above=head, encoding="cp1252", names=False, end="\r\n"
    )


@case
def utf16_tabs(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("t (ms)", "theta_base (°)", "Mz (N·mm)", "theta_1 (°)", "theta_2 (°)", "theta_3 (°)", "theta_4 (°)"),
                   ("ms", *PLAIN_UNITS[1:]))  # fmt: skip
    return text(folder / "log.txt", rows, "\t", comma=True, encoding="utf-16")


@case
def unit_row_in_brackets(source: Source, folder: Path) -> Truth:
    names = ("Time", "Base", "Torque", "S1", "S2", "S3", "S4")
    rows = columns(source, names, ("s", "rad", "nm", "rad", "rad", "rad", "rad"), decimals=9)
    head = ["\t".join(names), "(s)\t(rad)\t(N·m)\t(rad)\t(rad)\t(rad)\t(rad)"]
    return text(folder / "log.tsv", rows, "\t", above=head, names=False, digits="%.9f")


@case
def numpy_savetxt(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        ("time", "q_base", "tau", "q_1", "q_2", "q_3", "q_4"),
        ("s", "rad", "nmm", "rad", "rad", "rad", "rad"),
    )
    path = folder / "log.txt"
    np.savetxt(path, rows.values, header=" ".join(rows.names))
    return rows.truth(path)


@case
def spaces_aligned(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        ("Time[s]", "Motor[deg]", "Torque[Nmm]", "Hall1[deg]", "Hall2[deg]", "Hall3[deg]", "Hall4[deg]"),
        PLAIN_UNITS,
    )
    path = folder / "log.dat"
    lines = ["".join(f"{n:>16}" for n in rows.names)]
    lines += ["".join(f"{v:16.6f}" for v in row) for row in rows.values]
    path.write_text("\n".join(lines) + "\n")
    return rows.truth(path)


@case
def falling_torque(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("Time (s)", "q1 (deg)", "Mz (N.mm)", "q2 (deg)", "q3 (deg)", "q4 (deg)", "q5 (deg)"), PLAIN_UNITS,
                   (1, -1, -1, -1, -1, -1))  # fmt: skip
    return text(folder / "run1.csv", rows)


@case
def bare_names(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("t", "q1", "Mz", "q2", "q3", "q4", "q5"), PLAIN_UNITS)
    return text(folder / "run1.csv", rows)


@case
def commands_beside(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("time_ms", "motor_angle_deg", "torque_Nmm", "tip_1_deg", "tip_2_deg", "tip_3_deg", "tip_4_deg"),
                   ("ms", *PLAIN_UNITS[1:]))  # fmt: skip
    speed = np.gradient(rows.values[:, 1], source.time_s)
    more = np.column_stack(
        (np.round(rows.values[:, 1]), speed, 0.2 + 0.01 * speed, 22.0 + 0 * speed + 0.01 * source.time_s)
    )
    names = (*rows.names, "motor_target_deg", "motor_speed_deg_s", "motor_current_A", "temperature_C")
    return text(
        folder / "run1.csv", Columns(names, np.column_stack((rows.values, more)), rows.channels, rows.step_s)
    )


@case
def quotes_and_gaps(source: Source, folder: Path) -> Truth:
    names = (
        '"Time, s"',
        '"Base angle, deg"',
        '"Base torque, N-mm"',
        '"Sensor 1, deg"',
        '"Sensor 2, deg"',
        '"Sensor 3, deg"',
        '"Sensor 4, deg"',
    )
    plain = tuple(n.strip('"') for n in names)
    rows = columns(source, plain, PLAIN_UNITS)
    rows.values[100:110, 4] = np.nan
    path = folder / "log.csv"
    with path.open("w") as file:
        file.write(",".join(names) + "\n")
        for row in rows.values:
            file.write(",".join("NaN" if np.isnan(v) else f"{v:.5f}" for v in row) + "\n")
    return rows.truth(path)


@case
def no_time_but_rate(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        ("Time", "Base [deg]", "Torque [mNm]", "H1 [deg]", "H2 [deg]", "H3 [deg]", "H4 [deg]"),
        PLAIN_UNITS,
    )
    bare = Columns(rows.names[1:], rows.values[:, 1:], rows.channels, rows.step_s)
    return text(
        folder / "log.csv", bare, above=["# Operator: K", f"# Sampling rate: {1 / rows.step_s:g} Hz", "#"]
    )


@case
def micros_of_a_microcontroller(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        ("micros", "enc_deg", "torque_mNm", "hall0_deg", "hall1_deg", "hall2_deg", "hall3_deg"),
        ("us", *PLAIN_UNITS[1:]),
    )
    rows.values[:, 0] += 8_123_456
    return text(
        folder / "serial.log",
        Columns(("time_us", *rows.names[1:]), rows.values, rows.channels, rows.step_s),
        digits="%.5f",
    )


@case
def clock_of_the_day(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        (
            "Time",
            "Angle Motor (deg)",
            "Torque (Nmm)",
            "Angle 1 (deg)",
            "Angle 2 (deg)",
            "Angle 3 (deg)",
            "Angle 4 (deg)",
        ),
        PLAIN_UNITS,
    )
    lines = [";".join(rows.names)]
    for row in rows.values:
        s = row[0] + 60
        lines.append(f"12:{int(s // 60):02d}:{s % 60:09.6f};" + ";".join(f"{v:.5f}" for v in row[1:]))
    (folder / "log.csv").write_text("\n".join(lines) + "\n")
    return rows.truth(folder / "log.csv")


def _lvm(source: Source, folder: Path, decimal: str, x_column: bool) -> Truth:
    names = ("X_Value", "Motor Angle", "Torque", "Hall 1", "Hall 2", "Hall 3", "Hall 4")
    rows = columns(source, names, PLAIN_UNITS)
    step = rows.step_s
    head = f"""LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
Multi_Headings\tNo
X_Columns\t{"One" if x_column else "No"}
Time_Pref\tAbsolute
Operator\tlab
Date\t2024/03/01
Time\t14:03:11.1234
***End_of_Header***\t
\t
Channels\t6\t\t\t\t\t\t
Samples\t{len(rows.values)}\t{len(rows.values)}\t{len(rows.values)}\t{len(rows.values)}\t{len(rows.values)}\t{len(rows.values)}\t
Date\t2024/03/01\t2024/03/01\t2024/03/01\t2024/03/01\t2024/03/01\t2024/03/01\t
Time\t14:03:11.1234\t14:03:11.1234\t14:03:11.1234\t14:03:11.1234\t14:03:11.1234\t14:03:11.1234\t
Y_Unit_Label\tDeg\tmN·m\tDeg\tDeg\tDeg\tDeg\t
X_Dimension\tTime\tTime\tTime\tTime\tTime\tTime\t
X0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t0.0000000000000000E+0\t
Delta_X\t{step:.6f}\t{step:.6f}\t{step:.6f}\t{step:.6f}\t{step:.6f}\t{step:.6f}\t
***End_of_Header***\t\t\t\t\t\t\t""".replace("0.", f"0{decimal}")
    lines = [*head.split("\n"), "\t".join((*names, "Comment"))]
    for row in rows.values:
        cells = [f"{v:.6f}".replace(".", decimal) for v in row]
        lines.append("\t".join(cells if x_column else ["", *cells[1:]]) + "\t")
    (folder / "meas.lvm").write_bytes("\r\n".join(lines).encode())
    return rows.truth(folder / "meas.lvm")


@case
def labview_lvm(source: Source, folder: Path) -> Truth:
    return _lvm(source, folder, ".", True)


@case
def labview_lvm_comma(source: Source, folder: Path) -> Truth:
    return _lvm(source, folder, ",", True)


@case
def labview_lvm_without_x(source: Source, folder: Path) -> Truth:
    return _lvm(source, folder, ".", False)


@case
def dasylab_ascii(source: Source, folder: Path) -> Truth:
    names = (
        "Measurement time[hh:mm:ss]",
        "Drive angle [°]",
        "Torque [Nmm]",
        "Hall 1 [°]",
        "Hall 2 [°]",
        "Hall 3 [°]",
        "Hall 4 [°]",
    )
    rows = columns(source, names, PLAIN_UNITS)
    lines = ["DASYLab - V 11.00.00", "Worksheet name: rig", "Recording date: 01.03.2024, 14:03:11", "Block length: 1",
             f"Delta: {rows.step_s:g} sec", "Number of channels: 6", ";".join(names)]  # fmt: skip
    for row in rows.values:
        s = row[0]
        lines.append(
            f"14:{3 + int(s // 60):02d}:{s % 60:06.3f};".replace(".", ",")
            + ";".join(f"{v:.5f}" for v in row[1:]).replace(".", ",")
        )
    (folder / "rig.asc").write_bytes("\r\n".join(lines).encode("cp1252"))
    return rows.truth(folder / "rig.asc")


@case
def catman_ascii(source: Source, folder: Path) -> Truth:
    names = (
        "Time  1 - default sample rate",
        "Angle drive",
        "Torque cell",
        "Angle 1",
        "Angle 2",
        "Angle 3",
        "Angle 4",
    )
    rows = columns(source, names, PLAIN_UNITS)
    head = ["HBM_CATMAN_DATAFILE_40", "DATAFILE FROM CATMAN", "Comment:\tseries 3", "NUMBER OF CHANNELS:\t7", "MAXLENGTH OF CHANNELS:\t900",
            "\t".join(names), "\t".join(("s", "deg", "mNm", "deg", "deg", "deg", "deg")),
            "\t".join(("CHANNELLENGTH=900",) * 7)]  # fmt: skip
    return text(folder / "catman.asc", rows, "\t", above=head, names=False, end="\r\n", encoding="cp1252")


@case
def ni_daqexpress(source: Source, folder: Path) -> Truth:
    names = (
        "Time (s)",
        "Dev1/ctr0 encoder (deg)",
        "Dev1/ai0 torque (N·m)",
        "Dev1/ai1 hall (deg)",
        "Dev1/ai2 hall (deg)",
        "Dev1/ai3 hall (deg)",
        "Dev1/ai4 hall (deg)",
    )
    rows = columns(source, names, ("s", "deg", "nm", "deg", "deg", "deg", "deg"), decimals=9)
    head = [
        "Start Time,2024-03-01 14:03:11",
        f"Sample Rate (Hz),{1 / rows.step_s:g}",
        "Number of Samples,900",
        "",
    ]
    return text(folder / "daq.csv", rows, above=head, digits="%.9f")


@case
def dewesoft_txt(source: Source, folder: Path) -> Truth:
    names = ("Time (s)", "Encoder (°)", "Torque (Nm)", "H1 (°)", "H2 (°)", "H3 (°)", "H4 (°)")
    rows = columns(source, names, ("s", "deg", "nm", "deg", "deg", "deg", "deg"), decimals=9)
    head = [
        "File name: rig_0001.dxd",
        "Start time: 01/03/2024 14:03:11.123",
        f"Sample rate: {1 / rows.step_s:g}",
        "Data description",
        "",
    ]
    return text(folder / "dewesoft.txt", rows, "\t", above=head, digits="%.9f")


@case
def openpyxl_unit_row(source: Source, folder: Path) -> Truth:
    import openpyxl

    rows = columns(source, ("Time", "Motor", "Torque", "Hall 1", "Hall 2", "Hall 3", "Hall 4"), PLAIN_UNITS)
    book = openpyxl.Workbook()
    sheet = book.active
    sheet.append(["Series 3, needle 0.39 mm"])
    sheet.append([])
    sheet.append(list(rows.names))
    sheet.append(["s", "deg", "N·mm", "deg", "deg", "deg", "deg"])
    for row in rows.values:
        sheet.append([float(v) for v in row])
    book.save(folder / "series.xlsx")
    return rows.truth(folder / "series.xlsx")


@case
def pandas_xlsx(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("time [ms]", "theta0 [rad]", "Mz [Nmm]", "theta1 [rad]", "theta2 [rad]", "theta3 [rad]", "theta4 [rad]"),
                   ("ms", "rad", "nmm", "rad", "rad", "rad", "rad"))  # fmt: skip
    _frame(rows).to_excel(folder / "series.xlsx", index=False)
    return rows.truth(folder / "series.xlsx")


@case
def openpyxl_second_sheet(source: Source, folder: Path) -> Truth:
    import openpyxl

    rows = columns(source, PLAIN, PLAIN_UNITS)
    book = openpyxl.Workbook()
    book.active.title = "Notes"
    book.active.append(["Needle", "nitinol"])
    book.active.append(["Diameter", 0.39])
    sheet = book.create_sheet("Data")
    sheet.append(list(rows.names))
    for row in rows.values:
        sheet.append([float(v) for v in row])
    book.save(folder / "series.xlsx")
    return rows.truth(folder / "series.xlsx")


@case
def scipy_mat(source: Source, folder: Path) -> Truth:
    import scipy.io

    rows = columns(
        source,
        ("t", "q_base", "Mz", "q_1", "q_2", "q_3", "q_4"),
        ("s", "rad", "nmm", "rad", "rad", "rad", "rad"),
    )
    scipy.io.savemat(folder / "run.mat", dict(zip(rows.names, rows.values.T[:, :, None], strict=True)))
    return rows.truth(folder / "run.mat")


@case
def scipy_mat_struct_with_units(source: Source, folder: Path) -> Truth:
    import scipy.io

    names = ("time", "motor", "torque", "hall_1", "hall_2", "hall_3", "hall_4")
    rows = columns(source, names, PLAIN_UNITS)
    units = dict(zip(names, ("s", "deg", "Nmm", "deg", "deg", "deg", "deg"), strict=True))
    scipy.io.savemat(
        folder / "run.mat",
        {"log": {**dict(zip(names, rows.values.T, strict=True)), "units": units}, "operator": "lab"},
        do_compression=True,
    )
    return rows.truth(folder / "run.mat")


@case
def simulink_structure_with_time(source: Source, folder: Path) -> Truth:
    import scipy.io

    rows = columns(
        source,
        ("time", "base_angle_deg", "torque_Nmm", "angle_1_deg", "angle_2_deg", "angle_3_deg", "angle_4_deg"),
        PLAIN_UNITS,
    )
    signals = np.zeros(6, dtype=[("values", object), ("dimensions", object), ("label", object)])
    for k, name in enumerate(rows.names[1:]):
        signals[k] = (rows.values[:, k + 1][:, None], 1.0, name)
    scipy.io.savemat(
        folder / "sim.mat", {"out": {"time": rows.values[:, 0], "signals": signals, "blockName": "rig/Scope"}}
    )
    channels = {role: (f"signals/{name}/values", f, s) for role, (name, f, s) in rows.channels.items()}
    return Truth((folder / "sim.mat",), channels, rows.step_s)


@case
def matlab_73(source: Source, folder: Path) -> Truth:
    import h5py

    names = ("t", "encoder_deg", "torque_mNm", "hall1_deg", "hall2_deg", "hall3_deg", "hall4_deg")
    rows = columns(source, names, PLAIN_UNITS)
    with h5py.File(folder / "run.mat", "w", userblock_size=512) as file:
        group = file.create_group("data")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in zip(names, rows.values.T, strict=True):
            group.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
        note = group.create_dataset(
            "comment", data=np.frombuffer("série".encode("utf-16-le"), dtype=np.uint16)[:, None]
        )
        note.attrs["MATLAB_class"] = np.bytes_("char")
    with (folder / "run.mat").open("r+b") as file:
        file.write(
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Fri Mar  1 14:03:11 2024 HDF5 schema 1.00 .".ljust(
                124
            )
            + b"\x00\x02IM"
        )
    return rows.truth(folder / "run.mat")


@case
def matlab_73_rate_alone(source: Source, folder: Path) -> Truth:
    import h5py

    rows = columns(source, ("t", "motor", "torque", "h1", "h2", "h3", "h4"), PLAIN_UNITS)
    units = ("deg", "N*mm", "deg", "deg", "deg", "deg")
    with h5py.File(folder / "run.mat", "w", userblock_size=512) as file:
        file.create_dataset("fs", data=np.array([[1 / rows.step_s]])).attrs["MATLAB_class"] = np.bytes_(
            "double"
        )
        told = file.create_group("units")
        told.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, unit, values in zip(rows.names[1:], units, rows.values.T[1:], strict=True):
            file.create_dataset(name, data=values[None, :]).attrs["MATLAB_class"] = np.bytes_("double")
            word = told.create_dataset(
                name, data=np.frombuffer(unit.encode("utf-16-le"), dtype=np.uint16)[:, None]
            )
            word.attrs["MATLAB_class"] = np.bytes_("char")
    return rows.truth(folder / "run.mat")


@case
def h5py_attributes(source: Source, folder: Path) -> Truth:
    import h5py

    rows = columns(
        source,
        ("time", "base", "torque", "s1", "s2", "s3", "s4"),
        ("s", "rad", "nm", "rad", "rad", "rad", "rad"),
        decimals=9,
    )
    with h5py.File(folder / "run.h5", "w") as file:
        for name, unit, values in zip(
            rows.names, ("s", "rad", "N m", "rad", "rad", "rad", "rad"), rows.values.T, strict=True
        ):
            file.create_dataset(f"daq/{name}", data=values, compression="gzip").attrs["units"] = unit
    channels = {role: (name, f, s) for role, (name, f, s) in rows.channels.items()}
    return Truth((folder / "run.h5",), channels, rows.step_s)


@case
def h5py_compound(source: Source, folder: Path) -> Truth:
    import h5py

    rows = columns(
        source, ("time_s", "drive_deg", "torque_Nmm", "h1_deg", "h2_deg", "h3_deg", "h4_deg"), PLAIN_UNITS
    )
    table = _records(rows)
    with h5py.File(folder / "run.h5", "w") as file:
        file.create_dataset("log", data=table)
    return rows.truth(folder / "run.h5")


@case
def h5py_two_clocks(source: Source, folder: Path) -> Truth:
    import h5py

    rows = columns(source, ("t", "encoder", "torque", "h1", "h2", "h3", "h4"), PLAIN_UNITS)
    with h5py.File(folder / "run.h5", "w") as file:
        for name, unit, values in zip(rows.names[:3], ("s", "deg", "mNm"), rows.values.T[:3], strict=True):
            file.create_dataset(f"daq/{name}", data=values).attrs["unit"] = unit
        for name, unit, values in zip(("t", "encoder_copy", "h1", "h2", "h3", "h4"), ("s", "deg", "deg", "deg", "deg", "deg"),
                                      rows.values.T[[0, 1, 3, 4, 5, 6]], strict=True):  # fmt: skip
            file.create_dataset(
                f"camera/{name}", data=values[::2] if name != "t" else values[::2] + 3.25
            ).attrs["unit"] = unit
    channels = {
        role: (("daq/" if role.startswith("base") else "camera/") + name, f, s)
        for role, (name, f, s) in rows.channels.items()
    }
    return Truth((folder / "run.h5",), channels, rows.step_s, offset_s={"camera": -3.25})


@case
def numpy_npz(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        ("time_s", "motor_rad", "torque_nmm", "hall_1_rad", "hall_2_rad", "hall_3_rad", "hall_4_rad"),
        ("s", "rad", "nmm", "rad", "rad", "rad", "rad"),
    )
    np.savez_compressed(folder / "run.npz", **dict(zip(rows.names, rows.values.T, strict=True)))
    return rows.truth(folder / "run.npz")


@case
def numpy_structured(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS)
    np.save(folder / "run.npy", _records(rows))
    return rows.truth(folder / "run.npy")


@case
def mcap_json(source: Source, folder: Path) -> Truth:
    from mcap.writer import Writer

    rows = columns(
        source,
        ("time", "base_deg", "torque_nmm", "hall_1_deg", "hall_2_deg", "hall_3_deg", "hall_4_deg"),
        PLAIN_UNITS,
    )
    with (folder / "run.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("rig", "jsonschema", b"{}")
        channel = writer.register_channel("/rig", "json", schema)
        for n, row in enumerate(rows.values):
            stamp = 1_709_298_191_000_000_000 + round(row[0] * 1e9)
            data = json.dumps(dict(zip(rows.names[1:], map(float, row[1:]), strict=True))).encode()
            writer.add_message(channel, log_time=stamp, data=data, publish_time=stamp, sequence=n)
        writer.finish()  # type: ignore[no-untyped-call]
    channels = {role: (f"/rig.{name}", f, s) for role, (name, f, s) in rows.channels.items()}
    return Truth((folder / "run.mcap",), channels, rows.step_s)


def _ros(source: Source, folder: Path, plugin: str) -> Truth:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds: Mapping[str, Callable[..., object]] = store.types
    header, stamp_of = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    names = ["base", "hall_1", "hall_2", "hall_3", "hall_4"]
    bag = folder / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        wrench = writer.add_connection("/ft_sensor", "geometry_msgs/msg/WrenchStamped", typestore=store)
        vector = kinds["geometry_msgs/msg/Vector3"]
        for k, time_s in enumerate(source.time_s):
            at = 1_709_298_191_000_000_000 + round(time_s * 1e9)
            head = header(stamp=stamp_of(sec=at // 10**9, nanosec=at % 10**9), frame_id="rig")
            angles = np.array([source.base[k], *source.hall[k]])
            message = kinds["sensor_msgs/msg/JointState"](head, names, angles, np.zeros(0), np.zeros(0))
            writer.write(joints, at, store.serialize_cdr(message, "sensor_msgs/msg/JointState"))
            torque = kinds["geometry_msgs/msg/Wrench"](
                vector(0.0, 0.0, 0.0), vector(0.0, 0.0, float(-source.torque[k]))
            )
            message = kinds["geometry_msgs/msg/WrenchStamped"](head, torque)
            writer.write(wrench, at, store.serialize_cdr(message, "geometry_msgs/msg/WrenchStamped"))
    channels = {"base_angle": ("/joint_states.position.base", 1.0, 1)}
    channels |= {n: (f"/joint_states.position.{n}", 1.0, 1) for n in names[1:]}
    channels["base_torque"] = ("/ft_sensor.wrench.torque.z", 1.0, -1)
    return Truth((bag,), channels, float(np.median(np.diff(source.time_s))))


@case
def ros2_bag_sqlite(source: Source, folder: Path) -> Truth:
    return _ros(source, folder, "SQLITE3")


@case
def ros2_bag_mcap(source: Source, folder: Path) -> Truth:
    return _ros(source, folder, "MCAP")


@case
def ros1_bag(source: Source, folder: Path) -> Truth:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    kinds: Mapping[str, Callable[..., object]] = store.types
    header, stamp_of = kinds["std_msgs/msg/Header"], kinds["builtin_interfaces/msg/Time"]
    names = ["base", "hall_1", "hall_2", "hall_3", "hall_4"]
    with Writer(folder / "run.bag") as writer:
        joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for k, time_s in enumerate(source.time_s):
            at = 1_709_298_191_000_000_000 + round(time_s * 1e9)
            head = header(seq=k, stamp=stamp_of(sec=at // 10**9, nanosec=at % 10**9), frame_id="rig")
            angles = np.array([source.base[k], *source.hall[k]])
            efforts = np.array([source.torque[k], 0.0, 0.0, 0.0, 0.0])
            message = kinds["sensor_msgs/msg/JointState"](head, names, angles, np.zeros(0), efforts)
            writer.write(joints, at, store.serialize_ros1(message, "sensor_msgs/msg/JointState"))
    channels = {"base_angle": ("/joint_states.position.base", 1.0, 1)}
    channels |= {n: (f"/joint_states.position.{n}", 1.0, 1) for n in names[1:]}
    channels["base_torque"] = ("/joint_states.effort.base", 1.0, 1)
    return Truth((folder / "run.bag",), channels, float(np.median(np.diff(source.time_s))))


LABVIEW = ("Motor Angle", "Torque", "Hall 1", "Hall 2", "Hall 3", "Hall 4")


@case
def labview_tdms_waveforms(source: Source, folder: Path) -> Truth:
    from nptdms import ChannelObject, TdmsWriter

    rows = columns(source, ("time", *LABVIEW), PLAIN_UNITS)
    units = ("deg", "mN.m", "deg", "deg", "deg", "deg")
    told = {
        "wf_increment": rows.step_s,
        "wf_start_time": np.datetime64("2024-03-01T13:03:11.000000"),
        "wf_start_offset": 0.0,
    }
    with TdmsWriter(folder / "run.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject("Measured Data", name, values, {**told, "unit_string": unit})
                for name, unit, values in zip(LABVIEW, units, rows.values.T[1:], strict=True)
            ]
        )
    return rows.truth(folder / "run.tdms")


@case
def labview_tdms_time_channel(source: Source, folder: Path) -> Truth:
    from nptdms import ChannelObject, TdmsWriter

    rows = columns(source, ("Time (ms)", *(f"{n} (deg)" if n != "Torque" else "Torque (mNm)" for n in LABVIEW)),
                   ("ms", *PLAIN_UNITS[1:]))  # fmt: skip
    with TdmsWriter(folder / "run.tdms") as writer:
        writer.write_segment(
            [ChannelObject("Log", n, v, {}) for n, v in zip(rows.names, rows.values.T, strict=True)]
        )
    return rows.truth(folder / "run.tdms")


@case
def asammdf_mf4(source: Source, folder: Path) -> Truth:
    import can  # noqa: F401 - before asammdf, without which it writes no MF4
    from asammdf import MDF, Signal

    rows = columns(source, ("time", "MotorAngle", "Torque", "Hall1", "Hall2", "Hall3", "Hall4"), PLAIN_UNITS)
    units = ("deg", "mNm", "deg", "deg", "deg", "deg")
    with MDF(version="4.10") as file:
        file.append(
            [
                Signal(samples=values, timestamps=rows.values[:, 0], name=name, unit=unit)
                for name, unit, values in zip(rows.names[1:], units, rows.values.T[1:], strict=True)
            ]
        )
        file.save(folder / "run.mf4")
    return rows.truth(folder / "run.mf4")


@case
def polars_parquet(source: Source, folder: Path) -> Truth:
    import polars

    rows = columns(source, PLAIN, PLAIN_UNITS)
    polars.DataFrame(dict(zip(rows.names, rows.values.T, strict=True))).write_parquet(folder / "run.parquet")
    return rows.truth(folder / "run.parquet")


@case
def polars_feather_dates(source: Source, folder: Path) -> Truth:
    import polars

    names = ("stamp", "motor [rad]", "torque [Nm]", *(f"hall_{k} [rad]" for k in (1, 2, 3, 4)))
    rows = columns(source, names, ("s", "rad", "nm", "rad", "rad", "rad", "rad"), decimals=9)
    frame = polars.DataFrame(dict(zip(rows.names, rows.values.T, strict=True)))
    moments = np.datetime64("2024-03-01T13:03:11") + (rows.values[:, 0] * 1e6).astype("timedelta64[us]")
    frame.with_columns(stamp=polars.Series(moments)).write_ipc(folder / "run.feather")
    return rows.truth(folder / "run.feather")


@case
def pandas_json_lines(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS)
    _frame(rows).to_json(folder / "log.jsonl", orient="records", lines=True)
    return rows.truth(folder / "log.jsonl")


@case
def json_arrays(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS)
    told = {name: values.tolist() for name, values in zip(rows.names, rows.values.T, strict=True)}
    (folder / "log.json").write_text(json.dumps({"operator": "lab", "run": told}), encoding="utf-8")
    return rows.truth(folder / "log.json")


def _table_of_matlab(source: Source, folder: Path, version: str) -> Truth:
    import warnings

    import matio
    import pandas

    names = ("base_rad", "torque_nmm", "hall_1_rad", "hall_2_rad", "hall_3_rad", "hall_4_rad")
    rows = columns(source, ("Time", *names), ("s", "rad", "nmm", "rad", "rad", "rad", "rad"))
    frame = pandas.DataFrame(dict(zip(names, rows.values.T[1:], strict=True)))
    frame.index = pandas.to_timedelta(rows.values[:, 0], unit="s")
    frame.index.name = "Time"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that durations are in seconds
        matio.save_to_mat(str(folder / "run.mat"), {"log": frame}, version=version)
    return rows.truth(folder / "run.mat")


@case
def matlab_timetable_7(source: Source, folder: Path) -> Truth:
    return _table_of_matlab(source, folder, "v7")


@case
def matlab_timetable_73(source: Source, folder: Path) -> Truth:
    return _table_of_matlab(source, folder, "v7.3")


def _timeseries(name: str, time_s: np.ndarray, values: np.ndarray, unit: str) -> Any:
    """A timeseries with the properties that MATLAB saves of one; even times are a start and a step."""
    from matio.utils.matclass import MatlabOpaque

    step_s = float(np.median(np.diff(time_s)))
    times: dict[str, Any] = {"Time_": time_s[:, None]}
    if np.allclose(np.diff(time_s), step_s, rtol=1e-9):
        times = {"Time_": np.empty((0, 0)), "Start_": float(time_s[0]), "Increment_": step_s}
    info = {"Units": "seconds", "Format": "", "StartDate": "", "Length": float(len(time_s)), **times}
    properties = {
        "Name": name,
        "Data_": values[:, None],
        "DataInfo": MatlabOpaque({"Units": unit}, "tsdata.datametadata"),
        "TimeInfo": MatlabOpaque(info, "tsdata.timemetadata"),
        "IsTimeFirst_": True,
    }
    return MatlabOpaque(properties, "timeseries")


def _objects_of_matlab(source: Source, folder: Path, version: str, of_simulink: bool) -> Truth:
    """Variables that are timeseries, or one Dataset of Simulink that holds a signal each."""
    import warnings

    import matio
    from matio.utils.matclass import MatlabOpaque

    units = {"base_angle": ("rad", "motor"), "base_torque": ("N*mm", "torque")}
    units |= {f"hall_{k}": ("rad", f"hall_{k}") for k in (1, 2, 3, 4)}
    series, channels = {}, {}
    for role, (unit, name) in units.items():
        factor = 1e-3 if role == "base_torque" else 1.0
        known = np.round(source.of(role) / factor, 6)
        series[name] = _timeseries("" if of_simulink else name, source.time_s, known, unit)
        channels[role] = (name, factor, 1)
    content: dict[str, Any] = series
    if of_simulink:
        signals = np.empty((1, len(series)), dtype=object)
        for k, (name, values) in enumerate(series.items()):
            signals[0, k] = MatlabOpaque({"Name": name, "Values": values}, "Simulink.SimulationData.Signal")
        ram = MatlabOpaque({"Version": 2.0, "Elements": signals}, f"{_STORAGE}.RamDatasetStorage")
        kept = {"Name": "logsout", "Storage_": ram}
        content = {"out": {"logsout": MatlabOpaque(kept, "Simulink.SimulationData.Dataset")}}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        matio.save_to_mat(str(folder / "run.mat"), content, version=version)
    return Truth((folder / "run.mat",), channels, float(np.median(np.diff(source.time_s))))


_STORAGE = "Simulink.SimulationData.Storage"


@case
def matlab_timeseries_7(source: Source, folder: Path) -> Truth:
    return _objects_of_matlab(source, folder, "v7", of_simulink=False)


@case
def matlab_timeseries_73(source: Source, folder: Path) -> Truth:
    return _objects_of_matlab(source, folder, "v7.3", of_simulink=False)


@case
def simulink_dataset_7(source: Source, folder: Path) -> Truth:
    return _objects_of_matlab(source, folder, "v7", of_simulink=True)


@case
def simulink_dataset_73(source: Source, folder: Path) -> Truth:
    return _objects_of_matlab(source, folder, "v7.3", of_simulink=True)


def _labelled(rows: Columns, between: str, colon: str, from_: int = 0) -> list[str]:
    return [
        between.join(f"{name}{colon}{v:.5f}" for name, v in zip(rows.names[from_:], row[from_:], strict=True))
        for row in rows.values
    ]


@case
def arduino_plotter(source: Source, folder: Path) -> Truth:
    names = ("t_ms", "motor_deg", "torque_nmm", "hall_1_deg", "hall_2_deg", "hall_3_deg", "hall_4_deg")
    rows = columns(source, names, ("ms", *PLAIN_UNITS[1:]))
    (folder / "serial.txt").write_text("\r\n".join(["Ready.", *_labelled(rows, ",", ":"), ""]))
    return rows.truth(folder / "serial.txt")


@case
def arduino_plotter_with_stamps(source: Source, folder: Path) -> Truth:
    import datetime

    names = ("t", "motor_deg", "torque_nmm", "hall_1_deg", "hall_2_deg", "hall_3_deg", "hall_4_deg")
    rows = columns(source, names, PLAIN_UNITS)
    begin = datetime.datetime(2024, 3, 1, 12, 34, 56)
    stamps = [
        (begin + datetime.timedelta(seconds=float(s))).strftime("%H:%M:%S.%f")[:-3] for s in source.time_s
    ]
    lines = [f"{s} -> {line}" for s, line in zip(stamps, _labelled(rows, " ", ": ", 1), strict=True)]
    (folder / "serial.txt").write_text("\n".join([*lines, ""]))
    return rows.truth(folder / "serial.txt")


@case
def openpyxl_text_cells(source: Source, folder: Path) -> Truth:
    import openpyxl

    names = ("Zeit [s]", "Motorwinkel [°]", "Drehmoment [mNm]", *(f"Hall {k} [°]" for k in (1, 2, 3, 4)))
    rows = columns(source, names, PLAIN_UNITS)
    book = openpyxl.Workbook()
    book.active.append(list(rows.names))
    for row in rows.values:
        book.active.append([f"{v:.5f}".replace(".", ",") for v in row])
    book.save(folder / "series.xlsx")
    return rows.truth(folder / "series.xlsx")


def _can_log(source: Source, path: Path) -> Truth:
    """What the torque and drive nodes of this rig send, by python-can's writers."""
    import can
    import cantools

    database: Any = cantools.database.load_file(ROOT / "config/needle_rig.dbc")
    told = {"TORQUE_STATUS": ("torque", source.torque * 1e3), "DRIVE_STATUS": ("angle", source.base / DEG)}
    with can.Logger(path) as log:
        for k, time_s in enumerate(source.time_s):
            for name, (signal, values) in told.items():
                message = database.get_message_by_name(name)
                sent = {s.name: 0 for s in message.signals} | {signal: float(values[k])}
                log(
                    can.Message(
                        arbitration_id=message.frame_id,
                        data=message.encode(sent, strict=False),
                        timestamp=1_709_298_191 + float(time_s),
                        is_extended_id=False,
                        channel=1,
                    )
                )
    channels = {
        "base_angle": ("DRIVE_STATUS.angle", DEG, 1),
        "base_torque": ("TORQUE_STATUS.torque", 1e-3, 1),
    }
    return Truth((path,), channels, float(np.median(np.diff(source.time_s))))


@case
def can_candump(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.log")


@case
def can_vector_asc(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.asc")


@case
def can_vector_blf(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.blf")


@case
def can_peak_trc(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.trc")


@case
def can_python_csv(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.csv")


@case
def can_asam_mf4(source: Source, folder: Path) -> Truth:
    return _can_log(source, folder / "run.mf4")


@case
def torque_and_base_alone(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("Time [s]", "Encoder [deg]", "Torque [mNm]"), ("s", "deg", "nmm"))
    return text(folder / "log.csv", rows)


@case
def two_joints_of_which_one_moves(source: Source, folder: Path) -> Truth:
    """Joint 1 holds: its angle trembles, and its torque is the weight that joint 2 moves."""
    names = ("Time [s]", "joint_2.pos [deg]", "joint_2.torque [mNm]")
    rows = columns(source, names, ("s", "deg", "nmm"))
    time_s, angle, torque = rows.values.T
    noise = np.random.default_rng(1).standard_normal((2, len(time_s)))
    still = 0.004 * np.sin(3.0 * time_s) + 0.003 * noise[0]
    weight = 0.4 * np.ptp(torque) * np.cos(np.radians(angle)) + 0.01 * np.ptp(torque) * noise[1]
    told = np.column_stack((time_s, still, angle, weight, torque))
    order = ("Time [s]", "joint_1.pos [deg]", names[1], "joint_1.torque [mNm]", names[2])
    truth = text(folder / "arm.csv", Columns(order, told, rows.channels, rows.step_s))
    return replace(truth, places=(2, 4))


@case
def two_actuators_back_to_back(source: Source, folder: Path) -> Truth:
    """The second is not powered and follows by gear and play; each tells a torque of its own."""
    names = ("t [s]", "c1 position [deg]", "c1 torque [mNm]", "c2 position [deg]")
    rows = columns(source, names, ("s", "deg", "nmm", "deg"))
    idle = 0.05 * np.ptp(rows.values[:, 2]) * np.random.default_rng(2).standard_normal(len(rows.values))
    told = np.column_stack((rows.values, idle))
    truth = text(
        folder / "bench.csv", Columns((*rows.names, "c2 torque [mNm]"), told, rows.channels, rows.step_s)
    )
    # one angle where the layout has four sensors: which one it is only a person knows
    return Truth(truth.files, truth.channels, truth.step_s, askable=True)


@case
def replicates_in_sheets(source: Source, folder: Path) -> Truth:
    import pandas

    rows = columns(source, PLAIN, PLAIN_UNITS)
    with pandas.ExcelWriter(folder / "series.xlsx") as book:
        for sheet in ("current 60", "current 80", "current 80 again"):
            _frame(rows).to_excel(book, sheet_name=sheet, index=False)
    return rows.truth(folder / "series.xlsx")


@case
def replicates_in_groups(source: Source, folder: Path) -> Truth:
    import h5py

    rows = columns(source, PLAIN, PLAIN_UNITS)
    with h5py.File(folder / "runs.h5", "w") as file:
        for run in ("run_1", "run_2"):
            for name, values in zip(rows.names, rows.values.T, strict=True):
                file[f"{run}/{name}"] = values
    return rows.truth(folder / "runs.h5")


@case
def a_follower_of_the_other_sign(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS, (1, 1, -1, 1, -1, 1))
    return text(folder / "log.csv", rows)


@case
def neutral_names(source: Source, folder: Path) -> Truth:
    """Units are written, names say nothing: the angles' order in the file is that of the alphabet."""
    names = ("time [s]", "F [deg]", "A [mNm]", "D [deg]", "B [deg]", "E [deg]", "C [deg]")
    rows = columns(source, names, PLAIN_UNITS)
    order = [0, 2, 4, 6, 3, 5, 1]
    told = Columns(tuple(rows.names[k] for k in order), rows.values[:, order], rows.channels, rows.step_s)
    places = tuple(order.index(k + 1) for k in range(6))
    return replace(text(folder / "log.csv", told), places=places)


@case
def encoder_and_camera_files(source: Source, folder: Path) -> Truth:
    rows = columns(source, ("time_s", "motor_deg", "torque_nmm", "h1", "h2", "h3", "h4"), PLAIN_UNITS)
    first = Columns(rows.names[:3], rows.values[:, :3], {}, rows.step_s)
    text(folder / "daq.csv", first)
    camera = rows.values[::5][:, [0, 1, 3, 4, 5, 6]].copy()
    camera[:, 0] -= 1.5
    names = ("frame_time_s", "chuck_deg", "marker_1_deg", "marker_2_deg", "marker_3_deg", "marker_4_deg")
    text(folder / "camera.csv", Columns(names, camera, {}, rows.step_s))
    channels = dict(rows.channels)
    for k in range(4):
        channels[f"hall_{k + 1}"] = (f"marker_{k + 1}_deg", DEG, 1)
    return Truth((folder / "daq.csv", folder / "camera.csv"), channels, rows.step_s, offset_s={"camera": 1.5})


# What only a person knows is missing in these: the guess must ask.


@case
def columns_without_names(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS)
    order = [0, 6, 2, 4, 3, 1, 5]
    told = Columns(tuple(rows.names[k] for k in order), rows.values[:, order], {}, rows.step_s)
    channels = {
        r: (f"column_{order.index(k + 1) + 1}", f, s)
        for k, (r, (_, f, s)) in enumerate(rows.channels.items())
    }
    truth = text(folder / "log.txt", told, " ", names=False)
    return Truth(truth.files, channels, truth.step_s, askable=True)


@case
def counts_and_volts(source: Source, folder: Path) -> Truth:
    rows = columns(
        source,
        (
            "Time [s]",
            "Encoder [counts]",
            "Torque cell [V]",
            "Hall 1 [deg]",
            "Hall 2 [deg]",
            "Hall 3 [deg]",
            "Hall 4 [deg]",
        ),
        PLAIN_UNITS,
    )
    rows.values[:, 1] = np.round(rows.values[:, 1] * 4096 / 360)
    rows.values[:, 2] *= 12.5
    truth = text(folder / "raw.csv", rows)
    return Truth(truth.files, truth.channels, truth.step_s, askable=True)


@case
def numpy_bare_array(source: Source, folder: Path) -> Truth:
    rows = columns(source, PLAIN, PLAIN_UNITS)
    np.save(folder / "run.npy", rows.values)
    channels = {role: (f"array.{k + 2}", f, s) for k, (role, (_, f, s)) in enumerate(rows.channels.items())}
    return Truth((folder / "run.npy",), channels, rows.step_s, askable=True)


__all__ = ["CASES", "Source", "Truth"]
