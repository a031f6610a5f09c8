"""LabVIEW's TDMS files: a table a group, with the clock of its waveforms."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import Leaf, columns_of, text_of
from needle_rig.importing.recording import Column


def read_tdms(path: Path, shown: str) -> tuple[str, tuple[Column, ...], dict[str, float]]:
    """Dialect in words, columns and rates. Raises BadInput."""
    nptdms = needed("nptdms", "a TDMS file", "import")
    leaves: dict[str, Leaf] = {}
    try:
        with nptdms.TdmsFile.open(path) as file:
            for group in file.groups():
                _group(group, leaves)
    except BadInput:
        raise
    except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to struct's errors
        raise BadInput(
            f"{shown}: cannot be read as TDMS: {str(error)[:200]}; copy it again, closed by its writer"
        ) from None
    columns, rates = columns_of(leaves, shown)
    return "TDMS", columns, rates


def _group(group: Any, leaves: dict[str, Leaf]) -> None:
    """Channels by length and clock: those of one waveform are a table with its times."""
    alike: dict[tuple[int, float, float], list[Any]] = defaultdict(list)
    for channel in group.channels():
        told = channel.properties
        step_s = float(told.get("wf_increment", 0.0) or 0.0)
        alike[len(channel), step_s, _start_s(told)].append(channel)
    for (rows, step_s, start_s), channels in alike.items():
        place = _plain(group.name) if len(alike) == 1 else f"{_plain(group.name)} {rows} at {step_s:g} s"
        if step_s > 0.0:
            leaves[f"{place}/time"] = (start_s + step_s * np.arange(rows), "s")
        for channel in channels:
            unit = text_of(channel.properties.get("unit_string", ""))
            leaves[f"{place}/{_plain(channel.name)}"] = (channel[:], unit)


def _start_s(told: Any) -> float:
    """Seconds since 1970 of a waveform's first sample; of one without a date since its trigger."""
    begin = told.get("wf_start_time")
    since = 0.0 if begin is None else float(np.datetime64(begin, "ns").astype(np.int64)) * 1e-9
    return since + float(told.get("wf_start_offset", 0.0) or 0.0)


def _plain(name: str) -> str:
    """Without the sign that parts a tree."""
    return name.replace("/", "∕")
