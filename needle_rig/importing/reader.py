"""Files of any format to recordings: the format is known by the first bytes, not by the name."""

from __future__ import annotations

import dataclasses
import gzip
import os
import tempfile
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path

from needle_rig.config.places import show_path
from needle_rig.config.regular_file import open_regular
from needle_rig.errors import BadInput
from needle_rig.importing.bus_log import is_bus_log, read_bus_log
from needle_rig.importing.data_frame import is_frame, read_frame
from needle_rig.importing.delimited import read_delimited
from needle_rig.importing.json_file import may_be_json, read_json
from needle_rig.importing.labelled import is_labelled, read_labelled
from needle_rig.importing.recording import LIMIT_BYTES, Read, Recording, sha256_of

KEPT_BYTES = 1_000_000_000
"""Largest total of numbers that are kept; what is beyond is read again when it is asked for."""
_PICKLE = "a pickle of Python, which may run code; save it with DataFrame.to_parquet or numpy.savez"
_HDF5 = b"\x89HDF\r\n\x1a\n"


class Recordings:
    """Files, each read once in all the steps of an import, as far as what was read can be kept."""

    def __init__(self) -> None:
        self._kept: dict[str, Recording] = {}
        self._bytes = 0

    def read(self, path: Path, dbc: Path | None = None, table: str = "") -> Recording:
        """The file at `path`, as it was when it was first read; `dbc`: of its bus; `table`: that alone.

        Raises BadInput.
        """
        place = f"{os.path.abspath(path)}\0{dbc and os.path.abspath(dbc)}"
        if place in self._kept:
            return dataclasses.replace(self._kept[place], path=path).alone(table)
        found = read_recording(path, dbc)
        size = sum(column.values.nbytes for column in found.columns)
        if self._bytes + size <= KEPT_BYTES:
            self._kept[place] = found
            self._bytes += size
        return found.alone(table)


def read_recording(path: Path, dbc: Path | None = None) -> Recording:
    """The file at `path` (a ROS 2 bag may be a folder). Raises BadInput with file and, in text, line.

    `dbc` is the database that decodes a log of a CAN bus; without it that is this rig's own.
    """
    shown = show_path(path)
    if path.is_dir():
        if not (path / "metadata.yaml").is_file():
            raise BadInput(f"{shown}: is a folder without metadata.yaml, so no ROS 2 bag; name files")
        head = b""
    else:
        with open_regular(path, shown, LIMIT_BYTES) as file:
            head = file.read(512)
            file.seek(512)
            user_block = file.read(8)
        if not head:
            raise BadInput(f"{shown}: the file is empty; record again")
        if user_block == _HDF5:
            head = _HDF5
    if head.startswith(b"\x1f\x8b"):
        return _unpacked(path, shown, dbc)
    for magic, said in _NOT_READ.items():
        if head.startswith(magic):
            raise BadInput(f"{shown}: is {said}")
    dialect, columns, rates = _reader(path, head, dbc)(path, shown)
    return Recording(path, sha256_of(path), dialect, columns, rates)


_PACKED = "packed; unpack it first, or pack it by gzip"
_NOT_READ = {
    b"\x80\x03": _PICKLE,
    b"\x80\x04": _PICKLE,
    b"\x80\x05": _PICKLE,
    b"FEA1": "Feather of version 1; write it again with DataFrame.to_feather or to_parquet of today",
    b"TDSh": "the index of a TDMS file; give the .tdms beside it",
    b"RIFF": "a sound; write its samples with a time as CSV",
    b"BZh": _PACKED,
    b"\xfd7zXZ": _PACKED,
    b"7z\xbc\xaf": _PACKED,
    b"Rar!": _PACKED,
    b"\x28\xb5\x2f\xfd": _PACKED,
}
"""By the first bytes: what is not read, and the conversion that works."""


def _reader(path: Path, head: bytes, dbc: Path | None) -> Callable[[Path, str], Read]:
    if path.is_dir() or head.startswith((b"SQLite format 3\0", b"#ROSBAG")):
        from needle_rig.importing.messages import read_bag

        return read_bag
    if head.startswith(_HDF5):
        from needle_rig.importing.hdf5 import read_hdf5

        return read_hdf5
    if head.startswith(b"\x89MCAP0\r\n"):
        from needle_rig.importing.messages import read_mcap

        return read_mcap
    if head.startswith(b"\x93NUMPY") or (head.startswith(b"PK") and path.suffix.lower() == ".npz"):
        from needle_rig.importing.numpy_file import read_numpy

        return read_numpy
    if head.startswith((b"PK\x03\x04", b"\xd0\xcf\x11\xe0")):
        from needle_rig.importing.spreadsheet import read_spreadsheet

        return read_spreadsheet
    if head.startswith(b"MATLAB ") or path.suffix.lower() == ".mat":
        from needle_rig.importing.matlab import read_matlab

        return read_matlab
    if head.startswith(b"TDSm"):
        from needle_rig.importing.tdms import read_tdms

        return read_tdms
    if head.startswith((b"MDF ", b"UnFinMF ")):
        from needle_rig.importing.mdf import read_mdf

        return partial(read_mdf, dbc=dbc)
    if is_frame(head):
        return read_frame
    if is_bus_log(head):
        return partial(read_bus_log, dbc=dbc)
    if may_be_json(head):
        return read_json
    if is_labelled(head):
        return read_labelled
    return read_delimited


def _unpacked(path: Path, shown: str, dbc: Path | None) -> Recording:
    """The recording in a file packed by gzip; the hash is that of the packed file."""
    with tempfile.TemporaryDirectory(prefix="needle-rig-import-") as folder:
        plain = Path(folder) / path.stem
        try:
            with gzip.open(path, "rb") as packed, plain.open("wb") as out:
                left = LIMIT_BYTES
                while block := packed.read(1 << 22):
                    left -= len(block)
                    if left < 0:
                        raise BadInput(
                            f"{shown}: unpacks to more than {LIMIT_BYTES / 1e9:g} GB; is it the right file?"
                        )
                    out.write(block)
        except (OSError, EOFError, zlib.error) as error:
            raise BadInput(f"{shown}: cannot be unpacked: {error}; copy it again") from None
        try:
            inner = read_recording(plain, dbc)
        except BadInput as error:
            raise BadInput(str(error).replace(show_path(plain), shown)) from None
    return dataclasses.replace(inner, path=path, sha256=sha256_of(path), dialect=f"{inner.dialect}, gzip")
