"""LabVIEW's TDMS files: a table a group, with the clock of its waveforms."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from needle_rig.errors import BadInput
from needle_rig.extras import needed
from needle_rig.importing.arrays import FEWEST_ROWS, Leaf, columns_of, text_of
from needle_rig.importing.library_log import without_log
from needle_rig.importing.recording import Read


def read_tdms(path: Path, shown: str) -> Read:
    """Dialect in words, columns and rates. Raises BadInput."""
    nptdms = needed("nptdms", "a TDMS file", "import")
    leaves: dict[str, Leaf] = {}
    try:
        with without_log("nptdms"), nptdms.TdmsFile.open(path) as file:
            lost = {
                path: status.expected_length - status.read_length
                for path, status in (file.file_status.channel_statuses or {}).items()
            }
            for group in file.groups():
                _group(group, lost, leaves, shown)
    except BadInput:
        raise
    except Exception as error:  # noqa: BLE001 - damaged files raise anything, down to struct's errors
        raise BadInput(
            f"{shown}: cannot be read as TDMS: {str(error)[:200]}; copy it again, closed by its writer"
        ) from None
    columns, rates = columns_of(leaves, shown)
    return "TDMS", columns, rates


def _group(group: Any, lost: Mapping[str, int], leaves: dict[str, Leaf], shown: str) -> None:
    """Channels by length and clock: those of one waveform are a table with its times.

    Of a file that was cut off, with samples `lost` by channel, the rows stay that all channels have.
    """
    alike: dict[tuple[int, float, float], list[Any]] = defaultdict(list)
    for channel in group.channels():
        told = channel.properties
        step_s = float(told.get("wf_increment", 0.0) or 0.0)
        alike[len(channel) + lost.get(channel.path, 0), step_s, _start_s(told)].append(channel)
    for (meant, step_s, start_s), channels in alike.items():
        rows = min(map(len, channels))
        if rows < FEWEST_ROWS <= meant:
            short = min(channels, key=len)
            raise BadInput(
                f"{shown}: is cut off: {short.name} has {rows} of {meant} samples; copy it again, closed by"
                " its writer"
            )
        place = _plain(group.name) if len(alike) == 1 else f"{_plain(group.name)} {rows} at {step_s:g} s"
        if step_s > 0.0:
            leaves[f"{place}/time"] = (start_s + step_s * np.arange(rows), "s")
        for channel in channels:
            unit = text_of(channel.properties.get("unit_string", ""))
            leaves[f"{place}/{_plain(channel.name)}"] = (channel[:rows], unit)


def _start_s(told: Any) -> float:
    """Seconds since 1970 of a waveform's first sample; of one without a date since its trigger."""
    begin = told.get("wf_start_time")
    since = 0.0 if begin is None else float(np.datetime64(begin, "ns").astype(np.int64)) * 1e-9
    return since + float(told.get("wf_start_offset", 0.0) or 0.0)


def _plain(name: str) -> str:
    """Without the sign that parts a tree."""
    return name.replace("/", "∕")
