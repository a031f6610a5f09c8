"""What the watch found in each run, as it is kept beside the runs."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from needle_rig.config.check import validate
from needle_rig.config.places import Places
from needle_rig.config.schema import Section
from needle_rig.errors import BadInput
from needle_rig.model.schema import Number
from needle_rig.recording.watch_summary import SUMMARY, WATCH_FOLDER


class Watched(Section):
    """One parameter in one run."""

    at: Number
    """On the fit's scale: a logarithm, or a scaled value, which may lie beyond a bound."""
    value: Number
    uncertainty: Number
    unit: str
    least: Number
    """Change of `at` that does not matter."""


class WatchedRun(Section):
    """What one run said."""

    format: Literal["needle-rig-watch/1"] = "needle-rig-watch/1"
    run: str
    started_utc: str
    rig: str = ""
    """SHA-256 of layout, needle and model: only runs of one rig are compared."""
    parameters: dict[str, Watched] = Field(default_factory=dict)
    misfit: Annotated[float, Field(ge=0)] = 0.0
    """Root mean square of what the model leaves, in units of the noise."""
    not_judged: str = ""
    """Why it says nothing."""


def kept_runs(directory: Path) -> list[WatchedRun]:
    """What runs said, in the order in which they were made; files that are damaged are left out."""
    found = []
    for path in (directory / WATCH_FOLDER).glob("*.json"):
        if path.name != SUMMARY:
            with suppress(OSError, ValueError, BadInput):
                found.append(_kept_run(path))
    return sorted(found, key=lambda run: (run.started_utc, run.run))


def _kept_run(path: Path) -> WatchedRun:
    """What a run said. Raises OSError, ValueError or BadInput where it is damaged or of a newer format."""
    content = json.loads(path.read_bytes())
    if not isinstance(content, dict):
        raise ValueError(path.name)
    return validate(WatchedRun, content, Places(path.name))
