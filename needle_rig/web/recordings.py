"""Recordings that a person drops: the proposed mapping as a document, and the dataset of a confirmed one.

Files are named relative to their upload's folder; a mapping that names any other is refused.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from needle_rig.config.check import validate
from needle_rig.config.places import Places, read_yaml
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, Recordings
from needle_rig.importing.mapping import BASE, FORMAT, TIP_TORQUE, TORQUE
from needle_rig.importing.preview import preview
from needle_rig.numerics import Array
from needle_rig.questions.doing import Doing
from needle_rig.questions.recordings import Understand, Understood
from needle_rig.web.models import finite
from needle_rig.web.places import DATASET

DOTS = 1500
"""Of a drawn channel."""
_YAML = (".yaml", ".yml")
_DBC = ".dbc"

Document = dict[str, Any]
Say = Callable[[str], None]


def guess(
    say: Say,
    *,
    folder: str,
    files: list[str],
    layout: str | None,
    machine: str | None,
    name: str,
    out: str,
) -> Document:
    """What is what in `files`: a mapping among them, or else the proposed one. Raises BadInput.

    `layout` is a file with the shaft. Without it that of the kind of `machine` is written, or else a layout
    among the files is taken.
    """
    del out
    root = Path(folder)
    texts = [file for file in files if Path(file).suffix.lower() in _YAML]
    mappings = [file for file in texts if read_yaml(root / file)[0].get("format") == FORMAT]
    shafts = [str(root / file) for file in texts if file not in mappings]
    databases = [file for file in files if Path(file).suffix.lower() == _DBC]
    read = mappings or [file for file in files if file not in (*texts, *databases)]
    if not read:
        raise BadInput(f"{name}: holds no dataset, run or recording; drop the recordings too")
    shaft = layout if layout is not None or machine is not None else next(iter(shafts), None)
    dbc = next((str(root / file) for file in databases), None)
    question = Understand(files=read, name=name, folder=folder, layout=shaft, dbc=dbc, machine=machine)
    return _document(question.answer(Doing(say=say)), files)


def imported(say: Say, *, folder: str, files: list[str], mapping: Document, out: str) -> Document:
    """The dataset of a confirmed mapping, in the folder DATASET of `out`. Raises BadInput."""
    say("importing")
    # as JSON, so that its lists are the tuples of a mapping file
    checked = validate(Mapping, json.loads(json.dumps(mapping)), Places("the mapping"))
    _inside(checked, files)
    found = Understood(checked, Path(folder), True, Recordings())
    waiting = [*found.lacks(), *found.doubts()]
    if waiting:
        raise BadInput("\n".join(waiting))
    with found.written(Path(out) / DATASET) as written:
        dataset = written.dataset
    return {
        "name": checked.name,
        "trials": len(dataset.trials),
        "commands": len(dataset.replicates),
        "samples": sum(len(trial.trial.time_s) for trial in dataset.trials),
        "notes": list(written.notes),
    }


def _inside(mapping: Mapping, files: list[str]) -> None:
    named = [file.path for clock in mapping.clocks.values() for file in clock.files]
    for path in (*named, *(() if mapping.dbc is None else (mapping.dbc,))):
        if path not in files:
            raise BadInput(f"{path[:80]}: is none of the dropped files; drop it too")


def _document(found: Understood, files: list[str]) -> Document:
    """The mapping, what it needs, and its channels to look at."""
    mapping = found.mapping
    _inside(mapping, files)
    sensors = [] if mapping.rig is None else [sensor.name for sensor in mapping.rig.hall_sensors]
    told = [channel.role for channel in mapping.channels]
    shown, _ = preview(mapping, found.folder, found.recordings)
    return {
        "mapping": mapping.model_dump(mode="json"),
        "lacks": found.lacks(),
        "roles": list(dict.fromkeys([BASE, TORQUE, *sensors, TIP_TORQUE, *told])),
        "shown": [
            {
                "role": channel.role,
                "source": channel.source,
                "unit": channel.unit,
                "time_s": _thinned(channel.time_s),
                "values": _thinned(channel.values),
            }
            for channel in shown
        ],
    }


def _thinned(values: Array) -> list[float | None]:
    every = max(1, len(values) // DOTS)
    return [finite(float(v)) for v in values[::every]]
