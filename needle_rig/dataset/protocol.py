"""A series of trials as it is planned: targets, speeds, dwells, reversals; YAML files of it.

format: needle-rig-protocol/1
name: two reversals
trials:
  - {kind: compensate, target_deg: 45, speed_deg_s: 45, settle_s: 3}
  - {kind: staircase, steps_deg: [90, 0, 45], speed_deg_s: 30, settle_s: 2}
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from needle_rig.config.check import validate
from needle_rig.config.files import named_files
from needle_rig.config.places import read_yaml, write_yaml
from needle_rig.config.schema import Section
from needle_rig.dataset.records import TrialCommand
from needle_rig.errors import BadInput

FORMAT = "needle-rig-protocol/1"


@dataclass(frozen=True)
class Protocol:
    """Trials in their order, and the pause between them, in which the needle is brought back to rest."""

    name: str
    trials: tuple[TrialCommand, ...]
    pause_s: float = 30.0

    def repeated(self, times: int) -> Protocol:
        """The whole series `times` times over."""
        return Protocol(self.name, self.trials * times, self.pause_s)


class PlannedTrial(Section):
    """One trial of a protocol file."""

    kind: Literal["compensate", "staircase"]
    target_deg: Annotated[float, Field(ge=-3600, le=3600)] | None = None
    steps_deg: tuple[Annotated[float, Field(ge=-3600, le=3600)], ...] = ()
    speed_deg_s: Annotated[float, Field(gt=0, le=360)]
    settle_s: Annotated[float, Field(ge=0, le=3600)]


class ProtocolFile(Section):
    """A protocol as it stands on disk."""

    format: Literal["needle-rig-protocol/1"]
    name: str
    pause_s: Annotated[float, Field(ge=0, le=86_400)] = 30.0
    note: str = ""
    trials: tuple[PlannedTrial, ...]


def load_protocol(name_or_path: str | os.PathLike[str]) -> Protocol:
    """The protocol of a name (`standard`) or a YAML file. Raises BadInput with file and line."""
    given = os.fspath(name_or_path)
    if given.endswith((".yaml", ".yml")) or os.sep in given:
        path = Path(given)
    elif given in (known := named_files("protocols")):
        path = known[given]
    else:
        there = ", ".join(sorted(known)) or "none"
        raise BadInput(f"there is no protocol {given}; there are {there}, or name a YAML file")
    data, places = read_yaml(path)
    read = validate(ProtocolFile, data, places)
    if not read.trials:
        raise places.error(("trials",), "no trial is planned; add at least one")
    for k, trial in enumerate(read.trials):
        if trial.kind == "compensate" and trial.target_deg is None:
            raise places.error(("trials", k), "a compensation needs its target_deg")
        if trial.kind == "staircase" and not trial.steps_deg:
            raise places.error(("trials", k), "a staircase needs its steps_deg")
    return Protocol(read.name, tuple(_command(t) for t in read.trials), read.pause_s)


def save_protocol(path: str | os.PathLike[str], protocol: Protocol, note: str = "") -> None:
    """Write a protocol file that `load_protocol` reads back equal."""
    data: dict[str, object] = {"format": FORMAT, "name": protocol.name, "pause_s": protocol.pause_s}
    if note:
        data["note"] = note
    data["trials"] = [t.file_keys() for t in protocol.trials]
    Path(path).write_text(write_yaml(data), encoding="utf-8")


def compensation(target_deg: float, speed_deg_s: float = 45.0, settle_s: float = 3.0) -> TrialCommand:
    """The command of one compensation."""
    return TrialCommand("compensate", target_deg, speed_deg_s, settle_s)


def staircase(steps_deg: Iterable[float], speed_deg_s: float = 30.0, settle_s: float = 2.0) -> TrialCommand:
    """The command of base angles one after the other."""
    return TrialCommand("staircase", None, speed_deg_s, settle_s, tuple(steps_deg))


def _command(trial: PlannedTrial) -> TrialCommand:
    return TrialCommand(trial.kind, trial.target_deg, trial.speed_deg_s, trial.settle_s, trial.steps_deg)
