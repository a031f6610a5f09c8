"""A run as CSV: one file a source, at its own rate, in degrees and N·mm."""

from __future__ import annotations

import csv
import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from needle_rig.config.places import parse_yaml, show_path, write_yaml
from needle_rig.errors import BadInput
from needle_rig.recording.reader import RunFile
from needle_rig.recording.tables import Rows, edge_values


def export_csv(run: RunFile, folder: str | os.PathLike[str]) -> list[Path]:
    """Write ticks.csv, torque.csv, … events.csv and run.yaml (attributes, result) into a new `folder`.

    `time_s` counts from the first row of the run; `node_time_s` is the node's own clock. Raises BadInput when
    the folder exists.
    """
    target = Path(folder)
    try:
        target.mkdir(parents=True)
    except FileExistsError:
        raise BadInput(f"{show_path(target)}: exists already; name another place") from None
    except OSError as error:
        raise BadInput(f"{show_path(target)}: cannot be made: {error.strerror}") from None
    begin_s = run.span_s[0]
    written = []
    for name in run.tables:
        columns = dict(edge_columns(run.table(name), begin_s))
        written.append(_write(target / f"{name}.csv", list(columns), zip(*columns.values(), strict=True)))
    events = [(f"{event.time_s - begin_s:.6f}", event.kind, event.text) for event in run.events]
    written.append(_write(target / "events.csv", ["time_s", "kind", "text"], iter(events)))
    about = {name: _plain(value) for name, value in run.attributes.items()}
    with suppress(BadInput):  # the config as a mapping, where it is one
        about["config"] = parse_yaml(str(about.get("config", "")), "config")[0]
    (target / "run.yaml").write_text(write_yaml(about), encoding="utf-8")
    return [*written, target / "run.yaml"]


def edge_columns(rows: Rows, begin_s: float = 0.0) -> Iterator[tuple[str, list[str]]]:
    """Columns of a table as text, in the units of files."""
    for name, values, decimals in edge_values(rows, begin_s):
        yield name, _texts(values, decimals)


def _texts(values: npt.NDArray[Any], decimals: int) -> list[str]:
    if values.dtype.kind == "S":
        return [value.decode("utf-8", "replace") for value in values.tolist()]
    if values.dtype.kind == "f":
        return ["" if value != value else f"{value:.{decimals}f}" for value in values.tolist()]
    return [str(int(value)) for value in values.tolist()]


def _write(path: Path, header: list[str], rows: Iterator[tuple[str, ...]]) -> Path:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)
    return path


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value
