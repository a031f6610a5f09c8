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
from needle_rig.dataset.description import RigPart
from needle_rig.errors import BadInput
from needle_rig.importing import Mapping, Recordings, dataset_of, read_mapping
from needle_rig.importing import guess as proposed
from needle_rig.importing.keep import kept
from needle_rig.importing.mapping import BASE, FORMAT, TIP_TORQUE, TORQUE
from needle_rig.importing.preview import preview
from needle_rig.importing.shaft import read_rig
from needle_rig.numerics import Array
from needle_rig.web.models import finite
from needle_rig.web.places import DATASET

DOTS = 1500
"""Of a drawn channel."""
_YAML = (".yaml", ".yml")

Document = dict[str, Any]
Say = Callable[[str], None]


def guess(say: Say, *, folder: str, files: list[str], layout: str | None, name: str, out: str) -> Document:
    """What is what in `files`: a mapping among them, or else the proposed one. Raises BadInput.

    `layout` is a file with the shaft; without it a layout among the files is taken.
    """
    del out
    root, recordings = Path(folder), Recordings()
    texts = [file for file in files if Path(file).suffix.lower() in _YAML]
    mappings = [file for file in texts if read_yaml(root / file)[0].get("format") == FORMAT]
    if len(mappings) > 1:
        raise BadInput(f"{mappings[1]}: a second mapping; drop one")
    shafts = [file for file in texts if file not in mappings]
    rig = _shaft(root, layout, shafts)
    if mappings:
        say("reading the mapping")
        mapping, _ = read_mapping(root / mappings[0])
        if rig is not None:
            mapping = mapping.model_copy(update={"rig": rig})
    else:
        read = []
        for file in files:
            if file not in texts:
                say(f"reading {file}")
                read.append(recordings.read(root / file))
        if not read:
            raise BadInput(f"{name}: holds no dataset, run or recording; drop the recordings too")
        say("proposing what is what")
        mapping = proposed(read, name, rig, root)
    return _document(mapping, files, root, recordings)


def imported(say: Say, *, folder: str, files: list[str], mapping: Document, out: str) -> Document:
    """The dataset of a confirmed mapping, in the folder DATASET of `out`. Raises BadInput."""
    say("importing")
    root, recordings, places = Path(folder), Recordings(), Places("the mapping")
    # as JSON, so that its lists are the tuples of a mapping file
    checked = validate(Mapping, json.loads(json.dumps(mapping)), places)
    _inside(checked, files)
    waiting = [*checked.lacks(), *checked.doubts()]
    if waiting:
        raise BadInput("\n".join(waiting))
    dataset = dataset_of(checked, root, recordings=recordings)
    with kept(dataset, checked, root, Path(out) / DATASET) as left_out:
        notes = [*dataset.notes, *left_out]
    return {
        "name": checked.name,
        "trials": len(dataset.trials),
        "commands": len(dataset.replicates),
        "samples": sum(len(trial.trial.time_s) for trial in dataset.trials),
        "notes": notes,
    }


def _shaft(root: Path, layout: str | None, files: list[str]) -> RigPart | None:
    if layout is not None:
        return read_rig(Path(layout))
    return read_rig(root / files[0]) if files else None


def _inside(mapping: Mapping, files: list[str]) -> None:
    for clock in mapping.clocks.values():
        for file in clock.files:
            if file.path not in files:
                raise BadInput(f"{file.path[:80]}: is none of the dropped files; drop it too")


def _document(mapping: Mapping, files: list[str], root: Path, recordings: Recordings) -> Document:
    """The mapping, what it needs, and its channels to look at."""
    _inside(mapping, files)
    sensors = [] if mapping.rig is None else [sensor.name for sensor in mapping.rig.hall_sensors]
    told = [channel.role for channel in mapping.channels]
    shown, _ = preview(mapping, root, recordings)
    return {
        "mapping": mapping.model_dump(mode="json"),
        "lacks": mapping.lacks(),
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
